"""Cost of an evaluation of nothing: its record, and its way to a worker and back.

python -m experiments.benchmarks.overhead [--quick] [--output FOLDER]

The cost of the recorder is the difference between calls of `Oracle` and direct calls of the loss.
Its bar is for batches of 10 and more in which no row improves; single rows and improvements cost
more. Processes and Dask run 1,000 tasks that return their argument, with two workers, which
start before. The median of several turns counts.
"""

import operator
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.benchmarks.bars import Measured, at_most, benchmark, interleaved
from experiments.benchmarks.sleeping import DASK, PROCESSES, engines, started
from miho.optim import Budget, Oracle, Parameter, Problem, Space
from miho.quantities import Array

BATCHES = (1, 10, 100, 1000)
TASKS, WORKERS, TURNS = 1000, 2, 5
LIMITS = {PROCESSES: 1.0, DASK: 3.0}
"""Seconds of all tasks."""


class Prepared(Problem):
    """A problem whose losses are computed in advance, so that they cost nothing."""

    name = "prepared"
    space = Space(tuple(Parameter(name, "-", 0.0, 1.0) for name in "abcde"))

    def __init__(self, losses: Array) -> None:
        self.losses = losses

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """The first n of the given losses."""
        return self.losses[: len(thetas)]

    def shift(self, lower: int) -> None:
        """Lower all losses."""
        self.losses = self.losses - lower


def shifted(oracle: Oracle, problem: Prepared, lower: int, thetas: Array) -> None:
    """Record the losses after a shift."""
    problem.shift(lower)
    oracle(thetas)


def recorder(repeats: int) -> Iterator[tuple[str, float]]:
    """Seconds per evaluation without the loss, in batches without and with improvements."""
    for batch in BATCHES:
        thetas = Prepared.space.decode(Prepared.space.initial(batch))
        for improving in (0, batch):
            problem = Prepared(-np.arange(1.0, batch + 1))
            oracle = Oracle(problem, Budget())
            oracle(thetas)
            jobs: dict[str, Callable[[], object]] = {
                "shift": partial(problem.shift, improving),
                "record": partial(shifted, oracle, problem, improving, thetas),
            }
            seconds = interleaved(jobs, repeats, atom=0.001 if improving else 0.01)
            name = f"batch of {batch}, {'all' if improving else 'none'} improve"
            yield name, (seconds["record"] - seconds["shift"]) / batch


def tasks(engine: str, turns: int) -> float:
    """Seconds of all tasks, as in searches: calls of a shared function with retries and times."""
    seconds = []
    with started(engine, WORKERS) as workers:
        for _ in range(turns):
            began = time.perf_counter()
            list(workers.map(operator.pos, range(TASKS)))
            seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


def measure(quick: bool) -> Measured:
    """Measure the recorder, then the tasks of each kind of workers."""
    rows: list[dict[str, Any]] = [
        {"name": name, "us": 1e6 * seconds} for name, seconds in recorder(5 if quick else 20)
    ]
    worst = max(row["us"] for row in rows[2:] if "none" in row["name"])
    name = "recorder per evaluation, batches of 10+, none improve"
    bars, notes = [at_most(name, worst, 1.0, "us")], []
    for engine in engines():
        seconds = tasks(engine, 2 if quick else TURNS)
        rows.append({"name": f"a task, {engine}", "us": 1e6 * seconds / TASKS})
        name = f"{TASKS:,} tasks of nothing, {engine}"
        bars.append(at_most(name, seconds, LIMITS[engine], "s"))
    if DASK not in engines():
        notes.append("left out: Dask, which is not installed (extra cluster)")
    frame = pd.DataFrame(rows)
    facts = {"tasks": TASKS, "workers": WORKERS, "seed": None}
    return Measured(frame, frame, bars, notes, facts)


if __name__ == "__main__":
    benchmark(__doc__, measure, "overhead")
