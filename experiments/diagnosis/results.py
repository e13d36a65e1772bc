"""Checks of a folder of runs: damage, missing runs, and files of interrupted runs."""

import contextlib
import datetime
import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from filelock import FileLock, Timeout

from experiments.diagnosis.machine import Check, Severity
from miho.study import Runs, load_runs
from miho.study.environment import ARITHMETIC
from miho.study.files import (
    ENVIRONMENT,
    JOURNAL,
    LARGEST_SETTINGS,
    MALFORMED,
    PARTIAL,
    RESULT,
    decoded,
    read_bytes,
)
from miho.study.identity import below
from miho.study.manifest import first_names, missing_runs

QUARANTINE = ".quarantine"
TEMPORARY = re.compile(r"\..+\.(\d+)")
"""Name of a file that `write_text` has not completed: .NAME.PID."""
LOCK = "lock"
IN_WORDS = {
    "processor": "kinds of CPU", "blas": "kernels of BLAS", "simd": "sets of SIMD",
    "formulas": "machines of formulas",
}  # fmt: skip
"""Descriptions of the keys in `ARITHMETIC`."""


def result_checks(root: Path, *, quarantine: bool) -> Iterator[Check]:
    """Check an existing root, one check at a time; `quarantine` moves damaged runs aside."""
    stored = load_runs(root)
    yield runs(root, stored, quarantine=quarantine)
    yield missing(root)
    yield arithmetic(stored.runs["folder"])
    files, links = files_and_links(root)
    yield partial(files)
    yield temporary(files)
    yield locks(files)
    yield leading_out(root, links)


def files_and_links(root: Path) -> tuple[list[Path], list[Path]]:
    """Files and symbolic links below the root and not in quarantine; links are not followed."""
    files, links = [], []
    for folder, folders, names in os.walk(root, followlinks=False):
        if QUARANTINE in folders:
            folders.remove(QUARANTINE)
        for path in (Path(folder, name) for name in [*folders, *names]):
            if path.is_symlink():
                links.append(path)
            elif path.name in names:
                files.append(path)
    return files, links


def runs(root: Path, stored: Runs, *, quarantine: bool) -> Check:
    """Finished runs, and runs whose files do not match their checksums."""
    message = f"{len(stored.runs)} finished, {len(stored.curves):,} rows of curves"
    damaged = stored.damaged
    if damaged.empty:
        return Check("runs", Severity.OK, message)
    message = f"{message}, {len(damaged)} damaged: {_some(damaged['reason'].tolist())}"
    if not quarantine:
        return Check("runs", Severity.FAILED, f"{message}; --quarantine moves them aside")
    moved = [move_aside(root, Path(folder)) for folder in damaged["folder"]]
    in_place = [folder for folder, to in zip(damaged["folder"], moved, strict=True) if to is None]
    message = f"{message}; moved {len(moved) - len(in_place)} to {root / QUARANTINE}"
    if in_place:
        return Check(
            "runs", Severity.FAILED, f"{message}, left {_some(in_place)}: in use or outside"
        )
    return Check("runs", Severity.OK, f"{message}; the next sweep runs them again")


def missing(root: Path) -> Check:
    """Runs of recorded sweeps that have no result."""
    message = missing_runs(root)
    if message is None:
        return Check("missing runs", Severity.OK, "none")
    return Check("missing runs", Severity.WARNING, message)


