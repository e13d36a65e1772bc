"""Intervals by the bootstrap: how estimates scatter over data sets drawn from the rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.identification.refit import refit
from miho.identification.uncertainty import events_of
from miho.quantities import Array


def bootstrap(
    problem: CurveFit,
    theta: Array,
    replicates: int,
    rng: np.random.Generator,
    progress: Callable[[], object] = lambda: None,
    held: Sequence[int] = (),
) -> Array:
    """Estimates (replicates, d) from rows drawn with replacement, near the optimum `theta` (d,).

    Whole rows are drawn (Efron and Tibshirani 1993, Ch. 9.5), so that nothing is assumed of the
    errors but that rows are independent; whole events, if the data have a column that numbers
    them. The parameters at the positions `held` stay where they are. `progress` is called after
    every replicate.
    """
    event = events_of(problem.dataset)
    index = np.arange(len(problem.dataset)) if event is None else event
    units = int(index.max()) + 1
    estimates = np.empty((replicates, theta.size))
    for replicate in range(replicates):
        counts = rng.multinomial(units, np.full(units, 1 / units))
        weights = counts[index].astype(float)
        estimates[replicate] = refit(problem, theta, weights, held, tolerance=1e-6).theta
        progress()
    return estimates


def percentile_intervals(replicates: Array, units: int, freedom: int, level: float = 0.95) -> Array:
    """Lower and upper percentiles of each column of (n, q) replicates, (q, 2).

    The percentiles are a little further out than the level says, by what Student's t and the
    `freedom` left of the `units` drawn (rows, or events) make a normal interval wider (Hesterberg,
    The American Statistician 69, 2015): the plain ones are too narrow for small samples.
    """
    reach = math.sqrt(units / freedom) * scipy.special.stdtrit(freedom, (1 + level) / 2)
    tail = float(scipy.special.ndtr(-reach))
    return np.quantile(replicates, [tail, 1 - tail], axis=0).T
