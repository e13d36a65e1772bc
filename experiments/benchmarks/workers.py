"""Efficiency of workers with sleeping models and with a cheap model.

python -m experiments.benchmarks.workers [--quick] [--output FOLDER]

With sleeping models a machine of few cores can run many workers. *Efficiency* is the total seconds
of the evaluations over the wall seconds times the number of workers, in batches of equal
evaluations of 100 ms, the median of five runs. Workers start before the measurement; the time of
their start is listed separately. *Cheap* is the cost of `workers=2` relative to `workers=1` for a
model of 1 µs, in alternating calls of `minimize`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from functools import partial
from itertools import chain

import numpy as np
import pandas as pd

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.schema import register
from experiments.benchmarks.bars import AT_LEAST, AT_MOST, Bar, Measured, benchmark, shown
from experiments.benchmarks.engines import DASK, PROCESSES, engines, started
from experiments.benchmarks.sleeping import Lengths, Sleeping, search
from miho.optim import MIHO, Budget, Optimizer, Problem, RandomSearch, Space, minimize
from miho.parallel import Evaluations
from miho.quantities import Array

SECONDS = 0.1
SIZES = (1, 2, 4, 8, 16, 32, 64)
BATCH = 256
PER_CORE, REPEATS = 8, 5
EACH = 20
"""Least number of evaluations per worker; the total is at least a batch of 64."""
LIMITS = {8: 0.9, 64: 0.8}
CHEAP = 5.0
HARMONICS = np.arange(1.0, 21.0)


def sizes_of(engine: str) -> list[int]:
    """Numbers of workers, for Dask at most PER_CORE per core.

    A worker of Dask is a Python process that exchanges heartbeats with the scheduler.
    """
    most = SIZES[-1] if engine == PROCESSES else PER_CORE * (os.cpu_count() or 1)
    return [size for size in SIZES if size <= most]


def efficiencies(quick: bool) -> Iterator[dict[str, object]]:
    """A row for each engine, number of workers and seed."""
    for engine in engines():
        for size in (2, 8) if quick else sizes_of(engine):
            count = 64 * max(1, -(-EACH * size // 64))
            with started(engine, size) as (pool, start):
                for seed in range(1 if quick else REPEATS):
                    ended = search(
                        RandomSearch(batch=BATCH), Sleeping(Lengths(SECONDS)), Evaluations(pool),
                        Budget(evaluations=count), seed,
                    )  # fmt: skip
                    yield {
                        "kind": "efficiency",
                        "name": engine,
                        "workers": size,
                        "seed": seed,
                        "evaluations": count,
                        "seconds": ended.seconds,
                        "start_seconds": start,
                        "efficiency": SECONDS * count / (size * ended.seconds),
                    }


class Bowl(Problem):
    """Harmonics of the distance to the middle of the box: about 1 µs a row, in plain NumPy."""

    name = "bowl"

    def __init__(self, space: Space) -> None:
        self.space = space
        self._middle, self._width = (space.low + space.high) / 2, space.high - space.low

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,)."""
        scaled = (thetas - self._middle) / self._width
        return np.asarray((1 - np.cos(HARMONICS * scaled[..., None])).mean(axis=(1, 2)))


def cheap(quick: bool) -> Iterator[dict[str, object]]:
    """A row for each turn of a cheap model, compiled and not."""
    register()
    compiled: Problem = build(composed(["dataset.n=300", "dataset=tire_lf"])).problem
    models: dict[str, tuple[Problem, Optimizer]] = {
        "compiled": (compiled, MIHO()),
        "plain": (Bowl(compiled.space), RandomSearch()),
    }
    for name, (problem, optimizer) in models.items():
        budget = Budget(evaluations=100_000 if quick else 300_000)
        runs = {k: partial(minimize, optimizer, problem, budget, workers=k) for k in (1, 2)}
        for run in runs.values():
            run()
        for turn in range(4 if quick else 20):
            row: dict[str, object] = {"kind": "cheap", "name": name, "seed": 0}
            # The order alternates as well, because a run may affect the next one by memory.
            for workers in sorted(runs, reverse=bool(turn % 2)):
                began = time.perf_counter()
                record = runs[workers]()
                row[f"seconds_{workers}"] = time.perf_counter() - began
                row["evaluations"] = record.evaluations
                if record.usage is not None:
                    row["says"] = str(record.usage)
            yield row


def _bars(frame: pd.DataFrame) -> list[Bar]:
    """Bars of the measured rows."""
    bars = []
    rows = frame[(frame["kind"] == "efficiency") & frame["workers"].isin(LIMITS)]
    for engine in rows["name"].unique():
        for size, limit in LIMITS.items():
            several = rows.loc[(rows["name"] == engine) & (rows["workers"] == size), "efficiency"]
            if several.size:
                name = f"efficiency of {size} workers, {engine}"
                bars.append(Bar(name, several.median(), AT_LEAST, limit))
    for form, turns in frame[frame["kind"] == "cheap"].groupby("name"):
        loss = 100 * float((turns["seconds_2"] / turns["seconds_1"]).median() - 1)
        bars.append(Bar(f"workers=2 against workers=1, {form} model", loss, AT_MOST, CHEAP, "%"))
    return bars


def measure(quick: bool) -> Measured:
    """Measure all rows; the table has the medians over seeds and turns."""
    frame = pd.DataFrame(list(shown(chain(cheap(quick), efficiencies(quick)))))
    numbers = [column for column in frame if column not in ("kind", "name", "seed", "says")]
    groups = frame.assign(workers=frame["workers"].fillna(1)).groupby(
        ["kind", "name", "workers"], sort=False
    )
    table = groups[[column for column in numbers if column != "workers"]].median().reset_index()
    table.insert(3, "runs", groups.size().to_numpy())
    notes = [f"cheap, {row['name']}, workers=2 says: {row['says']}"
             for row in frame[frame["kind"] == "cheap"].groupby("name").last().reset_index()
             .to_dict("records")]  # fmt: skip
    left_out = len(SIZES) - len(sizes_of(DASK))
    if left_out:
        notes.append(
            f"left out: Dask with more than {sizes_of(DASK)[-1]} workers, {PER_CORE} a core"
        )
    if len(engines()) == 1:
        notes.append("left out: Dask, which is not installed (extra cluster)")
    facts = {"seconds": SECONDS, "batch": BATCH, "seeds": "column seed"}
    return Measured(table.astype(object).fillna(""), frame, _bars(frame), notes, facts)


if __name__ == "__main__":
    benchmark(__doc__, measure, "workers")
