"""Validation: errors on rows that a fit has not seen, and trends that are left in the errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import scipy  # which loads its packages where they are used: importing them takes a second
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.identification.autocorrelation import autoregression, chance_of_trend
from miho.identification.curve_fit import CurveFit
from miho.identification.inverse_root import inverse_root
from miho.identification.refit import Deadline, refit, seconds_of_refit
from miho.identification.uncertainty import Linearised, alike_beside_priors, series_of
from miho.parallel.blocks import in_blocks
from miho.parallel.pool import Pool
from miho.parallel.process_executor import WorkerLostError
from miho.quantities import Array

MOST_LEVELS = 12
"""A condition with more levels than this is split into BINS groups of equal size."""
BINS = 5
FINE = 15
"""Groups of the first input, finer because the errors may wave along it."""
ROWS = 10
"""A group has this many rows at least, where there is a choice."""
UNMODELLED, CHANCE = 0.1, 1e-3
"""A column that explains this fraction of the errors' variance is mentioned, if chance alone would
explain as much with a smaller probability than this."""
OR_DRIFT = (
    "or the measurement drifts in addition to its noise; take {name} in another order to tell"
)

Groups = NDArray[np.intp]
"""The group of each row (N,)."""
_Grouping = tuple[str, Groups, Groups]
"""A column, its groups of rows, and the coarser ones beyond which they explain errors."""


def root_mean_square(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def error_on(problem: CurveFit, theta: Array, dataset: Dataset) -> float:
    """Root-mean-square error of the model on other data of the same columns."""
    return root_mean_square(replace(problem, dataset=dataset).errors(theta))


def conditions(problem: CurveFit) -> list[str]:
    """The columns that say under which conditions a row was measured.

    They are all but the output, its sigma, and the model's first input, whether or not they are
    inputs too.
    """
    others = next(iter(problem.model.inputs)), problem.dataset.output, problem.sigma
    return [name for name in problem.dataset.columns if name not in others]


def levels(values: Array) -> list[Array]:
    """The levels at which a condition was set: groups (n,) of close values, in rising order.

    Measured levels scatter, so values belong to one level if they are much closer to each other
    than to the next level. Empty for a condition that varies continuously.
    """
    ordered = np.unique(values)
    gaps = np.diff(ordered)
    if not gaps.size:
        return [ordered]
    cut = np.flatnonzero(gaps > np.ptp(values) / (2 * MOST_LEVELS))
    parts = np.split(ordered, cut + 1)
    widest = max(np.ptp(part) for part in parts)
    clear = cut.size > 0 and widest < gaps[cut].min() / 2
    return parts if clear and len(parts) <= MOST_LEVELS else []


def groups(values: Array, bins: int = BINS) -> NDArray[np.intp]:
    """The group of each row (N,): its level, or one of `bins` with equal numbers of rows."""
    if bins < 2:
        return np.zeros(values.size, dtype=np.intp)
    separate_levels = levels(values)
    if separate_levels:
        starts = np.array([level[0] for level in separate_levels])
        return np.asarray(np.searchsorted(starts, values, side="right") - 1)
    edges = np.quantile(values, np.linspace(0, 1, bins + 1)[1:-1])
    return np.searchsorted(edges, values, side="right")


def leave_one_out(
    problem: CurveFit,
    theta: Array,
    condition: str,
    held: Sequence[int] = (),
    deadline: Deadline | None = None,
    pool: Pool | None = None,
) -> pd.DataFrame:
    """Fit without one group of a condition, and the error on that group; a row per group.

    Columns: condition, from, to and unit (of the group), rows, error of all rows
    on the group, error of the fit that has not seen it (both in the output's unit). The workers of
    a `pool` make the fits where they take long. Raises OutOfTimeError after the deadline, and
    WorkerLostError where a worker ended.
    """
    dataset = problem.dataset
    values = dataset[condition]
    index = groups(values)
    parts = [index == group for group in np.unique(index)]
    parts = [
        left_out
        for left_out in parts
        if not left_out.all() and len(dataset) - left_out.sum() > len(problem.space)
    ]
    deadline = deadline or Deadline()
    seconds = None if pool is None else seconds_of_refit(problem, theta)
    without = _Without(problem, theta, held, deadline)
    rows = []
    for left_out, estimate in zip(
        parts, in_blocks(pool, without, parts, seconds, deadline.check), strict=True
    ):
        if isinstance(estimate, WorkerLostError):
            raise estimate
        deadline.check()
        rows.append(
            {
                "condition": condition,
                "from": values[left_out].min() + 0.0,
                "to": values[left_out].max() + 0.0,
                "unit": dataset.units[condition],
                "rows": int(left_out.sum()),
                "error when seen": root_mean_square(problem.errors(theta)[left_out]),
                "error when left out": root_mean_square(problem.errors(estimate)[left_out]),
            }
        )
    return pd.DataFrame(rows)


@dataclass(frozen=True)
class _Without:
    """The optimum (d,) without some of the rows (N,)."""

    problem: CurveFit
    theta: Array
    held: Sequence[int]
    deadline: Deadline

    def __call__(self, left_out: NDArray[np.bool_]) -> Array:
        weights = (~left_out).astype(float)
        return refit(self.problem, self.theta, weights, self.held, deadline=self.deadline).theta


def residual_trends(problem: CurveFit, theta: Array, at: Linearised | None = None) -> pd.DataFrame:
    """How much of the errors' variance each column explains, by the means of groups of rows.

    The first input stands alone; another column together with it, because what a load does to
    the force has the sign of the slip. Columns: column, whether it is an input, explained (0 to
    1, epsilon squared), and p, how often chance alone explains as much: of errors that are
    independent (F test of the groups), and of errors that depend on those of neighbouring rows as
    much as the uncertainty `at` the optimum says, which is tested where the first is a finding.
    What a column that is not an input explains is error no fit of this model can remove.
    """
    errors, dataset = problem.errors(theta), problem.dataset
    first = next(iter(problem.model.inputs))
    slip = groups(dataset[first], min(FINE, errors.size // ROWS))
    groupings: list[_Grouping] = [(first, slip, np.zeros_like(slip))]
    slip = groups(dataset[first], min(FINE, errors.size // (ROWS * BINS)))
    groupings += [
        (name, slip * (MOST_LEVELS + 1) + groups(dataset[name]), slip)
        for name in conditions(problem)
    ]
    rows = []
    for name, fine, coarse in groupings:
        explained, p = _explained(errors, fine, coarse)
        dependent = p
        if at is not None and is_finding(explained, p):
            dependent = _chance_beside_neighbours(problem, at, fine, coarse)
        is_input = "yes" if name in problem.model.inputs else "no"
        rows.append((name, is_input, explained, p, max(p, dependent)))
    columns = ["column", "an input", "explained", "p of independent rows", "p"]
    return pd.DataFrame(rows, columns=columns)


def is_finding(explained: float, p: float) -> bool:
    """Whether errors follow a column so closely that it is mentioned."""
    return explained > UNMODELLED and p < CHANCE


def in_a_sweep(problem: CurveFit, name: str) -> bool:
    """Whether drift follows a column too, as where rows are ordered along it, once or twice."""
    column, series = problem.dataset[name], series_of(problem)
    shares = [_share_of_drift(column[own]) for own in series]
    weights = [column[own].size for own in series]
    return bool(np.average(shares, weights=weights) > UNMODELLED)


def _share_of_drift(values: Array) -> float:
    """How much of the variance of a random walk over rows (n,) groups of these values explain.

    0.93 for a sweep of many rows, 0.23 for one up and down, 0.1 for three, about 0 at random. Sums
    of squares are those that are expected of a walk of steps of variance 1.
    """
    n = values.size
    index = groups(values, min(FINE, n // ROWS))
    members = [index == group for group in np.unique(index)]
    if len(members) < 2:
        return 0.0
    # The sum of a walk over some rows is that of its steps, times how many of the rows follow each.
    of_mean, *of_groups = (
        np.sum(np.cumsum(rows[::-1], dtype=float) ** 2) / rows.sum()
        for rows in (np.ones(n, dtype=bool), *members)
    )
    total, between = n * (n + 1) / 2 - of_mean, sum(of_groups) - of_mean
    within = (total - between) / (n - len(members))
    return float((between - (len(members) - 1) * within) / total)


def _chance_beside_neighbours(
    problem: CurveFit, at: Linearised, fine: Groups, coarse: Groups
) -> float:
    """How often errors that depend on those of neighbouring rows follow a grouping as closely.

    0 where they do not: chance is then that of independent rows.
    """
    dependence, series = at.dependence, series_of(problem)
    if dependence is None and not alike_beside_priors(problem, at.theta):
        return 0.0
    free = np.flatnonzero(~at.at_bound)
    slopes = inverse_root(problem.error_slopes(at.theta), free).basis
    known = np.hstack([slopes, _members(coarse)])
    basis = inverse_root(known, np.arange(known.shape[1])).basis
    errors = problem.errors(at.theta) if dependence is None else dependence.errors
    errors = errors - basis @ (basis.T @ errors)
    model = autoregression(errors, basis, series)[0] if dependence is None else dependence.model
    return chance_of_trend(errors, basis, _members(fine), model.partial.size, series)


def _members(index: Groups) -> Array:
    """Which rows (N,) are of each group, as columns (N, k) of 0 and 1."""
    return np.asarray(index[:, None] == np.unique(index), dtype=float)


def _explained(errors: Array, index: Groups, coarse: Groups) -> tuple[float, float]:
    """Epsilon squared (Kelley 1935) of a grouping beyond a coarser one, and its p value."""
    n = errors.size
    (fine_sum, k), (coarse_sum, j) = _between_groups(errors, index), _between_groups(errors, coarse)
    total = float(np.sum((errors - errors.mean()) ** 2))
    if k <= j or n <= k or total == 0:
        return 0.0, 1.0
    within = (total - fine_sum) / (n - k)
    if within <= 0:
        return 1.0, 0.0
    F = (fine_sum - coarse_sum) / (k - j) / within
    explained = max(0.0, (fine_sum - coarse_sum - (k - j) * within) / total)
    return explained, float(scipy.special.fdtrc(k - j, n - k, max(F, 0.0)))


def _between_groups(errors: Array, index: Groups) -> tuple[float, int]:
    """Sum of squares between the groups of an index, and their number."""
    count = np.bincount(index)
    sums = np.bincount(index, errors)[count > 0]
    count = count[count > 0]
    return float(np.sum(sums**2 / count)) - errors.size * float(errors.mean()) ** 2, count.size
