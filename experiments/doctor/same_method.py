"""A method against itself: two names, one time, or the clock cannot be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miho.optim import Budget, Parameter, Problem, RandomSearch, RunRecord, Space, minimize
from miho.study import single_thread
from miho.study.validity import stamped

Array = NDArray[np.float64]

PAIRS, SECONDS = 40, 0.02
CPU_RATIO, WALL_RATIO = (0.95, 1.05), (0.90, 1.10)


class Waves(Problem):
    """Mean square of sines at 200 points over (n, 3) amplitudes: some microseconds a row."""

    name = "waves"
    space = Space(tuple(Parameter(name, "-", -1.0, 1.0) for name in "abc"))

    def __init__(self) -> None:
        self._basis = np.sin(np.outer([1.0, 2.0, 3.0], np.linspace(0.0, 6.0, 200)))

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,)."""
        values = np.sin(thetas[:, :1] * self._basis[0]) + thetas[:, 1:2] * self._basis[1]
        return np.asarray(((values + thetas[:, 2:] * self._basis[2]) ** 2).mean(axis=1))


@dataclass(frozen=True, eq=False)
class Pairs:
    """Seconds (n, 2) of wall and CPU time under two names, and whether each run was valid."""

    wall: Array
    cpu: Array
    valid: NDArray[np.bool_]

    @property
    def cpu_ratio(self) -> float:
        """Total CPU time of the first name by that of the second."""
        return _ratio(self.cpu)

    @property
    def wall_ratio(self) -> float:
        """Total wall time of the first name by that of the second."""
        return _ratio(self.wall)

    def outside(self) -> list[str]:
        """The ratios that leave their intervals, in words."""
        told = []
        for name, ratio, (low, high) in (
            ("CPU", self.cpu_ratio, CPU_RATIO),
            ("wall", self.wall_ratio, WALL_RATIO),
        ):
            if not low <= ratio <= high:
                told.append(f"{name} ratio {ratio:.3f} outside {low:g} to {high:g}")
        return told


def same_method_twice(
    evaluations: int,
    pairs: int = PAIRS,
    *,
    interleaved: bool = True,
    halfway: Callable[[], None] | None = None,
) -> Pairs:
    """Random search by two names, `pairs` times each: ABBA in turn, or all of A before all of B.

    `halfway` is called between the first half of all runs and the second.
    """
    order = [(pair, name) for pair in range(pairs) for name in ((0, 1), (1, 0))[pair % 2]]
    if not interleaved:
        order.sort(key=lambda run: run[1])
    wall, cpu = np.empty((pairs, 2)), np.empty((pairs, 2))
    valid = np.zeros((pairs, 2), bool)
    for number, (pair, name) in enumerate(order):
        if number == pairs and halfway is not None:
            halfway()
        with single_thread(), stamped() as stamp:
            record = _search(pair, Budget(evaluations=evaluations))
        wall[pair, name], cpu[pair, name] = record.seconds, record.cpu_seconds
        valid[pair, name] = stamp.judge(record.seconds, record.cpu_seconds).valid
    return Pairs(wall, cpu, valid)


def evaluations_in(seconds: float = SECONDS) -> int:
    """How many evaluations take so much CPU time here."""
    with single_thread():
        record = _search(0, Budget(evaluations=5000))
        record = _search(0, Budget(evaluations=5000))
    return max(1, int(5000 * seconds / record.cpu_seconds))


def _search(seed: int, budget: Budget) -> RunRecord:
    return minimize(RandomSearch(batch=100), Waves(), budget, seed)


def _ratio(seconds: Array) -> float:
    first, second = seconds.sum(axis=0)
    return float(first / second)
