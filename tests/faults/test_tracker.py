"""A tracker that is down, slow, full or of another version while runs are made (R20)."""

from __future__ import annotations

import contextlib
import errno
import importlib.util
import io
import json
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from experiments.machine import busy_cores
from experiments.mirror import (
    Entry,
    Mirror,
    Synced,
    Tracker,
    digest_of,
    follow,
    is_right,
    mlflow_mirror,
    numbers_of,
    sync,
)
from experiments.sync import connect
from miho.optim import Budget, RandomSearch, minimize
from miho.study import Identity, Store, execute, load_runs, read_run
from miho.study.store import StoredRun
from miho.testing import DecayFit
from tests.faults.conftest import Figures, skip_if_busy

FAULTS = ("down", "slow", "full", "version")
RUNS, MLFLOW_RUNS = 100, 20
GOAL = 0.01
SLOW_SECONDS, START_SECONDS = 2.0, 60.0
READY = "ready"


@dataclass(frozen=True)
class FolderTracker(Tracker):
    """A file per run, written in two steps as MLflow's are, with one fault or none."""

    folder: Path
    fault: str = ""

    def alone(self) -> contextlib.AbstractContextManager[None]:
        """One process writes in this row."""
        return contextlib.nullcontext()

    def entries(self, run: str | None = None) -> list[Entry]:
        """Read all files, or those of one run."""
        self._call()
        paths = sorted(self.folder.glob(f"{run or '*'}.json"))
        return [Entry(**json.loads(path.read_bytes())) for path in paths]

    def add(self, stored: StoredRun) -> None:
        """Write half of a run, which is all that fits where the disk is full, then the rest."""
        self._call()
        name = stored.result["id"]
        half = Entry(name, name, digest_of(stored), whole=False, numbers={})
        self._write(half)
        self._call()
        if self.fault == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._write(Entry(name, name, half.digest, whole=True, numbers=numbers_of(stored)))

    def remove(self, entry: Entry) -> None:
        """Delete the file."""
        self._call()
        (self.folder / f"{entry.key}.json").unlink()

    def _call(self) -> None:
        if self.fault == "slow":
            time.sleep(SLOW_SECONDS)
        if self.fault == "down":
            raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))

    def _write(self, entry: Entry) -> None:
        path = self.folder / f"{entry.key}.json"
        path.write_text(json.dumps(vars(entry)), encoding="utf-8")


@pytest.mark.timed
@pytest.mark.fault(
    row="R20",
    fault="tracker down, slow (2 s per call), full or of another version",
    promise="0 runs fail or slow (< 1 %), sync catches up, rows equal files",
)
def test_tracker(tmp_path: Path, measured: Figures) -> None:
    """Make trivial runs beside a tracker with each fault, then sync and compare with the files.

    MLflow itself, on SQLite, is the last tracker where it is installed.
    """
    mirrors = {fault: _start(tmp_path, fault) for fault in FAULTS}
    for fault in FAULTS:
        _wait_for(_tracked(tmp_path, fault) / READY)
    figures, caught_up, quick = [], True, True
    busy = busy_cores()
    for fault, (mirror, seconds) in mirrors.items():
        failed, share, lines = _sweep(mirror, RUNS, seconds)
        synced, equal = _catches_up(tmp_path / fault, FolderTracker(_tracked(tmp_path, fault)))
        figures.append(f"{fault} {100 * share:.2f} % {equal}/{RUNS}")
        quick = quick and share < GOAL
        caught_up = caught_up and failed == 0 and equal == RUNS and lines == 1
        caught_up = caught_up and (synced.repaired > 0 or fault != "full")
    if importlib.util.find_spec("mlflow"):
        root = tmp_path / "mlflow"
        failed, _, _ = _sweep(mlflow_mirror(root, None, None), MLFLOW_RUNS, 0.0)
        _, equal = _catches_up(root, connect(root))
        figures.append(f"MLflow on SQLite {equal}/{MLFLOW_RUNS}")
        caught_up = caught_up and failed == 0 and equal == MLFLOW_RUNS
    measured(f"mirror's share of the sweep, rows equal after sync: {', '.join(figures)}")
    assert caught_up
    if not quick:
        skip_if_busy(busy)
    assert quick


def _tracked(folder: Path, fault: str) -> Path:
    return folder / f"{fault}_tracker"


def _start(folder: Path, fault: str) -> tuple[Mirror, float]:
    """A mirror in the faulty tracker, and the seconds that its start takes."""
    rows = _tracked(folder, fault)
    rows.mkdir()
    command = [sys.executable, "-m", "tests.faults.test_tracker", fault, str(rows)]
    began = time.perf_counter()
    mirror = Mirror(folder / fault, command, {})
    return mirror, time.perf_counter() - began


def _wait_for(path: Path) -> None:
    deadline = time.monotonic() + START_SECONDS
    while not path.exists():
        if time.monotonic() > deadline:
            raise TimeoutError(f"{path}: the tracker has not started in {START_SECONDS:.0f} s")
        time.sleep(0.02)


def _sweep(mirror: Mirror, runs: int, spent: float) -> tuple[int, float, int]:
    """How many runs are not there, the mirror's share of the time, and how many lines it said."""
    began = time.perf_counter()
    budget = Budget(evaluations=20)
    for seed in range(runs):
        identity = Identity("decay", "random", seed, {"optimizer": {}}, "c0de", "da7a")
        job = partial(minimize, RandomSearch(), DecayFit(), budget, seed)
        done = execute(Store(mirror.root), identity, job, DecayFit.space, {"unit": "V"})
        if done.run is not None:
            before = time.perf_counter()
            mirror.push(done.run)
            spent += time.perf_counter() - before
    total = time.perf_counter() - began
    message = io.StringIO()
    with contextlib.redirect_stderr(message):
        mirror.close(1.0)
    lines = message.getvalue().count("experiments.sync")
    return runs - len(load_runs(mirror.root).runs), spent / total, lines


def _catches_up(root: Path, healthy: Tracker) -> tuple[Synced, int]:
    """What a sync did, and how many rows equal the files; none if a second sync finds work."""
    first, second = sync(root, healthy), sync(root, healthy)
    entries = {entry.id: entry for entry in healthy.entries()}
    files = [read_run(Path(folder)) for folder in load_runs(root).runs["folder"]]
    if not len(entries) == len(files) == second.there:
        return first, 0
    return first, sum(is_right(entries[stored.result["id"]], stored) for stored in files)


def _follow(fault: str, rows: str) -> None:
    """The process of a mirror, with a tracker that has a fault."""
    (Path(rows) / READY).touch()

    def connected(_: Mapping[str, Any]) -> FolderTracker:
        if fault == "version":
            raise RuntimeError("database schema is of another version")
        return FolderTracker(Path(rows), fault)

    follow(connected)


if __name__ == "__main__":
    _follow(*sys.argv[1:])
