"""Cost of an evaluation of nothing: its record, and its way to a worker and back.

python -m experiments.benchmarks.overhead [--quick] [--output FOLDER]

The cost of the recorder is the difference between calls of `Oracle` and direct calls of the loss.
Its bar is for batches of 10 and more in which no row improves; single rows and improvements cost
more. Each library of workers runs 1,000 tasks that return their argument, with two workers; the
start of the workers is measured separately, up to the end of their first tasks. The median of
several turns counts. A note names each library that is not installed. Optuna runs its trials in
threads.
"""

from __future__ import annotations

import importlib
import operator
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np
import pandas as pd

from experiments.benchmarks.bars import AT_MOST, Bar, Measured, benchmark, interleaved
from experiments.benchmarks.engines import DASK, PROCESSES, engines, started
from miho.optim import Budget, Oracle, Parameter, Problem, Space
from miho.quantities import Array

BATCHES = (1, 10, 100, 1000)
TASKS, WORKERS, TURNS = 1000, 2, 5
LIMITS = {"miho, processes": 1.0, "miho, Dask": 3.0}
"""Seconds of all tasks."""
Run = Callable[[int], object]
"""Runs a number of empty tasks."""


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


@contextmanager
def pool(engine: str) -> Iterator[Run]:
    """Workers as in searches: calls of a shared function, with retries and measured times."""
    with started(engine, WORKERS) as (workers, _):
        yield lambda count: list(workers.map(operator.pos, range(count)))


@contextmanager
def executor() -> Iterator[Run]:
    """The executor of `concurrent.futures`."""
    with ProcessPoolExecutor(WORKERS) as workers:
        yield lambda count: wait([workers.submit(operator.pos, k) for k in range(count)])


@contextmanager
def loky() -> Iterator[Run]:
    """joblib's default."""
    joblib = importlib.import_module("joblib")
    with joblib.Parallel(n_jobs=WORKERS) as parallel:
        yield lambda count: parallel(joblib.delayed(operator.pos)(k) for k in range(count))


@contextmanager
def optuna() -> Iterator[Run]:
    """Random trials without a suggestion."""
    library = importlib.import_module("optuna")
    library.logging.set_verbosity(library.logging.ERROR)
    study = library.create_study(sampler=library.samplers.RandomSampler(0))
    yield lambda count: study.optimize(lambda trial: 0.0, n_trials=count, n_jobs=WORKERS)


FORMS: dict[str, Callable[[], AbstractContextManager[Run]]] = {
    "miho, processes": partial(pool, PROCESSES),
    "miho, Dask": partial(pool, DASK),
    "concurrent.futures": executor,
    "joblib (loky)": loky,
    "Optuna (threads)": optuna,
}
LIBRARIES = {"joblib (loky)": "joblib", "Optuna (threads)": "optuna"}


def tasks(name: str, turns: int) -> dict[str, Any]:
    """Seconds of a start, and of all tasks."""
    began, seconds = time.perf_counter(), []
    with FORMS[name]() as run:
        run(WORKERS)
        start = time.perf_counter() - began
        for _ in range(turns):
            began = time.perf_counter()
            run(TASKS)
            seconds.append(time.perf_counter() - began)
    return {"name": f"a task, {name}", "seconds": np.median(seconds) / TASKS, "start": start}


def measure(quick: bool) -> Measured:
    """Measure the recorder, then the tasks of each library."""
    rows: list[dict[str, Any]] = [
        {"name": name, "seconds": seconds} for name, seconds in recorder(5 if quick else 20)
    ]
    worst = max(row["seconds"] for row in rows[2:] if "none" in row["name"])
    name = "recorder per evaluation, batches of 10+, none improve"
    bars, notes, versions = [Bar(name, 1e6 * worst, AT_MOST, 1.0, "us")], [], {}
    for form in FORMS:
        if form == "miho, Dask" and DASK not in engines():
            notes.append(f"left out: {form}, which is not installed (extra cluster)")
            continue
        try:
            rows.append(tasks(form, 2 if quick else TURNS))
        except ModuleNotFoundError as error:
            notes.append(f"left out: {form}, which is not installed ({error})")
            continue
        if form in LIBRARIES:
            versions[LIBRARIES[form]] = version(LIBRARIES[form])
        if form in LIMITS:
            seconds = TASKS * rows[-1]["seconds"]
            name = f"{TASKS:,} tasks of nothing, {form}"
            bars.append(Bar(name, seconds, AT_MOST, LIMITS[form], "s"))
    frame = pd.DataFrame(rows)
    frame.insert(1, "us", 1e6 * frame.pop("seconds"))
    facts = {"tasks": TASKS, "workers": WORKERS, "versions": versions, "seed": None}
    return Measured(frame.astype(object).fillna(""), frame, bars, notes, facts)


if __name__ == "__main__":
    benchmark(__doc__, measure, "overhead")
