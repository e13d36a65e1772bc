"""Cost of an empty task: by processes and Dask of this project, and by other libraries.

python -m experiments.benchmarks.tasks [--quick] [--output FOLDER]

Each library runs 1,000 tasks that return their argument, with two workers. The start of the workers
is measured separately, up to the end of their first tasks. The median of several turns counts. A
note names each library that is not installed. Optuna runs its trials in threads; Ray Tune runs a
tenth of the tasks, because it takes minutes.
"""

from __future__ import annotations

import importlib
import operator
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager, redirect_stdout
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.benchmarks.bars import AT_MOST, Bar, Measured, benchmark
from experiments.benchmarks.engines import DASK, PROCESSES, engines, started
from miho.parallel.process_executor import ProcessExecutor

TASKS, WORKERS, TURNS = 1000, 2, 5
TENTH = 10
LIMITS = {"miho, processes": 1.0, "miho, Dask": 3.0}
Run = Callable[[int], object]
"""Runs a number of empty tasks."""


@contextmanager
def pool(engine: str) -> Iterator[Run]:
    """Workers as in searches: calls of a shared function, with retries and measured times."""
    with started(engine, WORKERS) as (workers, _):
        yield lambda count: list(workers.map(operator.pos, range(count)))


@contextmanager
def executor(create: Callable[[], Any]) -> Iterator[Run]:
    """An executor of `concurrent.futures`."""
    with create() as workers:
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


@contextmanager
def ray_tune() -> Iterator[Run]:
    """A tenth of the trials; `measure` multiplies their seconds."""
    ray, tune = importlib.import_module("ray"), importlib.import_module("ray.tune")
    ray.init(num_cpus=WORKERS, log_to_driver=False, include_dashboard=False)
    try:

        def run(count: int) -> object:
            settings = tune.TuneConfig(num_samples=max(1, count // TENTH))
            with Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere):
                return tune.Tuner(lambda config: {"loss": 0.0}, tune_config=settings).fit()

        yield run
    finally:
        ray.shutdown()


FORMS: dict[str, Callable[[], AbstractContextManager[Run]]] = {
    "miho, processes": lambda: pool(PROCESSES),
    "miho, its executor": lambda: executor(lambda: ProcessExecutor(WORKERS)),
    "miho, Dask": lambda: pool(DASK),
    "concurrent.futures": lambda: executor(lambda: ProcessPoolExecutor(WORKERS)),
    "joblib (loky)": loky,
    "Optuna (threads)": optuna,
    "Ray Tune": ray_tune,
}
LIBRARIES = {"joblib (loky)": "joblib", "Optuna (threads)": "optuna", "Ray Tune": "ray"}


def measure(quick: bool) -> Measured:
    """Measure the seconds of the start and of the tasks of each form."""
    rows, notes, versions = [], [], {}
    for name, opened in FORMS.items():
        if name == "miho, Dask" and DASK not in engines():
            notes.append(f"left out: {name}, which is not installed (extra cluster)")
            continue
        slow = TENTH if name == "Ray Tune" else 1
        began = time.perf_counter()
        try:
            with opened() as run:
                run(WORKERS)
                start = time.perf_counter() - began
                for turn in range(2 if quick else TURNS):
                    began = time.perf_counter()
                    run(TASKS)
                    seconds = slow * (time.perf_counter() - began)
                    rows.append({"form": name, "turn": turn, "start": start, "seconds": seconds})
        except ModuleNotFoundError as error:
            notes.append(f"left out: {name}, which is not installed ({error})")
            continue
        if name in LIBRARIES:
            versions[LIBRARIES[name]] = version(LIBRARIES[name])
    frame = pd.DataFrame(rows)
    medians = frame.groupby("form", sort=False)[["start", "seconds"]].median().reset_index()
    medians["speedup"] = float(medians["seconds"].iloc[0]) / medians["seconds"]
    table = medians.assign(us_a_task=1e6 * medians["seconds"] / TASKS).drop(columns="speedup")
    of = dict(zip(medians["form"], medians["seconds"], strict=True))
    bars = [
        Bar(f"{TASKS:,} tasks of nothing, {name}", of.get(name, np.nan), AT_MOST, limit, "s")
        for name, limit in LIMITS.items()
        if name in of
    ]
    facts = {"tasks": TASKS, "workers": WORKERS, "versions": versions, "seed": None}
    return Measured(table, medians, bars, notes, facts)


if __name__ == "__main__":
    benchmark(__doc__, measure, "tasks")
