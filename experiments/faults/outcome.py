"""What became of rows, each run in a process of its own, within a time limit."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing import connection
from pathlib import Path
from typing import Any

from experiments.faults.identifying import descendants
from experiments.faults.registry import Entry
from experiments.faults.row import NOT_JUDGED, Row

LIMIT_SECONDS = 240.0
STOP_SECONDS = 5.0
MET, MISSED, MISSING, BROKEN = "met", "MISSED", "missing", "BROKEN"
PRELOADED = ("experiments.faults.outcome", "experiments.faults.called")
"""What the server of the rows' processes imports once, so that no row has to."""


@dataclass(frozen=True)
class Outcome:
    """A row, how it ended and what it took; `verdict` is met, MISSED, not judged or why not."""

    entry: Entry
    row: Row
    verdict: str
    seconds: float

    @property
    def fine(self) -> bool:
        """Whether nothing is to be mended: a row that the machine does not let judge is fine."""
        return self.verdict in (MET, NOT_JUDGED)


@dataclass
class _Running:
    """A row in progress: its process, which leads a group, and where it will say what it found."""

    entry: Entry
    limit: float
    folder: tempfile.TemporaryDirectory[str] = field(init=False)
    pipe: connection.Connection = field(init=False)
    process: Any = field(init=False)
    started: float = field(default_factory=time.perf_counter)

    def __post_init__(self) -> None:
        self.folder = tempfile.TemporaryDirectory(
            prefix=f"{self.entry.name}-", ignore_cleanup_errors=True
        )
        context = _context()
        self.pipe, theirs = context.Pipe(duplex=False)
        given = self.entry, Path(self.folder.name), theirs
        self.process = context.Process(target=_work, args=given)
        self.process.start()
        theirs.close()

    @property
    def left(self) -> float:
        """Seconds until its time limit."""
        return max(0.0, self.started + self.limit - time.perf_counter())

    def outcome(self) -> Outcome | None:
        """What became of it, if it has ended or is out of time."""
        found: Row | str
        if self.pipe.poll():
            try:
                found = self.pipe.recv()
            except EOFError:
                found = f"its process {self.process.pid} ended without a word"
        elif self.left > 0:
            return None
        else:
            found = f"stopped after {self.limit:g} s"
        return _judged(self.entry, found, time.perf_counter() - self.started)

    def end(self, grace: float = 0.0) -> None:
        """End it, if it does not in some seconds, and all it started."""
        family = descendants(self.process.pid)
        self.process.join(grace)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        for pid in family:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.join(STOP_SECONDS)
        self.pipe.close()


def run_rows(
    entries: Iterable[Entry], at_once: int = 1, limit: float = LIMIT_SECONDS
) -> Iterator[Outcome]:
    """Do rows in fresh folders, `at_once` at a time, those that judge seconds first, one by one.

    Of the others, what is long comes first and what is quick late, to fill the gaps. The folders
    are removed at the end: where many files were just deleted, ext4 creates new ones ten times as
    slowly for half a minute.

    A row and all it started end with it, at `limit` seconds, or with the iteration. Outcomes come
    as rows end.
    """
    waiting = deque(sorted(entries, key=lambda one: (not one.timed, not one.long, one.quick)))
    running: list[_Running] = []
    folders: list[tempfile.TemporaryDirectory[str]] = []
    try:
        while waiting or running:
            alone = any(one.entry.timed for one in running)
            while waiting and not alone and len(running) < at_once:
                entry = waiting.popleft()
                alone = entry.timed and entry.exists
                if entry.exists:
                    running.append(_Running(entry, limit))
                    folders.append(running[-1].folder)
                else:
                    yield Outcome(entry, _empty(entry, f"no {entry.name}.py here"), MISSING, 0.0)
            if not running:
                continue
            connection.wait([one.pipe for one in running], min(one.left for one in running))
            for one in list(running):
                outcome = one.outcome()
                if outcome is not None:
                    running.remove(one)
                    one.end(0.0 if outcome.verdict == BROKEN else STOP_SECONDS)
                    yield outcome
    finally:
        for one in running:
            one.end()
        for folder in folders:
            folder.cleanup()


def _judged(entry: Entry, found: Row | str, seconds: float) -> Outcome:
    if isinstance(found, str):
        return Outcome(entry, _empty(entry, found), BROKEN, seconds)
    if found.measured.startswith(NOT_JUDGED):
        return Outcome(entry, found, NOT_JUDGED, seconds)
    return Outcome(entry, found, MET if found.met else MISSED, seconds)


def _context() -> Any:
    """Processes are forked from a server that imported everything once, where the system can."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(PRELOADED))
    return context


def _work(entry: Entry, folder: Path, theirs: connection.Connection) -> None:
    """In the process of the row: lead a group of its own, so that all of it can be ended."""
    os.setsid()
    try:
        theirs.send(entry.load()(folder))
    except BaseException:  # noqa: BLE001 -- whatever ends it is what it has to tell
        theirs.send(traceback.format_exc().strip().splitlines()[-1])


def _empty(entry: Entry, told: str) -> Row:
    return Row(entry.number, f"({entry.name})", "-", told, met=False)
