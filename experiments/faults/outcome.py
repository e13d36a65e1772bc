"""What became of a row, run on its own: in a process of its own, within a time limit."""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import time
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from experiments.faults.registry import Entry
from experiments.faults.row import Row

LIMIT_SECONDS = 90.0
STOP_SECONDS = 5.0
NOT_JUDGED = "not judged"
MET, MISSED, MISSING, BROKEN = "met", "MISSED", "missing", "BROKEN"


@dataclass(frozen=True)
class Outcome:
    """A row, how it ended and what it took; `verdict` is met, MISSED, not judged or why not."""

    row: Row
    verdict: str
    seconds: float

    @property
    def fine(self) -> bool:
        """Whether nothing is to be mended: a row that the machine does not let judge is fine."""
        return self.verdict in (MET, NOT_JUDGED)


def run_row(entry: Entry, limit: float = LIMIT_SECONDS) -> Outcome:
    """Do one row in a fresh folder; it and all it started end with it or at the time limit."""
    if not entry.exists:
        return Outcome(_empty(entry, f"no {entry.name}.py here"), MISSING, 0.0)
    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix=f"{entry.name}-", ignore_cleanup_errors=True) as folder:
        spawn = multiprocessing.get_context("spawn")
        ours, theirs = spawn.Pipe(duplex=False)
        process = spawn.Process(target=_work, args=(entry, Path(folder), theirs))
        process.start()
        theirs.close()
        try:
            found = _received(ours, limit, process.pid)
        finally:
            _end(process.pid)
            process.kill()
            process.join(STOP_SECONDS)
    seconds = time.perf_counter() - started
    if isinstance(found, str):
        return Outcome(_empty(entry, found), BROKEN, seconds)
    if found.measured.startswith(NOT_JUDGED):
        return Outcome(found, NOT_JUDGED, seconds)
    return Outcome(found, MET if found.met else MISSED, seconds)


def _received(ours: Connection, limit: float, process: int | None) -> Row | str:
    """The row, or in words why there is none."""
    if not ours.poll(limit):
        return f"stopped after {limit:g} s"
    try:
        found: Row | str = ours.recv()
    except EOFError:
        return f"its process {process} ended without a word"
    return found


def _work(entry: Entry, folder: Path, theirs: Connection) -> None:
    """In the process of the row: lead a group of its own, so that all of it can be ended."""
    os.setsid()
    try:
        theirs.send(entry.load()(folder))
    except BaseException:  # noqa: BLE001 -- whatever ends it is what it has to tell
        theirs.send(traceback.format_exc().strip().splitlines()[-1])


def _end(process: int | None) -> None:
    """End the group that this process leads, if it has come so far as to lead one."""
    if process is None:
        return
    try:
        os.killpg(process, signal.SIGKILL)
    except ProcessLookupError:
        return


def _empty(entry: Entry, told: str) -> Row:
    return Row(entry.number, f"({entry.name})", "-", told, met=False)
