"""A tracker that is down, slow, full or of another version while runs are made (R20)."""

from __future__ import annotations

import contextlib
import errno
import importlib.util
import io
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from experiments.app.mirror import Tracker, digest_of, mirror, sync
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

    def digests(self) -> set[str]:
        """Read all files."""
        self._call()
        return {path.read_text() for path in self.folder.glob("*.txt")}

    def add(self, stored: StoredRun) -> None:
        """Write half of a run, which is all that fits where the disk is full, then the rest."""
        self._call()
        path, digest = self.folder / f"{stored.result['id']}.txt", digest_of(stored)
        path.write_text(digest[:32])
        self._call()
        if self.fault == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        path.write_text(digest)

    def _call(self) -> None:
        if self.fault == "slow":
            time.sleep(SLOW_SECONDS)
        if self.fault == "down":
            raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))


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
        equal = _catches_up(root, FolderTracker(rows))
        texts.append(f"{fault} given up after {seconds:.1f} s, {equal}/{runs}")
        measured(f"rows equal after sync: {', '.join(texts)}")
        assert failed == 0
        assert equal == runs
        assert lines == 1
        assert seconds < PATIENCE
    if importlib.util.find_spec("mlflow"):
        root = tmp_path / "mlflow"
        failed = _sweep(root, MLFLOW_RUNS)
        lines, _ = _mirrored(root, partial(connect, root))
        equal = _catches_up(root, connect(root))
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


def _catches_up(root: Path, healthy: Tracker) -> int:
    """How many rows equal the files after a sync; none if a second sync finds work."""
    folders = _folders(root)
    sync(folders, healthy)
    again, digests = sync(folders, healthy), healthy.digests()
    if not len(digests) == len(folders) == again.there:
        return 0
    return sum(digest_of(read_run(folder)) in digests for folder in folders)


def _folders(root: Path) -> list[Path]:
    return [Path(folder) for folder in load_runs(root).runs["folder"]]