def arithmetic(folders: Iterable[str]) -> Check:
    """Whether all runs with stamps used one kind of CPU, BLAS kernel and SIMD."""
    kinds: dict[str, Counter[str]] = {name: Counter() for name in ARITHMETIC}
    for folder in folders:
        with contextlib.suppress(OSError, *MALFORMED):
            environment = decoded(read_bytes(f"{folder}/{ENVIRONMENT}", LARGEST_SETTINGS))
            for name, counts in kinds.items():
                if environment.get(name):
                    counts[json.dumps(environment[name])] += 1
    message = [
        f"{len(counts)} {IN_WORDS[name]} ({', '.join(str(n) for n in counts.values())} runs)"
        for name, counts in kinds.items()
        if len(counts) > 1
    ]
    if not message:
        return Check(
            "arithmetic", Severity.OK, "one CPU and one kernel of BLAS, as far as runs record it"
        )
    bits = "the same seed need not give the same bits"
    return Check("arithmetic", Severity.WARNING, f"runs of {' and '.join(message)}: {bits}")


def move_aside(root: Path, folder: Path) -> Path | None:
    """Move a damaged run below ROOT/.quarantine; return its path, or None if in use or outside.

    Nothing is deleted. Of a symbolic link, the link is moved and not its target.
    """
    if not folder.parent.resolve().is_relative_to(root.resolve()) or folder == root:
        return None
    date = datetime.datetime.now(datetime.UTC).date().isoformat()
    name = f"{date}-{folder.name}"
    aside, number = root / QUARANTINE / name, 1
    aside.parent.mkdir(exist_ok=True)
    while os.path.lexists(aside):
        number += 1
        aside = aside.with_name(f"{name}-{number}")
    if folder.is_symlink():
        folder.rename(aside)
        return aside
    try:
        with FileLock(folder / LOCK, timeout=0):
            folder.rename(aside)
    except Timeout:
        return None
    return aside


def partial(files: Sequence[Path]) -> Check:
    """Runs that were interrupted or failed, whose best results so far are stored."""
    folders = {path.parent for path in files if path.name in (PARTIAL, JOURNAL)}
    folders -= {path.parent for path in files if path.name == RESULT}
    if not folders:
        return Check("partial runs", Severity.OK, "none")
    names = _some(folders)
    message = f"{len(folders)} interrupted or failed: {names}; the next sweep runs them again"
    return Check("partial runs", Severity.WARNING, message)


def temporary(files: Sequence[Path]) -> Check:
    """Files that a killed process was writing."""
    stale = []
    for path in files:
        match = TEMPORARY.fullmatch(path.name)
        if match and not _alive(int(match[1])):
            stale.append(path)
    if not stale:
        return Check("temporary files", Severity.OK, "none left by ended processes")
    message = f"{len(stale)} left by ended processes: {_some(stale)}; they can be deleted"
    return Check("temporary files", Severity.WARNING, message)


def locks(files: Sequence[Path]) -> Check:
    """Runs that a process executes, from the locks that the kernel lists; takes no lock."""
    try:
        lines = Path("/proc/locks").read_text(encoding="ascii").splitlines()
    except OSError:
        return Check("running", Severity.OK, "this system does not list locks")
    holders = {}
    for fields in (line.split() for line in lines if "->" not in line):
        major, minor, inode = fields[5].split(":")
        holders[os.makedev(int(major, 16), int(minor, 16)), int(inode)] = fields[4]
    held = []
    for path in (path for path in files if path.name == LOCK):
        with contextlib.suppress(FileNotFoundError):  # the run has just ended
            status = path.stat()
            process = holders.get((status.st_dev, status.st_ino))
            if process is not None:
                held.append(f"{path.parent} by process {process}")
    return Check("running", Severity.OK, f"{len(held)} runs: {_some(held)}" if held else "nothing")


def leading_out(root: Path, links: Sequence[Path]) -> Check:
    """Symbolic links to places outside the root, and broken links."""
    out = [link for link in links if not below(link, root)]
    if not out:
        return Check("links", Severity.OK, "none leads out")
    message = (
        f"{len(out)} lead out of {root} or are broken: {_some(out)}; remove them (not followed)"
    )
    return Check("links", Severity.FAILED, message)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def _some(things: Iterable[object]) -> str:
    """Text with the first few things, and the number of further ones."""
    return first_names(sorted(map(str, things)))
