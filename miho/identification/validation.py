"""Validation: errors on rows that a fit did not use, and trends in the errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import scipy  # loads its subpackages at first use: importing them takes a second
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.identification.autocorrelation import autoregression, chance_of_trend
from miho.identification.curve_fit import CurveFit
from miho.identification.deadline import Deadline, seconds_of_refit
from miho.identification.dependence import serial_correlation_beside_priors, series_of
from miho.identification.inverse_root import inverse_root
from miho.identification.refit import refit
from miho.identification.uncertainty import Linearised
from miho.parallel.blocks import in_blocks
from miho.parallel.pool import Pool
from miho.parallel.process_executor import WorkerLostError
from miho.quantities import Array

MOST_LEVELS = 12
"""A condition with more levels than this is split into BINS groups of equal size."""
BINS = 5
FINE = 15
"""Number of groups of the first input, larger because errors may oscillate along it."""
ROWS = 10
"""Smallest number of rows of a group, if there is a choice."""
UNMODELLED, CHANCE = 0.1, 1e-3
"""A column is mentioned if it explains more than this fraction of the error variance, and if chance
alone would do so with a smaller probability than this."""
OR_DRIFT = (
    "or the measurement drifts in addition to its noise; repeat the measurement with {name} in "
    "another order to decide"
)

Groups = NDArray[np.intp]
"""The group of each row (N,)."""
_Grouping = tuple[str, Groups, Groups]
"""A column, its groups of rows, and coarser groups to compare with."""


def root_mean_square(values: Array) -> float:
    """Square root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def error_on(problem: CurveFit, theta: Array, dataset: Dataset) -> float:
    """Root-mean-square error of the model on other data of the same columns."""
    return root_mean_square(replace(problem, dataset=dataset).errors(theta))


def conditions(problem: CurveFit) -> list[str]:
    """The columns that describe the conditions of a measurement.

    These are all columns except the output, its sigma, and the first input of the model.
    """
    others = next(iter(problem.model.inputs)), problem.dataset.output, problem.sigma
    return [name for name in problem.dataset.columns if name not in others]


def levels(values: Array) -> list[Array]:
    """The levels of a condition: groups (n,) of close values, in ascending order.

    Measured levels scatter, so values belong to one level if they are much closer to each other
    than to the next level. The list is empty for a condition that varies continuously.
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
    """The group of each row (N,): its level, or one of `bins` groups of equal size."""
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
    fixed: Sequence[int] = (),
    deadline: Deadline | None = None,
    pool: Pool | None = None,
) -> pd.DataFrame:
    """Errors on each group of a condition, from a fit without the group.

    All fits start at the optimum `theta` (d,), and parameters at the positions `fixed` do not
    change. `pool` shares expensive fits. Raises OutOfTimeError after the deadline, and
    WorkerLostError if a worker is lost.

    Returns
    -------
    DataFrame
        A row per group: condition, range and unit of the group, number of rows, error on the group
        at the optimum, and error of the fit without the group, both in the unit of the output.
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
    without = partial(_without, problem, theta, fixed, deadline)
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


def _without(
    problem: CurveFit,
    theta: Array,
    fixed: Sequence[int],
    deadline: Deadline,
    left_out: NDArray[np.bool_],
) -> Array:
    """The optimum (d,) without some of the rows (N,)."""
    weights = (~left_out).astype(float)
    return refit(problem, theta, weights, fixed, deadline=deadline).theta


def residual_trends(problem: CurveFit, theta: Array, at: Linearised | None = None) -> pd.DataFrame:
    """The share of the error variance that each column explains, by means of groups of rows.

    The first input forms groups alone. Other columns form groups together with it, because the
    effect of a load, for example, has the sign of the slip. No fit of this model can remove errors
    that a column explains which is not an input. `at` is the uncertainty of the optimum `theta`
    (d,), with the dependence of neighbouring rows.

    Returns
    -------
    DataFrame
        A row per column: whether it is an input, the explained share (0 to 1, epsilon squared), and
        p values for independent errors (F test of the groups) and for errors that depend on
        neighbouring rows. The second test is made if the first one is significant.
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
    """Whether the share that a column explains is large and significant enough to mention."""
    return explained > UNMODELLED and p < CHANCE


def in_a_sweep(problem: CurveFit, name: str) -> bool:
    """Whether drift would follow a column too, because rows are ordered along it."""
    column, series = problem.dataset[name], series_of(problem)
    shares = [_share_of_drift(column[own]) for own in series]
    weights = [column[own].size for own in series]
    return bool(np.average(shares, weights=weights) > UNMODELLED)


def _share_of_drift(values: Array) -> float:
    """The share of the variance of a random walk over rows (n,) that groups of `values` explain.

    It is 0.93 for a sweep of many rows, 0.23 for one sweep up and down, 0.1 for three, and about 0
    for random order. Sums of squares are expected values for steps of variance 1.
    """
    n = values.size
    index = groups(values, min(FINE, n // ROWS))
    members = [index == group for group in np.unique(index)]
    if len(members) < 2:
        return 0.0
    # The sum of a walk over some rows weighs each step by the number of these rows that follow it.
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
    """P value of a grouping for errors that depend on neighbouring rows; 0 if they do not."""
    dependence, series = at.dependence, series_of(problem)
    if dependence is None and not serial_correlation_beside_priors(problem, at.theta):
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
    """Membership of rows in groups, as columns (N, k) of 0 and 1."""
    return np.asarray(index[:, None] == np.unique(index), dtype=float)


def _explained(errors: Array, index: Groups, coarse: Groups) -> tuple[float, float]:
    """Epsilon squared (Kelley 1935) of a grouping relative to a coarser one, and its p value."""
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
