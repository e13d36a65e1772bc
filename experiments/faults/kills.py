"""R1: a sweep that is killed again and again."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from pathlib import Path

from experiments.faults.row import Row
from experiments.faults.trivial import begun, do, forked
from miho.study import load_runs

KILLS, RUNS = 200, 50


def kills(folder: Path) -> Row:
    """Kill a sweep of 50 runs 200 times; whenever it is done, begin another."""
    chance = random.Random(1)
    do(folder / "warm", 0, folder / "warm log")  # a child starts with what this has loaded
    killed = sweeps = lost = repeated = unreadable = 0
    while killed < KILLS:
        root, log = folder / f"runs{sweeps}", folder / f"log{sweeps}"
        seen: dict[Path, bytes] = {}
        sweeps += 1
        while len(seen) < RUNS:
            before, done = begun(log), {_seed(data) for data in seen.values()}
            child = forked(_sweep, root, log)
            time.sleep(chance.uniform(0.001, 0.15))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            killed += 1
            now = {path: path.read_bytes() for path in root.glob("*/*/*/result.json")}
            lost += sum(now.get(path) != data for path, data in seen.items())
            repeated += sum((begun(log) - before)[seed] for seed in done)
            seen = now
        unreadable += len(load_runs(root).damaged) if root.is_dir() else 0
        lost += RUNS - len(load_runs(root).runs)
    measured = f"{killed} kills: {lost} lost, {repeated} repeated, {unreadable} unreadable"
    return Row(
        "R1", "SIGKILL of a sweep, rerun", "0 runs lost, 0 repeated, 0 unreadable files",
        measured, lost == repeated == unreadable == 0,
    )  # fmt: skip


def _sweep(root: Path, log: Path) -> None:
    for seed in range(RUNS):
        do(root, seed, log, seconds=0.002)


def _seed(result: bytes) -> int:
    return int(json.loads(result)["seed"])
