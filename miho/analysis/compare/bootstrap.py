"""Percentile bootstrap over repetitions, of final errors and of mean curves.

A repetition is a seed: data split and initial configurations are shared by all methods, so
comparisons resample seeds jointly (paired). Few repetitions give intervals that are too short:
with five, a nominal 95 % holds the truth in roughly 83 % of cases if errors are normal, and in
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

Array = NDArray[np.float64]
Picks = NDArray[np.intp]

ENDED_BY_ITSELF = ("converged", "brackets", "failed")


@dataclass(frozen=True, eq=False)
class MeanCurve:
    """The n runs of one method as step functions on their common breakpoints.

    `at` (t,) are all positions where any run improves, rising. `errors` (n, t) never rise along
    a row and are inf where a run has no value yet, so that the mean is inf there as well. `ends`
    (n,) is where each run stopped. `cut` (n,) marks runs that the budget or the user stopped and
    that could have gone on; the others keep their last value for good.
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
        """The runs of `optimizer` with these seeds, in their order; frames as `one_problem`."""
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

        `picks` (m, n) are row numbers, one resample per row. The second bound is where the mean
        of the runs as they are gets there, inf if it does not. The first is the same, or the
        earliest end of a run that was cut if that is before: had the run gone on, the mean might
        have been there from then on.
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

    def still_falling(self, tolerance: float = 0.01) -> bool:
        """Whether a larger budget would matter: the mean fell in the second half of the runs.

        True if a run was cut and the mean fell by more than `tolerance` (relative) between half
        of each run's length and its end.
        """
        half = np.searchsorted(self.at, self.ends / 2, side="right") - 1
        early = self.errors[np.arange(half.size), np.maximum(half, 0)]
        early = np.where(half < 0, np.inf, early).mean()
        return bool(self.cut.any() and self.errors[:, -1].mean() < (1 - tolerance) * early)

    def idle(self) -> Array:
        """The share of each run (n,) that brought no improvement, on the axis.

        Only waits count that are longer than PATIENCE of what was spent before: stored curves leave
        out improvements that are closer together.
        """
        shares = np.zeros(len(self.errors))
        for row, (errors, end) in enumerate(zip(self.errors, self.ends, strict=True)):
            at = np.append(self.at[errors < np.append(np.inf, errors[:-1])], end)
            waits = np.diff(at)
            shares[row] = waits[waits > PATIENCE * at[:-1]].sum() / end
        return shares


PATIENCE = 0.02
LEVEL = 0.95
RESAMPLES = 2000


@dataclass(frozen=True)
class Interval:
    """An estimate and its bootstrap interval.

    What was cut by the budget is known within bounds only: then `estimate` is the lower bound,
    `at_most` the upper one, and `low` and `high` hold the intervals of both. `censored` is the
    share of resamples with different bounds; 0 means that all is known exactly.
    """

    estimate: float
    low: float
    high: float
    at_most: float
    censored: float = 0.0

    def scaled(self, factor: float) -> Interval:
        """The interval in another unit."""
        return Interval(
            self.estimate * factor,
            self.low * factor,
            self.high * factor,
            self.at_most * factor,
            self.censored,
        )


def mean_error(errors: Array, rng: np.random.Generator, resamples: int = RESAMPLES) -> Interval:
    """The mean of final errors (n,); inf counts as inf."""
    means = errors[resample(len(errors), rng, resamples)].mean(axis=1)
    return interval(means, means)


def improvement(
    method: Array, rival: Array, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Interval:
    """1 - mean(method) / mean(rival), of final errors (n,), (n,) paired by repetition.

    The paper's "24 % better". 1 if only the rival has no finite error, 0 if neither has.
    """
    ratio = ratio_of_means(method, rival, rng, resamples)
    best, worst = 1 - ratio.low, 1 - ratio.high
    return Interval(1 - ratio.estimate, worst, best, 1 - ratio.estimate)


def ratio_of_means(
    method: Array, rival: Array, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Interval:
    """mean(method) / mean(rival) of final errors (n,), (n,), paired by repetition.

    Two means without a finite value count as equal.
    """
    picks = resample(_common_length([method, rival]), rng, resamples)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = method[picks].mean(axis=1) / rival[picks].mean(axis=1)
    ratios[np.isnan(ratios)] = 1.0
    return interval(ratios, ratios)


def time_to_target(
    curve: MeanCurve, target: float, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Interval:
    """Where the mean curve is first at most `target`, in the unit of its axis.

    Never reaching it gives [earliest end of a cut run, inf], or inf if all runs had finished.
    """
    return interval(*curve.reaches(target, resample(len(curve.errors), rng, resamples)))


def speed_up(
    method: MeanCurve,
    rivals: Sequence[MeanCurve],
    target: float,
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
) -> Interval:
    """Time to target of the fastest rival's mean curve, divided by that of `method`.

    Runs are paired by repetition: row i of every curve is the same seed. Times that the budget
    cut off enter as bounds, on either side alike. If no rival arrives the ratio lies between
    (earliest end of a cut rival) / (the method's time) and inf. If some arrive and others were cut
    before, the fastest of those that arrived gives the upper bound and the earliest cut the lower
    one. If the method does not arrive the lower bound is 0; it is exactly 0 if its runs had
    finished.
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
    """Row numbers (1 + resamples, n): the repetitions as they are, then draws with replacement."""
    if repetitions < 1:
        raise ValueError("there is no repetition to resample")
    draws = rng.integers(repetitions, size=(resamples, repetitions))
    return np.vstack([np.arange(repetitions), draws])


def interval(lows: Array, highs: Array, level: float = LEVEL) -> Interval:
    """The percentile interval of values known within [lows, highs]; row 0 is the estimate.

    Percentiles are observed values, rounded outwards: interpolation cannot handle inf.
    """
    below, above = np.sort(lows[1:]), np.sort(highs[1:])
    tail = (1 - level) / 2 * (below.size - 1)
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
