"""The store of runs: folders that are written once and read with their checksums.

    root/<problem>/<optimizer>/<id>/config.json environment.json curve.json result.json

`result.json` is written last and contains the SHA-256 of the other files and of itself: its
presence alone marks a finished run. A held lock alone marks a run in progress. `partial.json`, with
a checksum, is the partial result of an unfinished run, and `journal` keeps its expensive
evaluations, with a checksum in each line.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from miho.moved import with_present_names
from miho.optim import RunRecord, Space
from miho.study.files import (
    CONFIG,
    CURVE,
    ENVIRONMENT,
    JOURNAL,
    LARGEST,
    PARTIAL,
    RESULT,
    DamagedRun,
    read_bytes,
    read_checked,
    read_signed,
    signed,
    write_bytes,
    write_text,
)
from miho.study.identity import REQUEST, Identity, canonical, inside, sha256
from miho.study.redaction import redacted

FILES = (CONFIG, ENVIRONMENT, CURVE, RESULT, PARTIAL)
"""All files of a run, in the order of writing."""
SUPERSEDED = ".superseded"
RESOLUTION = 1e-3
SPACING = 1e-2
"""Stored curves are exact to these fractions of the loss (RESOLUTION) and of the evaluations and
seconds (SPACING)."""


class RunInUse(Exception):  # noqa: N818 -- another process holds the run, not an error
    """Another process is running this run."""


@dataclass(frozen=True)
class StoredRun:
    """A finished run: its folder, and the contents of its files."""

    folder: Path
    config: Mapping[str, Any]
    environment: Mapping[str, Any]
    curve: Mapping[str, list[Any]]
    result: Mapping[str, Any]


@dataclass(frozen=True)
class Store:
    """All runs below a root folder."""

    root: Path

    def folder(self, identity: Identity) -> Path:
        """Folder of this run; raises PermissionError if it is not in the root."""
        return inside(self.root, identity.problem, identity.optimizer, identity.id)

    def find(self, identity: Identity) -> StoredRun | None:
        """The finished run, or None; a damaged run gives None, so that it runs again."""
        folder = self.folder(identity)
        if not self.has_result(identity):
            return None
        try:
            return read_run(folder)
        except DamagedRun:
            return None

    def result(self, identity: Identity) -> Mapping[str, Any] | None:
        """The `result` of `find` alone; the other files are only checked."""
        try:
            return read_checked(str(self.folder(identity)))[0]
        except DamagedRun:
            return None

    def lost_result(self, identity: Identity) -> bool:
        """Return whether the result is missing although the files that precede it exist.

        It was deleted, or the run was killed in its last millisecond.
        """
        folder = self.folder(identity)
        return (folder / CURVE).is_file() and not (folder / RESULT).exists()

    def has_result(self, identity: Identity) -> bool:
        """Return whether there is a result, without checking it."""
        return (self.folder(identity) / RESULT).is_file()

    @contextmanager
    def claim(self, identity: Identity) -> Iterator[None]:
        """Hold this run's lock; raises RunInUse if another process holds it."""
        folder = self.folder(identity)
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with FileLock(folder / "lock", timeout=0):
                yield
        except Timeout:
            raise RunInUse(str(folder)) from None

    def commit(
        self,
        identity: Identity,
        record: RunRecord,
        space: Space,
        environment: Mapping[str, Any],
        facts: Mapping[str, Any],
    ) -> StoredRun:
        """Write a finished run and read it back.

        `space` has its parameters, `environment` is as from `environment_stamp`, and `facts` are of
        its problem (unit, irreducible error ...).
        """
        folder = self.folder(identity)
        contents = {
            CONFIG: canonical(dict(identity.config)),
            ENVIRONMENT: canonical(dict(environment)),
            CURVE: canonical(_curve(record)),
        }
        for name, text in contents.items():
            write_text(folder / name, text, last=False)
        result = {
            **_result(identity, record, space),
            "facts": dict(facts),
            "files": {name: sha256(text) for name, text in contents.items()},
        }
        write_text(folder / RESULT, signed(result))
        for name in (PARTIAL, JOURNAL):
            (folder / name).unlink(missing_ok=True)
        return read_run(folder)

    def files(self, identity: Identity) -> dict[str, bytes]:
        """The files of a run as bytes, to be received by another store."""
        folder = self.folder(identity)
        present = [name for name in FILES if (folder / name).is_file()]
        return {name: read_bytes(str(folder / name), LARGEST) for name in present}

    def receive(self, identity: Identity, files: Mapping[str, bytes]) -> None:
        """Store a run from another store, whose `files` gave the bytes; requires a claim.

        The result is written last, as in `commit`. Raises DamagedRun if the files are not a
        complete run.
        """
        folder = self.folder(identity)
        folder.mkdir(parents=True, exist_ok=True)
        for name in FILES:
            if name in files:
                write_bytes(folder / name, files[name], last=name in (RESULT, PARTIAL))
        if RESULT in files:
            (folder / PARTIAL).unlink(missing_ok=True)
            read_run(folder)

    def journal(self, identity: Identity) -> Path:
        """Path of the file that keeps this run's evaluations until it is finished."""
        return self.folder(identity) / JOURNAL

    def keep_partial(self, identity: Identity, record: RunRecord) -> Path:
        """Write the curve of an interrupted or failed run, which stays unfinished."""
        partial = {"outcome": str(record.outcome), "error": record.error, "curve": _curve(record)}
        return self._keep(identity, partial)

    def keep_reason(
        self, identity: Identity, reason: str, detail: str | None, outcome: str = "lost"
    ) -> Path:
        """Write the reason why a run ended with its process, and the traceback if there is one."""
        error = redacted(detail or reason)
        return self._keep(identity, {"outcome": outcome, "error": error, "curve": None})

    def reason(self, identity: Identity) -> str | None:
        """The reason in one line why an attempted run is unfinished; None if unknown."""
        try:
            partial = read_signed(f"{self.folder(identity)}/{PARTIAL}")
            message = str(partial["error"] or partial["outcome"]).strip()
        except (OSError, DamagedRun, LookupError):
            return None
        return message.splitlines()[-1][:200] if message else None

    def _keep(self, identity: Identity, partial: Mapping[str, Any]) -> Path:
        folder = self.folder(identity)
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / PARTIAL, signed(partial))
        return folder / PARTIAL

    def outdated(self, identities: Iterable[Identity]) -> Iterator[tuple[Identity, Path]]:
        """Folders of finished runs of the same requests that have other code, data or packages.

        Each folder is listed once, so that thousands of runs are found in a second.
        """
        listed: dict[tuple[str, str], dict[str, list[str]]] = {}
        for identity in identities:
            place = identity.problem, identity.optimizer
            if place not in listed:
                listed[place] = _runs_by_request(inside(self.root, *place))
            for name in listed[place].get(identity.request, ()):
                folder = self.root.joinpath(*place, name)
                if name != identity.id and (folder / RESULT).is_file():
                    yield identity, folder

    def set_aside(self, folder: Path) -> None:
        """Move a superseded run to SUPERSEDED, which no reader scans; nothing there is overwritten.

        Damaged runs are quarantined elsewhere, by `experiments.doctor`.
        """
        first = place = inside(self.root, SUPERSEDED, *folder.relative_to(self.root).parts)
        for number in count(2):
            if not place.exists():
                break
            place = first.with_name(f"{first.name}.{number}")
        place.parent.mkdir(parents=True, exist_ok=True)
        folder.replace(place)


