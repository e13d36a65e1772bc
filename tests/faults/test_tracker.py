"""A tracker that is down, slow, full or of another version while runs are made (R20)."""

from __future__ import annotations

import contextlib
import errno
import importlib.util
import io
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from experiments.app.mirror import (
    Entry,
    Synced,
    Tracker,
    digest_of,
    is_right,
    mirror,
    numbers_of,
    sync,
)
from experiments.app.mlflow_tracker import connect
from miho.optim import Budget, RandomSearch, minimize
from miho.study import Identity, Store, execute, load_runs, read_run
from miho.study.store import StoredRun
from miho.testing import DecayFit
from tests.faults.conftest import Figures

FAULTS = ("down", "slow", "full", "version")
RUNS, MLFLOW_RUNS = 100, 20
SLOW_SECONDS, PATIENCE = 2.0, 40.0
"""Of a call to the slow tracker, and after which a mirror must have given up."""


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


@pytest.mark.slow
@pytest.mark.fault(
    row="R20",
    fault="tracker down, slow (2 s per call), full or of another version",
    promise="0 runs fail or slow: it is written after the last; sync catches up, rows equal files",
)
def test_tracker(tmp_path: Path, measured: Figures, thorough: bool) -> None:
    """Make trivial runs, mirror them into a tracker with each fault, then sync and compare.

    MLflow itself, on SQLite, is the last tracker where it is installed.
    """
    texts, runs = [], RUNS if thorough else RUNS // 4
    for fault in FAULTS:
        root, rows = tmp_path / fault, tmp_path / f"{fault}_tracker"
        rows.mkdir()
        failed = _sweep(root, runs)
        lines, seconds = _mirrored(root, partial(_connected, rows, fault))
        synced, equal = _catches_up(root, FolderTracker(rows))
        texts.append(f"{fault} given up after {seconds:.1f} s, {equal}/{runs}")
        measured(f"rows equal after sync: {', '.join(texts)}")
        assert failed == 0
        assert equal == runs
        assert lines == 1
        assert seconds < PATIENCE
        assert synced.repaired > 0 or fault != "full"
    if importlib.util.find_spec("mlflow"):
        root = tmp_path / "mlflow"
        failed = _sweep(root, MLFLOW_RUNS)
        lines, _ = _mirrored(root, partial(connect, root))
        _, equal = _catches_up(root, connect(root))
        texts.append(f"MLflow on SQLite {equal}/{MLFLOW_RUNS}")
        measured(f"rows equal after sync: {', '.join(texts)}")
        assert failed == 0
        assert equal == MLFLOW_RUNS
        assert lines == 0


def _connected(rows: Path, fault: str) -> FolderTracker:
    if fault == "version":
        raise RuntimeError("database schema is of another version")
    return FolderTracker(rows, fault)


def _sweep(root: Path, runs: int) -> int:
    """How many of some trivial runs are not there after they were made."""
    budget = Budget(evaluations=20)
    for seed in range(runs):
        identity = Identity("decay", "random", seed, {"optimizer": {}}, "c0de", "da7a")
        job = partial(minimize, RandomSearch(), DecayFit(), budget, seed)
        execute(Store(root), identity, job, DecayFit.space, {"unit": "V"})
    return runs - len(load_runs(root).runs)


def _mirrored(root: Path, connected: Callable[[], Tracker]) -> tuple[int, float]:
    """How many lines a mirror printed about what is missing, and its seconds."""
    printed, began = io.StringIO(), time.perf_counter()
    with contextlib.redirect_stderr(printed):
        mirror(root, _folders(root), connected)
    return printed.getvalue().count("experiments.sync"), time.perf_counter() - began


def _catches_up(root: Path, healthy: Tracker) -> tuple[Synced, int]:
    """What a sync did, and how many rows equal the files; none if a second sync finds work."""
    folders = _folders(root)
    first, second = sync(folders, healthy), sync(folders, healthy)
    entries = {entry.id: entry for entry in healthy.entries()}
    files = [read_run(folder) for folder in folders]
    if not len(entries) == len(files) == second.there:
        return first, 0
    return first, sum(is_right(entries[stored.result["id"]], stored) for stored in files)


def _folders(root: Path) -> list[Path]:
    return [Path(folder) for folder in load_runs(root).runs["folder"]]
