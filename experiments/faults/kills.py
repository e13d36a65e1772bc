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
FIRST, LIVES = 5, 6
"""So many runs are timed before; a sweep lives for a random time, at most that of so many runs."""


def kills(folder: Path, times: int = KILLS) -> Row:
    """Kill a sweep of 50 runs again and again; begin another when it is done, finish the last."""
    chance, longest = random.Random(1), LIVES * _seconds_of_a_run(folder)
    killed = sweeps = finished = lost = repeated = unreadable = 0
    while killed < times:
        root, log = folder / f"runs{sweeps}", folder / f"log{sweeps}"
        seen: dict[Path, bytes] = {}
        sweeps += 1
        while len(seen) < RUNS:
            before, done = begun(log), {_seed(data) for data in seen.values()}
            child = forked(_sweep, root, log)
            if killed < times:
                time.sleep(chance.uniform(0.001, longest))
                os.kill(child, signal.SIGKILL)
                killed += 1
            os.waitpid(child, 0)
            now = {path: path.read_bytes() for path in root.glob("*/*/*/result.json")}
            lost += sum(now.get(path) != data for path, data in seen.items())
            repeated += sum((begun(log) - before)[seed] for seed in done)
            finished += len(now) - len(seen) if killed < times else 0
            seen = now
        unreadable += len(load_runs(root).damaged)
        lost += RUNS - len(load_runs(root).runs)
    return Row(
        "R1", "SIGKILL of a sweep, rerun", "0 runs lost, 0 repeated, 0 unreadable files",
        f"{killed} kills, {finished} runs finished between them: {lost} lost, {repeated} repeated, "
        f"{unreadable} unreadable",
        lost == repeated == unreadable == 0 and finished >= times / 4,
    )  # fmt: skip


def _seconds_of_a_run(folder: Path) -> float:
    """In a child, which starts with all that this process has loaded by then."""
    do(folder / "first", 0, folder / "first log")
    began = time.perf_counter()
    os.waitpid(forked(_sweep, folder / "timed", folder / "timed log", FIRST), 0)
    return (time.perf_counter() - began) / FIRST


def _sweep(root: Path, log: Path, runs: int = RUNS) -> None:
    for seed in range(runs):
        do(root, seed, log, seconds=0.002)


def _seed(result: bytes) -> int:
    return int(json.loads(result)["seed"])
