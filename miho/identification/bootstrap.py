"""Intervals by the bootstrap: how estimates scatter over data sets drawn from the rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.identification.refit import refit
from miho.identification.uncertainty import Linearised, events_of
from miho.optim.space import Space
from miho.parallel.blocks import in_blocks
from miho.parallel.pool import Pool
from miho.parallel.process_executor import WorkerLostError
from miho.quantities import Array

TINY = 1e-12
"""A variance that is this fraction of another is none."""


def bootstrap(
    problem: CurveFit,
    theta: Array,
    replicates: int,
    rng: np.random.Generator,
    progress: Callable[[], object] = lambda: None,
    held: Sequence[int] = (),
    block: int = 1,
    pool: Pool | None = None,
    others: Sequence[Array] = (),
) -> Array:
    """Estimates (replicates, d) from rows drawn with replacement, near the optimum `theta` (d,).

    Whole rows are drawn (Efron and Tibshirani 1993, Ch. 9.5), so that nothing is assumed of the
    errors but that rows are independent; whole events, if the data have a column that numbers them.
    Rows that depend on their neighbours are weighted by `block` rows at a time, exponentially
    (Rubin, Annals of Statistics 9, 1981): no weight is 0, so that what only a few rows of the data
    determine stays determined. Where there are `others`, further optima (d,) within the noise, a
    replicate is refitted from each of them, and the best end counts. The parameters at the
    positions `held` stay where they are. `progress` is called after every replicate. The workers of
    a `pool` make them where they take long; they are the same without, to the last bit. Raises
    ValueError where one is lost.
    """
    event = events_of(problem.dataset)
    index = np.arange(len(problem.dataset)) if event is None else event
    units = int(index.max()) + 1

    def weights() -> Array:
        if block > 1:
            return _block_weights(units, block, rng)
        counts = rng.multinomial(units, np.full(units, 1 / units))
        return np.asarray(counts[index].astype(float))

    drawn = (weights() for _ in range(replicates))  # here, in their order, whoever refits
    estimates = np.empty((replicates, theta.size))
    refitted = _Refitted(problem, (theta, *others), held)
    for k, estimate in enumerate(in_blocks(pool, refitted, drawn)):
        if isinstance(estimate, WorkerLostError):
            raise ValueError(f"a bootstrap replicate was lost with its worker: {estimate}")
        estimates[k] = estimate
        progress()
    return estimates


@dataclass(frozen=True)
class _Refitted:
    """The best optimum (d,) of weighted rows, by descents from the optima of equal weights."""

    problem: CurveFit
    starts: Sequence[Array]
    held: Sequence[int]

    def __call__(self, weights: Array) -> Array:
        ends = [
            refit(self.problem, start, weights, self.held, tolerance=1e-6) for start in self.starts
        ]
        return min(ends, key=lambda end: end.cost).theta


def block_length(errors: Array) -> int:
    """Rows to draw together, for errors (N,) that depend on their neighbours.

    The length of circular blocks that Politis and White estimate (Econometric Reviews 23, 2004),
    corrected by Patton, Politis and White (Econometric Reviews 28, 2009): the autocovariances that
    differ from 0, weighted by a flat-top window. 1 where none does.
    """
    rows = errors.size
    run, farthest = max(5, int(np.sqrt(np.log10(rows)))), math.ceil(math.sqrt(rows))
    centred = errors - errors.mean()
    lags = min(farthest + run, rows - 1)
    products = np.array([centred[k:] @ centred[: rows - k] for k in range(lags + 1)]) / rows
    large = np.abs(products[1:]) > 2 * np.sqrt(np.log10(rows) / rows) * products[0]
    # The last lag before a run of small ones, or the last large one.
    runs = np.convolve(~large, np.ones(run, dtype=int), "valid")
    quiet = np.flatnonzero(runs == run)
    last = int(quiet[0]) if quiet.size else int(np.flatnonzero(large)[-1]) + 1
    k = np.arange(1, min(2 * max(last, 1), lags) + 1)
    window = np.minimum(1.0, 2 * (1 - k / k[-1]))
    slope = 2 * float(np.sum(window * k * products[k]))
    spectrum = products[0] + 2 * float(np.sum(window * products[k]))
    length = (1.5 * (slope / spectrum) ** 2 * rows) ** (1 / 3)
    return max(1, round(min(float(length), 3 * math.sqrt(rows), rows / 3)))


def stretched(replicates: Array, at: Linearised, space: Space) -> Array:
    """Replicates (n, d) of blocks, stretched about the optimum to the spread of `at.sandwich`.

    Blocks cut what depends on each other, and the errors of a fit vary less than those of the
    data, so that replicates scatter too little, the more the stronger the dependence. The linear
    map is the one nearest to none that takes their covariance to the sandwich; its standard
    deviations are half of what holds the middle 68 %, since blocks may hold all rows that
    determine a parameter. Parameters without a standard error stay, all stay within the box, and
    replicates that are too few to know their covariance stay as they are.
    """
    below, above = np.quantile(replicates, scipy.special.ndtr([-1.0, 1.0]), axis=0)
    known = np.flatnonzero(np.isfinite(at.standard_errors) & (above > below))
    if len(replicates) <= 2 * known.size or not known.size:
        return replicates
    deviations = (above - below)[known] / 2
    correlation = np.atleast_2d(np.corrcoef(replicates[:, known].T))
    drawn = correlation * np.outer(deviations, deviations)
    target = at.sandwich[np.ix_(known, known)]
    root = np.linalg.cholesky(target + TINY * np.diag(np.diag(at.covariance)[known]))
    inner = scipy.linalg.solve_triangular(root, drawn, lower=True)
    inner = scipy.linalg.solve_triangular(root, inner.T, lower=True)
    size, axes = np.linalg.eigh(inner)
    away = scipy.linalg.solve_triangular(root, (replicates - at.theta)[:, known].T, lower=True)
    stretch = axes / np.sqrt(np.maximum(size, TINY)) @ axes.T
    result = replicates.copy()
    result[:, known] = at.theta[known] + (root @ stretch @ away).T
    return np.clip(result, space.low, space.high)


def _block_weights(rows: int, block: int, rng: np.random.Generator) -> Array:
    """A weight for each row (N,), the same within blocks of rows that begin anywhere."""
    place = (np.arange(rows) + rng.integers(rows)) % rows // block
    return np.asarray(rng.exponential(size=-(-rows // block))[place])


def percentile_intervals(replicates: Array, units: int, freedom: int, level: float = 0.95) -> Array:
    """Lower and upper percentiles of each column of (n, q) replicates, (q, 2).

    The percentiles are a little further out than the level says, by what Student's t and the
    `freedom` left of the `units` drawn (rows, or events) make a normal interval wider (Hesterberg,
    The American Statistician 69, 2015): the plain ones are too narrow for small samples.
    """
    reach = math.sqrt(units / freedom) * scipy.special.stdtrit(freedom, (1 + level) / 2)
    tail = float(scipy.special.ndtr(-reach))
    return np.quantile(replicates, [tail, 1 - tail], axis=0).T


def percentiles(replicates: Array, reach: Array) -> Array:
    """The percentiles of columns (n, q) between which a normal one is within `reach` (q,) standard
    deviations, (q, 2)."""
    tails = scipy.special.ndtr(-reach)
    return np.array(
        [
            np.quantile(column, [tail, 1 - tail])
            for column, tail in zip(replicates.T, tails, strict=True)
        ]
    )
