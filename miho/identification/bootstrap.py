"""Intervals by the bootstrap: the scatter of estimates from resampled rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.identification.dependence import events_of
from miho.identification.refit import refit
from miho.identification.uncertainty import Linearised
from miho.optim.seeds import stream
from miho.optim.space import Space
from miho.parallel.blocks import in_blocks
from miho.parallel.pool import Pool
from miho.parallel.process_executor import WorkerLostError
from miho.quantities import Array

TINY = 1e-12
"""A variance counts as 0 if it is this fraction of another one."""


def bootstrap(
    problem: CurveFit,
    theta: Array,
    replicates: int,
    rng: np.random.Generator,
    progress: Callable[[], object] = lambda: None,
    fixed: Sequence[int] = (),
    block: int = 1,
    pool: Pool | None = None,
    others: Sequence[Array] = (),
) -> Array:
    """Estimate the parameters from rows drawn with replacement.

    Whole rows are drawn [1]_, which assumes only that rows are independent. If the data number
    events, whole events are drawn. Dependent rows get exponential weights in blocks [2]_. No weight
    is 0, so parameters that only a few rows determine stay determined. Raises ValueError if a
    worker is lost.

    Parameters
    ----------
    problem : CurveFit
        The problem.
    theta : ndarray of shape (d,)
        Its optimum, the start of each refit.
    replicates : int
        Number of estimates.
    rng : numpy.random.Generator
        Source of randomness.
    progress : callable
        Called after every replicate.
    fixed : sequence of int
        Positions of parameters that do not change.
    block : int
        Number of rows with a common weight; 1 for independent rows.
    pool : Pool, optional
        Workers for expensive refits. The estimates are the same, to the last bit.
    others : sequence of ndarray of shape (d,)
        Further optima within the noise. Each replicate is refitted from all optima, and the best
        refit counts.

    Returns
    -------
    ndarray of shape (replicates, d)
        The estimates.

    References
    ----------
    .. [1] Efron and Tibshirani, An Introduction to the Bootstrap, 1993, Ch. 9.5.
    .. [2] Rubin, Annals of Statistics 9, 1981.
    """
    event = events_of(problem.dataset)
    index = np.arange(len(problem.dataset)) if event is None else event
    units = int(index.max()) + 1

    def weights() -> Array:
        if block > 1:
            return _block_weights(units, block, rng)
        counts = rng.multinomial(units, np.full(units, 1 / units))
        return np.asarray(counts[index].astype(float))

    drawn = (weights() for _ in range(replicates))  # the order does not depend on workers
    estimates = np.empty((replicates, theta.size))
    refitted = partial(_refitted, problem, (theta, *others), fixed)
    for k, estimate in enumerate(in_blocks(pool, refitted, drawn)):
        if isinstance(estimate, WorkerLostError):
            raise ValueError(f"a bootstrap replicate was lost with its worker: {estimate}")
        estimates[k] = estimate
        progress()
    return estimates


def replicated(
    problem: CurveFit,
    optima: Sequence[Linearised],
    replicates: int,
    seed: int,
    progress: Callable[[str], object],
    pool: Pool | None,
) -> Array:
    """Estimates (replicates, d) from resampled rows; dependent rows are resampled in blocks.

    Unidentifiable parameters do not change. Estimates of dependent rows are stretched if there is a
    single optimum.
    """
    at = optima[0]
    rng = stream("bootstrap", problem.dataset.digest, seed)
    block = 1 if at.dependence is None else block_length(at.dependence.errors)
    fixed = np.flatnonzero(at.unidentifiable).tolist()
    estimates = bootstrap(
        problem, at.theta, replicates, rng, lambda: progress("bootstrap"), fixed, block, pool,
        [other.theta for other in optima[1:]],
    )  # fmt: skip
    if at.dependence is None or len(optima) > 1:
        return estimates
    return stretched(estimates, at, problem.space)


def _refitted(
    problem: CurveFit, starts: Sequence[Array], fixed: Sequence[int], weights: Array
) -> Array:
    """The best optimum (d,) of weighted rows, by descents from the optima for equal weights."""
    ends = [refit(problem, start, weights, fixed, tolerance=1e-6) for start in starts]
    return min(ends, key=lambda end: end.cost).theta


def block_length(errors: Array) -> int:
    """Number of rows in a block, for errors (N,) that depend on their neighbours.

    The length of circular blocks by Politis and White (Econometric Reviews 23, 2004), corrected by
    Patton, Politis and White (Econometric Reviews 28, 2009). It follows from the significant
    autocovariances, weighted by a flat-top window, and is 1 if there are none.
    """
    rows = errors.size
    run, farthest = max(5, int(np.sqrt(np.log10(rows)))), math.ceil(math.sqrt(rows))
    centred = errors - errors.mean()
    lags = min(farthest + run, rows - 1)
    products = np.array([centred[k:] @ centred[: rows - k] for k in range(lags + 1)]) / rows
    large = np.abs(products[1:]) > 2 * np.sqrt(np.log10(rows) / rows) * products[0]
    # The last lag before a run of small autocovariances, or the last large one.
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
    """Stretch replicates (n, d) from blocks about the optimum to the covariance `at.sandwich`.

    Blocks cut the dependence between rows, and errors of a fit vary less than errors of the data.
    Replicates therefore scatter too little, the more so the stronger the dependence. The linear map
    closest to the identity takes their covariance to the sandwich. Standard deviations of the
    replicates are half the width of the middle 68 %, because a block may contain all rows that
    determine a parameter. Parameters without a standard error do not change, and all replicates
    stay within the box. Too few replicates for a covariance are returned unchanged.
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
    """Weights (N,) of rows, equal within blocks, which begin at a random row."""
    place = (np.arange(rows) + rng.integers(rows)) % rows // block
    return np.asarray(rng.exponential(size=-(-rows // block))[place])


def percentile_intervals(replicates: Array, units: int, freedom: int, level: float = 0.95) -> Array:
    """Lower and upper percentiles (q, 2) of the columns of replicates (n, q).

    Plain percentiles are too narrow for small samples. Student's t, and the `freedom` of the
    `units` drawn (rows or events), widen a normal interval by a factor, and these percentiles are
    further out by the same factor (Hesterberg, The American Statistician 69, 2015). Without freedom
    they are NaN.
    """
    if not freedom:
        return np.full((replicates.shape[1], 2), np.nan)
    reach = math.sqrt(units / freedom) * scipy.special.stdtrit(freedom, (1 + level) / 2)
    tail = float(scipy.special.ndtr(-reach))
    return np.quantile(replicates, [tail, 1 - tail], axis=0).T


def percentiles(replicates: Array, reach: Array) -> Array:
    """Percentiles (q, 2) of columns (n, q).

    Between them a normal variable is within `reach` (q,) standard deviations of its mean.
    """
    tails = scipy.special.ndtr(-reach)
    return np.array(
        [
            np.quantile(column, [tail, 1 - tail])
            for column, tail in zip(replicates.T, tails, strict=True)
        ]
    )
