"""Run folders: written once, read with their checksums, never half there.

    root/<problem>/<optimizer>/<id>/config.json environment.json curve.json result.json

`result.json` is written last and carries the SHA-256 of the other files and of itself: it is the
only sign that a run is done. A held lock is the only sign that one is running.
"""

from __future__ import annotations

import contextlib
import errno
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
from miho.study.places import inside
from miho.study.redaction import redacted

CONFIG, ENVIRONMENT, CURVE, RESULT = "config.json", "environment.json", "curve.json", "result.json"
PARTIAL = "partial.json"
SUPERSEDED = ".superseded"
RESOLUTION = 1e-3
SPACING = 1e-2
"""Stored curves are exact to this fraction of the loss, or of the evaluations and seconds."""
LARGEST = 256 << 20
"""No file of a run is larger, in bytes; whatever is, is not read."""
CHUNK = 64 << 10


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
        """Where this run lies, or will lie; raises PermissionError if that is not in the root."""
        return inside(self.root, identity.problem, identity.optimizer, identity.id)

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
            write_text(folder / name, text, last=False)
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
        partial = {"outcome": str(record.outcome), "error": record.error, "curve": _curve(record)}
        return self._keep(identity, partial)

    def keep_reason(self, identity: Identity, reason: str, detail: str | None) -> Path:
        """Keep why a run was lost with its process, and its traceback if there is one."""
        error = redacted(detail or reason)
        return self._keep(identity, {"outcome": "lost", "error": error, "curve": None})

    def reason(self, identity: Identity) -> str | None:
        """Why a run that was tried is not done, in one line; None if it was not tried."""
        try:
            partial = json.loads((self.folder(identity) / PARTIAL).read_bytes())
            told = str(partial["error"] or partial["outcome"]).strip()
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            return None
        return told.splitlines()[-1][:200] if told else None

    def _keep(self, identity: Identity, partial: Mapping[str, Any]) -> Path:
        folder = self.folder(identity)
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / PARTIAL, canonical(partial))
        return folder / PARTIAL

    def others(self, identity: Identity) -> list[Path]:
        """Folders of finished runs of the same request, but of other code, data or packages."""
        folder = self.folder(identity)
        if not folder.parent.is_dir():
            return []
        alike = folder.parent.glob(f"{identity.request}*/{RESULT}")
        return sorted(path.parent for path in alike if path.parent.name != folder.name)

    def set_aside(self, folder: Path) -> None:
        """Move a run out of the sight of readers, below SUPERSEDED."""
        place = self.root / SUPERSEDED / folder.relative_to(self.root)
        place.parent.mkdir(parents=True, exist_ok=True)
        folder.replace(place)


class NoResult(DamagedRun):
    """A run folder without a result: its run is not done."""


def read_run(folder: Path) -> StoredRun:
    """Read one run folder; raises DamagedRun with the reason if anything does not match."""
    result, files = read_checked(str(folder))
    try:
        contents = {name: json.loads(data) for name, data in files.items()}
    except (ValueError, RecursionError) as error:
        raise DamagedRun(f"{folder}: {type(error).__name__}: {error}") from None
    return StoredRun(folder, contents[CONFIG], contents[ENVIRONMENT], contents[CURVE], result)


def read_checked(folder: str) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The result of a run, and its other files as bytes, all as their checksums say.

    Raises NoResult if the run is not done, and DamagedRun with the reason if anything does not
    match.
    """
    try:
        data = read_bytes(f"{folder}/{RESULT}")
    except FileNotFoundError:
        raise NoResult(f"{folder}: holds no {RESULT}") from None
    except OSError as error:
        raise DamagedRun(f"{folder}/{RESULT}: {error.strerror}") from None
    try:
        result = json.loads(data)
        signature = f',"sha256":"{result.pop("sha256")}"'.encode()
        if signature != f',"sha256":"{sha256(data.replace(signature, b"", 1))}"'.encode():
            raise DamagedRun(f"{folder}/{RESULT}: checksum does not match")
        files = {}
        for name in (CONFIG, ENVIRONMENT, CURVE):
            files[name] = read_bytes(f"{folder}/{name}")
            if sha256(files[name]) != result["files"][name]:
                raise DamagedRun(f"{folder}/{name}: checksum does not match")
        named = [result["problem"], result["optimizer"], result["id"]]
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise DamagedRun(f"{folder}: {type(error).__name__}: {error}") from None
    if folder.split("/")[-3:] != named:
        raise DamagedRun(f"{folder}: holds the run {'/'.join(map(str, named))}")
    return result, files


def read_bytes(path: str) -> bytes:
    """A whole file; raises OSError for a symbolic link and for what is larger than LARGEST.

    A pipe gives nothing or an error, so that no reader waits for it.
    """
    chunks, size = [], 0
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        while chunk := os.read(descriptor, CHUNK):
            chunks.append(chunk)
            size += len(chunk)
            if size > LARGEST:
                raise OSError(errno.EFBIG, f"is larger than {LARGEST >> 20} MiB", path)
    finally:
        os.close(descriptor)
    return b"".join(chunks)


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
    }


def write_text(path: Path, text: str, *, last: bool = True) -> None:
    """Replace a file in one step: readers see the old one or the new one, whole.

    Of several files in a folder the last one makes the names of all of them lasting.
    An OSError names the file.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.unlink(missing_ok=True)
        with temporary.open("x", encoding="utf-8") as file:  # never through a link left there
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        if last:
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
