"""Run folders: written once, read with their checksums, never half there.

    root/<problem>/<optimizer>/<id>/config.json environment.json curve.json result.json

`result.json` is written last and carries the SHA-256 of the other files and of itself: it is the
only sign that a run is done. A held lock is the only sign that one is running.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from miho.optim import RunRecord, Space
from miho.study.identity import Identity, canonical, sha256

CONFIG, ENVIRONMENT, CURVE, RESULT = "config.json", "environment.json", "curve.json", "result.json"
PARTIAL = "partial.json"
RESOLUTION = 1e-3
SPACING = 1e-2
"""Stored curves are exact to this fraction of the loss, or of the evaluations and seconds."""


class DamagedRun(Exception):  # noqa: N818 -- a finding about a folder, reported and skipped
    """A run folder whose files do not match their checksums."""


class RunInUse(Exception):  # noqa: N818 -- another process holds the run, which is no error
    """Another process is running this run."""


@dataclass(frozen=True)
class StoredRun:
    """One finished run as read back: its folder and the contents of its files."""

    folder: Path
    config: Mapping[str, Any]
    environment: Mapping[str, Any]
    curve: Mapping[str, list[Any]]
    result: Mapping[str, Any]


@dataclass(frozen=True)
class Store:
    """All runs below one root folder."""

    root: Path

    def folder(self, identity: Identity) -> Path:
        """Where this run lies, or will lie."""
        return self.root / identity.problem / identity.optimizer / identity.id

    def find(self, identity: Identity) -> StoredRun | None:
        """The finished run, or None; a damaged one is None, so that it is run anew."""
        folder = self.folder(identity)
        if not (folder / RESULT).exists():
            return None
        try:
            return read_run(folder)
        except DamagedRun:
            return None

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
        """Write a finished run; `facts` are what the problem knows of itself (unit, floor ...)."""
        folder = self.folder(identity)
        contents = {
            CONFIG: canonical(dict(identity.config)),
            ENVIRONMENT: canonical(dict(environment)),
            CURVE: canonical(_curve(record)),
        }
        for name, text in contents.items():
            write_text(folder / name, text)
        result = {
            **_result(identity, record, space),
            "facts": dict(facts),
            "files": {name: sha256(text) for name, text in contents.items()},
        }
        result["sha256"] = sha256(canonical(result))
        write_text(folder / RESULT, canonical(result))
        (folder / PARTIAL).unlink(missing_ok=True)
        return read_run(folder)

    def keep_partial(self, identity: Identity, record: RunRecord) -> Path:
        """Keep what an interrupted or failed run has found; the run is not done."""
        path = self.folder(identity) / PARTIAL
        partial = {"outcome": str(record.outcome), "error": record.error, "curve": _curve(record)}
        write_text(path, canonical(partial))
        return path


def read_run(folder: Path) -> StoredRun:
    """Read one run folder; raises DamagedRun with the reason if anything does not match."""
    try:
        result = json.loads((folder / RESULT).read_bytes())
        own = result.pop("sha256")
        if own != sha256(canonical(result)):
            raise DamagedRun(f"{folder / RESULT}: checksum does not match")
        contents = {}
        for name in (CONFIG, ENVIRONMENT, CURVE):
            data = (folder / name).read_bytes()
            if sha256(data) != result["files"][name]:
                raise DamagedRun(f"{folder / name}: checksum does not match")
            contents[name] = json.loads(data)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise DamagedRun(f"{folder}: {type(error).__name__}: {error}") from None
    place = [folder.parent.parent.name, folder.parent.name, folder.name]
    named = [result.get(key) for key in ("problem", "optimizer", "id")]
    if place != named:
        raise DamagedRun(f"{folder}: holds the run {'/'.join(map(str, named))}")
    return StoredRun(folder, contents[CONFIG], contents[ENVIRONMENT], contents[CURVE], result)


def _curve(record: RunRecord) -> dict[str, list[Any]]:
    """The improvements worth keeping, the last one, and where the run ended.

    A method that creeps improves at every step. A step is left out only if it lowers the loss by
    less than RESOLUTION and comes within SPACING of the evaluations and seconds of the last row
    kept: no target is met more than 1 % later than it was, and none earlier.
    """
    trace = record.trace
    kept: list[int] = []
    for row in range(len(trace)):
        last = kept[-1] if kept else -1
        if (
            last < 0
            or trace.loss[row] <= (1 - RESOLUTION) * trace.loss[last]
            or trace.evaluations[row] >= (1 + SPACING) * trace.evaluations[last]
            or trace.seconds[row] >= (1 + SPACING) * trace.seconds[last]
        ):
            kept.append(row)
    end = len(trace) - 1
    if kept and kept[-1] != end:
        kept.append(end)
    curve: dict[str, list[Any]] = {
        "evaluations": [trace.evaluations[row] for row in kept],
        "seconds": [trace.seconds[row] for row in kept],
        "cpu_seconds": [trace.cpu_seconds[row] for row in kept],
        "loss": [trace.loss[row] for row in kept],
        "theta": [trace.theta[row].tolist() for row in kept],
    }
    if kept and record.evaluations > trace.evaluations[end]:
        curve["evaluations"].append(record.evaluations)
        curve["seconds"].append(record.seconds)
        curve["cpu_seconds"].append(record.cpu_seconds)
        curve["loss"].append(record.loss)
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
        "outcome": str(record.outcome),
        "loss": record.loss if math.isfinite(record.loss) else None,
        "theta": None if record.theta is None else record.theta.tolist(),
        "parameters": [{"name": p.name, "unit": p.unit} for p in space.parameters],
        "evaluations": record.evaluations,
        "seconds": record.seconds,
        "cpu_seconds": record.cpu_seconds,
        "setup_seconds": record.setup_seconds,
        "rejected": dict(record.rejected),
    }


def write_text(path: Path, text: str) -> None:
    """Replace a file in one step: readers see the old one or the new one, whole."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
