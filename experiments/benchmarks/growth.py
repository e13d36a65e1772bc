"""How the cost of an evaluation grows with the rows of the data.

python -m experiments.benchmarks.growth [--quick] [--output FOLDER]

As in MIHO, the evaluations are mutants of a good configuration of the left front tire, with the
sigmas of a rung from the largest to the smallest. `whole` evaluates all rows; `stopped` abandons a
mutant when it can no longer be better than that configuration.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.schema import register
from experiments.benchmarks.bars import AT_MOST, Bar, Measured, benchmark, interleaved
from experiments.benchmarks.figures import growth_figure
from miho.compiled import Steps
from miho.identification import CurveFit
from miho.optim import MIHO, minimize
from miho.optim.mutation import annealed_sigma, mutate
from miho.optim.seeds import stream

Array = NDArray[np.float64]

ROWS = (3000, 30_000, 300_000, 3_000_000)
BAR = 1.5


def of_size(rows: int) -> CurveFit:
    """The tire's problem with this many rows."""
    return build(composed([f"dataset.n={rows}", "dataset=tire_lf"])).problem


def stopped(problem: CurveFit, mutants: Array, loss: float) -> None:
    """Evaluate every mutant until it is known to exceed the same loss."""
    climb = None if problem.kernel is None else problem.kernel.climb
    if climb is None:
        raise RuntimeError("the problem has no compiled steps")
    none, L = np.empty((0, *mutants.shape)), np.full(len(mutants), loss)
    steps = Steps(mutants, mutants.copy(), L, none, none[:, 0], problem.space.bounds)
    climb(steps, -math.inf, -math.inf)


def measure(quick: bool) -> Measured:
    """Measure microseconds per evaluation, the least of several alternating batches."""
    register()
    tidy = []
    theta = minimize(MIHO(R=1000, eta=5), of_size(ROWS[0])).theta
    if theta is None:
        raise RuntimeError("the run evaluated no valid configuration")
    # The mutants that MIHO would evaluate around a good configuration, on each number of rows.
    for rows in ROWS[:-1] if quick else ROWS:
        fit = of_size(rows)
        n = 30 if rows > 100_000 else 300
        sigma, rng, space = annealed_sigma(fit.space, n), stream("growth"), fit.space
        mutants = np.vstack([mutate(theta[None], s, space, rng, "box") for s in sigma])
        loss = fit.loss(theta[None])
        jobs: dict[str, Callable[[], object]] = {
            "whole": partial(fit.loss, mutants),
            "stopped": partial(stopped, fit, mutants, loss[0]),
        }
        seconds = interleaved(jobs, 3 if rows > 1_000_000 else 10)
        tidy += [{"rows": rows, "method": k, "us": 1e6 * s / n} for k, s in seconds.items()]
    # The printed table, and the bar on the growth of the whole loss.
    frame = pd.DataFrame(tidy)
    table = frame.pivot(index="rows", columns="method", values="us")[list(jobs)]
    table.columns = pd.Index([f"{name} [us]" for name in table.columns])
    cost = frame[frame["method"] == "whole"].set_index("rows")["us"]
    largest = int(cost.index.max())
    bars = [
        Bar(f"a row of {largest:,} against one of 30,000",
            cost[largest] / largest / (cost[30_000] / 30_000), AT_MOST, BAR, "times"),
    ]  # fmt: skip
    return Measured(table.reset_index(), frame, bars, [])


if __name__ == "__main__":
    benchmark(__doc__, measure, growth_figure, "growth")