def _runs_by_request(folder: Path) -> dict[str, list[str]]:
    """Sorted names of the runs in a folder, by the request at their beginning."""
    runs: dict[str, list[str]] = {}
    for name in sorted(path.name for path in folder.iterdir()) if folder.is_dir() else ():
        runs.setdefault(name[:REQUEST], []).append(name)
    return runs


def read_run(folder: Path) -> StoredRun:
    """Read a run folder; raises DamagedRun for any mismatch with the checksums."""
    result, files = read_checked(str(folder))
    try:
        contents = {name: json.loads(data) for name, data in files.items()}
    except (ValueError, RecursionError) as error:
        raise DamagedRun(f"{folder}: {type(error).__name__}: {error}") from None
    config = with_present_names(contents[CONFIG])
    return StoredRun(folder, config, contents[ENVIRONMENT], contents[CURVE], result)


def _curve(record: RunRecord) -> dict[str, list[Any]]:
    """The improvements of a run, thinned out, and its end, by column.

    Some methods improve at every step by little. An improvement is omitted only if it lowers the
    loss by less than RESOLUTION and follows the last row of the curve within SPACING of the
    evaluations and seconds: every target is met at most 1 % later than in the run, and none
    earlier.
    """
    trace = record.trace
    rows: list[int] = []
    for row in range(len(trace)):
        last = rows[-1] if rows else -1
        if (
            last < 0
            or trace.loss[row] <= (1 - RESOLUTION) * trace.loss[last]
            or trace.evaluations[row] >= (1 + SPACING) * trace.evaluations[last]
            or trace.seconds[row] >= (1 + SPACING) * trace.seconds[last]
        ):
            rows.append(row)
    end = len(trace) - 1
    if rows and rows[-1] != end:
        rows.append(end)
    names = ("evaluations", "seconds", "cpu_seconds", "loss")
    curve: dict[str, list[Any]] = {
        name: [getattr(trace, name)[row] for row in rows] for name in names
    }
    curve["theta"] = [trace.theta[row].tolist() for row in rows]
    # A run continues after its last improvement: one more row marks its end.
    if rows and record.evaluations > trace.evaluations[end]:
        for name in names:
            curve[name].append(getattr(record, name))
        curve["theta"].append(curve["theta"][-1])
    return curve


def _result(identity: Identity, record: RunRecord, space: Space) -> dict[str, Any]:
    return {
        "id": identity.id,
        "problem": identity.problem,
        "optimizer": identity.optimizer,
        "seed": identity.seed,
        "code": identity.code,
        "data": identity.data,
        "packages": dict(identity.packages),
        "outcome": str(record.outcome),
        "loss": record.loss if math.isfinite(record.loss) else None,
        "theta": None if record.theta is None else record.theta.tolist(),
        "parameters": [{"name": p.name, "unit": p.unit} for p in space.parameters],
        "evaluations": record.evaluations,
        "seconds": record.seconds,
        "cpu_seconds": record.cpu_seconds,
        "setup_seconds": record.setup_seconds,
        "rejected": dict(record.rejected),
        "outside": record.outside,
        "descents": None if record.descents is None else asdict(record.descents),
        "usage": None if record.usage is None else record.usage.stored,
    }
