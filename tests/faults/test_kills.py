"""R1 and R5: sweeps of quick runs that are killed, alone and many on one folder of results."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from miho.optim import Budget, Parameter, Problem, RandomSearch, RunRecord, Space, minimize
from miho.quantities import Array
from miho.study import Execution, Identity, Status, Store, execute, load_runs
from tests.faults.conftest import Figures

SPACE = Space((Parameter("x", "1", -1.0, 1.0), Parameter("y", "1", -1.0, 1.0)))

KILLS, FEWER_KILLS, RUNS = 200, 40, 50
FIRST, LIVES = 5, 6
"""So many runs are timed before; a sweep lives for a random time, at most that of so many runs."""
PROCESSES, SHARED_RUNS, KILLED = 8, 800, 3


@pytest.mark.slow
@pytest.mark.fault(
    row="R1",
    fault="SIGKILL of a sweep, rerun",
    promise="0 runs lost, 0 repeated, 0 unreadable files",
)
def test_kills(tmp_path: Path, measured: Figures, thorough: bool) -> None:
    """Kill a sweep of 50 runs again and again; begin another when it is done, finish the last."""
    times = KILLS if thorough else FEWER_KILLS
    chance, longest = random.Random(1), LIVES * seconds_of_a_run(tmp_path)
    killed = sweeps = finished = lost = repeated = unreadable = 0
    while killed < times:
        root, log = tmp_path / f"runs{sweeps}", tmp_path / f"log{sweeps}"
        seen: dict[Path, bytes] = {}
        sweeps += 1
        while len(seen) < RUNS:
            before, done = begun(log), {seed_of(data) for data in seen.values()}
            child = forked(sweep, root, log)
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
    measured(
        f"{killed} kills, {finished} runs finished between them: {lost} lost, {repeated} repeated, "
        f"{unreadable} unreadable"
    )
    assert lost == repeated == unreadable == 0
    assert finished >= times / 4


@pytest.mark.slow
@pytest.mark.fault(
    row="R5",
    fault="8 processes on one root, 3 killed",
    promise="all rows after one rerun, each run done once",
)
def test_processes_that_share_a_root(tmp_path: Path, measured: Figures) -> None:
    """Eight processes share 800 runs, three are killed, one call does the rest."""
    root, log = tmp_path / "runs", tmp_path / "log"
    children = [forked(share, root, log, tmp_path, k) for k in range(PROCESSES)]
    chance = random.Random(5)
    for child in children[:KILLED]:
        time.sleep(chance.uniform(0.1, 0.5))
        os.kill(child, signal.SIGKILL)
    for child in children:
        os.waitpid(child, 0)
    finished = {path.parent.name for path in root.glob("*/*/*/result.json")}
    errors = sum(1 for _ in tmp_path.glob("error*"))
    share(root, log, tmp_path, PROCESSES)
    runs = load_runs(root).runs
    extra = begun(log).total() - SHARED_RUNS
    measured(
        f"{len(finished)} runs before the rerun, {len(runs)} after it, {runs['id'].nunique()} ids, "
        f"{errors} errors, {extra} begun again (at most {KILLED} were cut short)"
    )
    assert len(runs) == SHARED_RUNS == runs["id"].nunique()
    assert errors == 0
    assert 0 <= extra <= KILLED


class Bowl(Problem):
    """x^2 + y^2, after some seconds of nothing."""

    name, space = "bowl", SPACE

    def __init__(self, seconds: float = 0.0) -> None:
        self.seconds = seconds

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        if self.seconds:
            time.sleep(self.seconds)
        return np.asarray((thetas**2).sum(axis=1))


def do(root: Path, seed: int, log: Path, seconds: float = 0.0) -> Execution:
    """Do the run of this seed, unless it is done; the log gets a line when it begins."""

    def job() -> RunRecord:
        with log.open("a", encoding="utf-8") as file:
            file.write(f"{seed}\n")
        return minimize(RandomSearch(batch=5), Bowl(seconds), Budget(evaluations=5), seed)

    identity = Identity("bowl", "random", seed, {"evaluations": 5}, "code", "data")
    return execute(Store(root), identity, job, SPACE, {"unit": "1"})


def begun(log: Path) -> Counter[int]:
    """How often each seed's run began."""
    lines = log.read_text(encoding="utf-8").split() if log.exists() else []
    return Counter(map(int, lines))


def forked(task: Callable[..., object], *arguments: object) -> int:
    """The process id of a child that calls the task and ends; nothing is imported again."""
    pid = os.fork()
    if pid:
        return pid
    try:
        task(*arguments)
    finally:
        os._exit(0)


def sweep(root: Path, log: Path, runs: int = RUNS) -> None:
    for seed in range(runs):
        do(root, seed, log, seconds=0.002)


def seconds_of_a_run(folder: Path) -> float:
    """In a child, which starts with all that this process has loaded by then."""
    do(folder / "first", 0, folder / "first log")
    began = time.perf_counter()
    os.waitpid(forked(sweep, folder / "timed", folder / "timed log", FIRST), 0)
    return (time.perf_counter() - began) / FIRST


def seed_of(result: bytes) -> int:
    return int(json.loads(result)["seed"])


def share(root: Path, log: Path, folder: Path, number: int) -> None:
    """Do what nobody else does, in an order of one's own, until all is done."""
    seeds = list(range(SHARED_RUNS))
    random.Random(number).shuffle(seeds)
    try:
        while seeds:
            busy = [s for s in seeds if do(root, s, log).status is Status.RUNNING_ELSEWHERE]
            if len(busy) == len(seeds):
                time.sleep(0.01)
            seeds = busy
    except Exception as error:  # noqa: BLE001 -- what must not happen is counted
        (folder / f"error{number}").write_text(repr(error), encoding="utf-8")
