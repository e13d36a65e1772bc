"""Intervals by bootstrap: what the estimate would have been on other data of the same kind."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from miho.identification.curve_fit import CurveFit
from miho.identification.refit import refit

Array = NDArray[np.float64]


def bootstrap(
    problem: CurveFit,
    theta: Array,
    replicates: int,
    rng: np.random.Generator,
    each: Callable[[], object] = lambda: None,
) -> Array:
    """Estimates (replicates, d) from rows drawn with replacement, near the optimum `theta` (d,).

    Whole rows are drawn (Efron and Tibshirani 1993, Ch. 9.5), so that nothing is assumed of the
    errors but that rows are independent: not for samples of a driving log that follow each other.
    `each` is called after every replicate, for progress.
    """
    rows = len(problem.dataset)
    found = np.empty((replicates, theta.size))
    for replicate in range(replicates):
        weights = rng.multinomial(rows, np.full(rows, 1 / rows)).astype(float)
        found[replicate] = refit(problem, theta, weights, tolerance=1e-6).theta
        each()
    return found


def percentile_intervals(replicates: Array, level: float = 0.95) -> Array:
    """Lower and upper percentiles of each column, (q, 2)."""
    tail = (1 - level) / 2
    return np.quantile(replicates, [tail, 1 - tail], axis=0).T
