"""Check the machine, the installation and a folder of results; one line for each check.

python -m experiments.doctor                          # machine and packages
python -m experiments.doctor runs/identify            # its runs as well
python -m experiments.doctor runs/identify --quarantine
python -m experiments.doctor --timing                 # the A/A test too, some five seconds

Exit codes: 0 nothing has to be mended, 2 no such folder, 3 something failed.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import json
import os
import platform
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import chain
from pathlib import Path

from filelock import FileLock, Timeout
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from experiments.app.console import OK, SOME_FAILED, guarded
from experiments.machine import Check, State, machine_checks
from miho.study import Runs, load_runs
from miho.study.environment import ARITHMETIC
from miho.study.files import (
    ENVIRONMENT,
    LARGEST_SETTINGS,
    MALFORMED,
    PARTIAL,
    RESULT,
    decoded,
    read_bytes,
)
from miho.study.manifest import missing_runs
from miho.study.places import below

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
NEEDED = "experiments"
"""The extra without which no command runs; what others lack is said, and no fault."""
QUARANTINE = ".quarantine"
TEMPORARY = re.compile(r"\..+\.(\d+)")
"""What `write_text` calls a file until it is whole: .NAME.PID."""

LOCK, SHOWN = "lock", 3
CALLED = {"processor": "kinds of CPU", "blas": "kernels of BLAS", "simd": "sets of SIMD"}
"""What `ARITHMETIC` names, in words."""


def diagnose(arguments: Sequence[str] | None = None) -> int:
    """Print the checks as they are made; the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.doctor",
        description="Check this machine, the installed packages and a folder of results.",
    )
    parser.add_argument("root", type=Path, nargs="?", metavar="ROOT", help="a folder of runs")
    parser.add_argument(
        "--quarantine",
        action="store_true",
        help="move damaged runs to ROOT/.quarantine; nothing is deleted",
    )
    parser.add_argument("--timing", action="store_true", help="compare a method with itself")
    chosen = parser.parse_args(arguments)
    if chosen.quarantine and chosen.root is None:
        parser.error("--quarantine needs the ROOT of the runs")
    if chosen.root is not None and not chosen.root.is_dir():
        raise FileNotFoundError(f"{chosen.root}: no such folder of runs; check its name")
    checks = [machine_checks(chosen.root or Path(), timing=chosen.timing), package_checks()]
    if chosen.root is not None:
        checks.append(result_checks(chosen.root, quarantine=chosen.quarantine))
    done: list[Check] = []
    for check in chain.from_iterable(checks):
        print(check.line, flush=True)
        done.append(check)
    failed = sum(check.state is State.FAILED for check in done)
    warned = sum(check.state is State.WARNING for check in done)
    print(f"{len(done)} checks: {failed} failed, {warned} warnings")
    return SOME_FAILED if failed else OK


