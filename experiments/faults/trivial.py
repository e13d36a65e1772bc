"""Runs that take a millisecond and leave a line in a log each time they are done."""

from __future__ import annotations

import os
import time
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miho.optim import Budget, Parameter, Problem, RandomSearch, RunRecord, Space, minimize
from miho.study import Execution, Identity, Store, execute

Array = NDArray[np.float64]
SPACE = Space((Parameter("x", "1", -1.0, 1.0), Parameter("y", "1", -1.0, 1.0)))


class Bowl(Problem):
    """x^2 + y^2, after some seconds of nothing."""

    name, space = "bowl", SPACE

    def __init__(self, seconds: float = 0.0) -> None:
        self.seconds = seconds

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,)."""
        if self.seconds:
            time.sleep(self.seconds)
        return np.asarray((thetas**2).sum(axis=1))


def identity(seed: int) -> Identity:
    """Who the run of this seed is."""
    return Identity("bowl", "random", seed, {"evaluations": 5}, "code", "data")


def do(root: Path, seed: int, log: Path, seconds: float = 0.0) -> Execution:
    """Do the run of this seed, unless it is done; the log gets a line when it begins."""

    def job() -> RunRecord:
        with log.open("a", encoding="utf-8") as file:
            file.write(f"{seed}\n")
        return minimize(RandomSearch(batch=5), Bowl(seconds), Budget(evaluations=5), seed)

    return execute(Store(root), identity(seed), job, SPACE, {"unit": "1"})


def begun(log: Path) -> Counter[int]:
    """How often each seed's run began."""
    lines = log.read_text(encoding="utf-8").split() if log.exists() else []
    return Counter(map(int, lines))


def forked(task: object, *arguments: object) -> int:
    """The process id of a child that calls the task and ends; nothing is imported again."""
    pid = os.fork()
    if pid:
        return pid
    try:
        task(*arguments)  # type: ignore[operator]
    finally:
        os._exit(0)
