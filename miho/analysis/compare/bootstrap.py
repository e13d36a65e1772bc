"""Percentile bootstrap over repetitions, of final errors and of mean curves.

A repetition is a seed: all methods share the data split and the initial configurations, so
comparisons resample seeds jointly (paired). With few repetitions the intervals are too short: with
five, a nominal 95 % interval covers the truth in roughly 83 % of cases if errors are normal, and in
70 % if they are lognormal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.analysis.curves import Axis, positions, step
from miho.quantities import Array

Picks = NDArray[np.intp]

ENDED_BY_ITSELF = ("converged", "brackets", "failed")


@dataclass(frozen=True, eq=False)
class MeanCurve:
    """The n runs of one method as step functions on their common breakpoints.

    Attributes
    ----------
    at : ndarray of shape (t,)
        All positions where any run improves, increasing.
    errors : ndarray of shape (n, t)
        Best errors so far; inf before the first value, so that the mean is inf as well.
    ends : ndarray of shape (n,)
        The end of each run.
    cut : bool ndarray of shape (n,)
        Runs that the budget or the user stopped and that could have continued. The others keep
        their last value.
    """

    at: Array
    errors: Array
    ends: Array
    cut: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        runs: pd.DataFrame,
        curves: pd.DataFrame,
        optimizer: str,
        axis: Axis,
        seeds: Sequence[int],
    ) -> MeanCurve:
        """The runs of `optimizer` with these seeds, in order; frames from `one_problem`."""
        of_method = runs[runs["optimizer"] == optimizer].set_index("seed").loc[list(seeds)]
        rows = curves[curves["id"].isin(of_method["id"])]
        at = np.unique(positions(rows, axis))
        errors = np.empty((len(of_method), at.size))
        for error, run in zip(errors, of_method["id"], strict=True):
            run_rows = rows[rows["id"] == run]
            error[:] = step(positions(run_rows, axis), run_rows["error"].to_numpy(dtype=float), at)
        errors[np.isnan(errors)] = np.inf
        cut = ~of_method["outcome"].isin(ENDED_BY_ITSELF).to_numpy(dtype=bool)
        return cls(at, errors, of_method[axis].to_numpy(dtype=float), cut)

    def reaches(self, target: float, picks: Picks) -> tuple[Array, Array]:
        """Bounds (m,), (m,) on where the mean of each resample is first at most `target`.

        `picks` (m, n) are row numbers, one resample per row. The second bound is the position for
        the runs as they are, inf if they never reach the target. The first bound is the same or, if
        earlier, the first end of a run that was cut: if that run had continued, the mean might have
        reached the target from then on.
        """
        low, high = np.zeros(len(picks), dtype=int), np.full(len(picks), self.at.size)
        while (open_ := low < high).any():
            middle = np.minimum((low + high) // 2, self.at.size - 1)
            below = self.errors[picks, middle[:, None]].mean(axis=1) <= target
            high = np.where(open_ & below, middle, high)
            low = np.where(open_ & ~below, middle + 1, low)
        reached = np.append(self.at, np.inf)[low]
        earliest_cut = np.where(self.cut, self.ends, np.inf)[picks].min(axis=1)
        return np.minimum(reached, earliest_cut), reached

    def still_falling(self) -> bool:
        """Return whether the mean fell in the second half, so that more budget matters.

        True if a run was cut and the mean fell by more than FALLING between half of each run's
        length and its end.
        """
        half = np.searchsorted(self.at, self.ends / 2, side="right") - 1
        early = self.errors[np.arange(half.size), np.maximum(half, 0)]
        early = np.where(half < 0, np.inf, early).mean()
        return bool(self.cut.any() and self.errors[:, -1].mean() < (1 - FALLING) * early)

    def idle(self) -> Array:
        """The share of each run (n,) without improvement, on the axis.

        Only waits longer than PATIENCE times the position count, because stored curves omit
        improvements that are closer together.
        """
        shares = np.zeros(len(self.errors))
        for row, (errors, end) in enumerate(zip(self.errors, self.ends, strict=True)):
            at = np.append(self.at[errors < np.append(np.inf, errors[:-1])], end)
            waits = np.diff(at)
            shares[row] = waits[waits > PATIENCE * at[:-1]].sum() / end
        return shares


PATIENCE = 0.02
FALLING = 0.01
"""Smallest relative fall of a mean that counts."""
LEVEL = 0.95
RESAMPLES = 2000


@dataclass(frozen=True)
class Interval:
    """An estimate and its bootstrap interval.

    A value that the budget cut off is only known within bounds: `estimate` is then the lower bound,
    `at_most` the upper bound, and `low` and `high` enclose the intervals of both. `censored` is the
    share of resamples with different bounds; 0 means that all values are exact.
    """

    estimate: float
    low: float
    high: float
    at_most: float
    censored: float = 0.0

    def scaled(self, factor: float) -> Interval:
        """The interval in another unit."""
        low, high = self.low * factor, self.high * factor
        return Interval(self.estimate * factor, low, high, self.at_most * factor, self.censored)


def mean_error(errors: Array, rng: np.random.Generator, resamples: int = RESAMPLES) -> Interval:
    """The mean of final errors (n,) with its bootstrap interval; inf counts as inf."""
    means = errors[resample(len(errors), rng, resamples)].mean(axis=1)
    return interval(means, means)


def improvement(
    method: Array, rival: Array, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Interval:
    """1 - mean(method) / mean(rival) of final errors (n,), paired: the paper's "24 % better".

    It is 1 if only the rival has no finite error, and 0 if neither has.
    """
    ratio = ratio_of_means(method, rival, rng, resamples)
    best, worst = 1 - ratio.low, 1 - ratio.high
    return Interval(1 - ratio.estimate, worst, best, 1 - ratio.estimate)


def ratio_of_means(
    method: Array, rival: Array, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Interval:
    """mean(method) / mean(rival) of final errors (n,), paired by repetition.

    Two means without a finite value count as equal.
    """
    picks = resample(_common_length([method, rival]), rng, resamples)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = method[picks].mean(axis=1) / rival[picks].mean(axis=1)
    ratios[np.isnan(ratios)] = 1.0
    return interval(ratios, ratios)


def speed_up(
    method: MeanCurve,
    rivals: Sequence[MeanCurve],
    target: float,
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
) -> Interval:
    """Time to target of the fastest rival's mean curve, divided by the time of `method`.

    Times that the budget cut off enter as bounds, for the method and the rivals alike. If no rival
    reaches the target, the ratio is between (earliest end of a cut rival) / (the method's time) and
    inf. If some do and others were cut before, the fastest of the former gives the upper bound and
    the earliest cut the lower bound. If the method does not reach the target, the lower bound is 0;
    the ratio is exactly 0 if its runs had finished.

    Curves are paired by repetition: row i of every curve has the same seed. Raises ValueError if
    there are no rivals or the numbers of repetitions differ.
    """
    if not rivals:
        raise ValueError("speed_up needs at least one rival")
    picks = resample(_common_length([c.errors for c in [method, *rivals]]), rng, resamples)
    method_low, method_high = method.reaches(target, picks)
    rival_bounds = [rival.reaches(target, picks) for rival in rivals]
    rival_low = np.min([low for low, _ in rival_bounds], axis=0)
    rival_high = np.min([high for _, high in rival_bounds], axis=0)
    with np.errstate(invalid="ignore"):
        low, high = rival_low / method_high, rival_high / method_low
    low[np.isinf(method_high)] = 0.0
    high[np.isinf(method_low)] = 0.0
    return interval(low, high)


def resample(repetitions: int, rng: np.random.Generator, resamples: int = RESAMPLES) -> Picks:
    """Row numbers (1 + resamples, n): the actual repetitions, then draws with replacement."""
    if repetitions < 1:
        raise ValueError("there is no repetition to resample")
    draws = rng.integers(repetitions, size=(resamples, repetitions))
    return np.vstack([np.arange(repetitions), draws])


def interval(lows: Array, highs: Array) -> Interval:
    """The percentile interval of values known within [lows, highs]; row 0 is the estimate.

    Percentiles are observed values, rounded outwards, because interpolation cannot handle inf.
    """
    below, above = np.sort(lows[1:]), np.sort(highs[1:])
    tail = (1 - LEVEL) / 2 * (below.size - 1)
    return Interval(
        estimate=float(lows[0]),
        low=float(below[math.floor(tail)]),
        high=float(above[math.ceil(below.size - 1 - tail)]),
        at_most=float(highs[0]),
        censored=float(np.mean(lows[1:] < highs[1:])),
    )


def _common_length(arrays: Sequence[Array]) -> int:
    lengths = {len(array) for array in arrays}
    if len(lengths) != 1:
        raise ValueError(
            f"methods have {sorted(lengths)} repetitions; pass the same seeds of each, in order"
        )
    return lengths.pop()