def package_checks(pyproject: Path = PYPROJECT) -> Iterator[Check]:
    """Python, the dependencies, and each extra."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    wanted, found = SpecifierSet(project["requires-python"]), platform.python_version()
    if found in wanted:
        yield Check("python", State.OK, found)
    else:
        yield Check("python", State.FAILED, f"{found}; install one that is {wanted}")
    yield _group("packages", project["dependencies"], needed=True)
    for extra, lines in project.get("optional-dependencies", {}).items():
        yield _group(f"extra {extra}", lines, needed=extra == NEEDED)


def _group(name: str, lines: list[str], *, needed: bool) -> Check:
    """Requirements that are met, missing or met by a version out of range."""
    absent, wrong = [], []
    requirements = [Requirement(line) for line in lines]
    here = [one for one in requirements if one.marker is None or one.marker.evaluate()]
    for requirement in here:
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            absent.append(str(requirement))
            continue
        if not requirement.specifier.contains(found, prereleases=True):
            wrong.append(f"{requirement.name} {found} is not {requirement.specifier}")
    there = len(here) - len(absent)
    message = f"{there} of {len(here)} there"
    if wrong or (absent and needed):
        found_wrong = [*wrong, *(f"{one} is missing" for one in absent if needed)]
        return Check(name, State.FAILED, f"{message}: {', '.join(found_wrong)}; run make install")
    if absent:
        return Check(name, State.OK, f"{message}; without {', '.join(absent)}")
    return Check(name, State.OK, f"{message}, in range")


def result_checks(root: Path, *, quarantine: bool) -> Iterator[Check]:
    """One check after the other of an existing root; `quarantine` moves damaged runs aside."""
    found = load_runs(root)
    yield runs(root, found, quarantine=quarantine)
    yield missing(root)
    yield arithmetic(found.runs["folder"])
    files, links = contents(root)
    yield partial(files)
    yield temporary(files)
    yield locks(files)
    yield leading_out(root, links)


def contents(root: Path) -> tuple[list[Path], list[Path]]:
    """All files and all symbolic links below the root, without following any; not what is aside."""
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


def runs(root: Path, found: Runs, *, quarantine: bool) -> Check:
    """Finished runs, and those whose files do not match their checksums."""
    message = f"{len(found.runs)} finished, {len(found.curves):,} rows of curves"
    damaged = found.damaged
    if damaged.empty:
        return Check("runs", State.OK, message)
    message = f"{message}, {len(damaged)} damaged: {_some(damaged['reason'].tolist())}"
    if not quarantine:
        return Check("runs", State.FAILED, f"{message}; --quarantine moves them aside")
    moved = [move_aside(root, Path(folder)) for folder in damaged["folder"]]
    kept = [folder for folder, to in zip(damaged["folder"], moved, strict=True) if to is None]
    message = f"{message}; moved {len(moved) - len(kept)} to {root / QUARANTINE}"
    if kept:
        return Check("runs", State.FAILED, f"{message}, left {_some(kept)}: in use or outside")
    return Check("runs", State.OK, f"{message}; the next sweep runs them again")


def missing(root: Path) -> Check:
    """Runs that sweeps consisted of and that have no result."""
    message = missing_runs(root)
    if message is None:
        return Check("missing runs", State.OK, "none")
    return Check("missing runs", State.WARNING, message)


def arithmetic(folders: Iterable[str]) -> Check:
    """Whether all runs were made by the same arithmetic, as far as they say."""
    kinds: dict[str, Counter[str]] = {name: Counter() for name in ARITHMETIC}
    for folder in folders:
        with contextlib.suppress(OSError, *MALFORMED):
            environment = decoded(read_bytes(f"{folder}/{ENVIRONMENT}", LARGEST_SETTINGS))
            for name, counts in kinds.items():
                if environment.get(name):
                    counts[json.dumps(environment[name])] += 1
    message = [
        f"{len(counts)} {CALLED[name]} ({', '.join(str(n) for n in counts.values())} runs)"
        for name, counts in kinds.items()
        if len(counts) > 1
    ]
    if not message:
        return Check("arithmetic", State.OK, "one CPU and one kernel of BLAS, as far as runs say")
    bits = "the same seed need not give the same bits"
    return Check("arithmetic", State.WARNING, f"runs of {' and '.join(message)}: {bits}")


def move_aside(root: Path, folder: Path) -> Path | None:
    """Move a damaged run below ROOT/.quarantine and say where; None if it is in use or outside.

    Nothing is deleted. Of a symbolic link the link is moved, whatever it leads to.
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
    """Runs that were interrupted or failed; what they found is kept."""
    found = {path.parent for path in files if path.name == PARTIAL}
    found -= {path.parent for path in files if path.name == RESULT}
    if not found:
        return Check("partial runs", State.OK, "none")
    message = f"{len(found)} interrupted or failed: {_some(found)}; the next sweep runs them again"
    return Check("partial runs", State.WARNING, message)


def temporary(files: Sequence[Path]) -> Check:
    """Files that a process was writing when it was killed."""
    stale = []
    for path in files:
        match = TEMPORARY.fullmatch(path.name)
        if match and not _alive(int(match[1])):
            stale.append(path)
    if not stale:
        return Check("temporary files", State.OK, "none of processes that have ended")
    message = f"{len(stale)} of processes that have ended: {_some(stale)}; they can be deleted"
    return Check("temporary files", State.WARNING, message)


def locks(files: Sequence[Path]) -> Check:
    """Runs that some process is running, as the kernel lists them; taking no lock ourselves."""
    try:
        lines = Path("/proc/locks").read_text(encoding="ascii").splitlines()
    except OSError:
        return Check("running", State.OK, "this system does not list locks")
    holders = {}
    for fields in (line.split() for line in lines if "->" not in line):
        major, minor, inode = fields[5].split(":")
        holders[os.makedev(int(major, 16), int(minor, 16)), int(inode)] = fields[4]
    held = []
    for path in (path for path in files if path.name == LOCK):
        with contextlib.suppress(FileNotFoundError):  # it ended meanwhile
            status = path.stat()
            process = holders.get((status.st_dev, status.st_ino))
            if process is not None:
                held.append(f"{path.parent} by process {process}")
    return Check("running", State.OK, f"{len(held)} runs: {_some(held)}" if held else "nothing")


def leading_out(root: Path, links: Sequence[Path]) -> Check:
    """Symbolic links to places outside of the root, and to nothing."""
    out = [link for link in links if not below(link, root)]
    if not out:
        return Check("links", State.OK, "none leads out")
    message = (
        f"{len(out)} lead out of {root} or nowhere: {_some(out)}; remove them, none is followed"
    )
    return Check("links", State.FAILED, message)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def _some(things: Sequence[object] | set[Path]) -> str:
    """The first few, and how many more."""
    named = sorted(map(str, things))
    more = f" and {len(named) - SHOWN} more" * (len(named) > SHOWN)
    return ", ".join(named[:SHOWN]) + more


def main() -> None:
    """Diagnose, and exit with the code that fits."""
    guarded(diagnose)


if __name__ == "__main__":
    main()
