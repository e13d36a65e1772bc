"""The mean curve of a method, and of any resample of its repetitions."""

from __future__ import annotations

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
        mine = runs[runs["optimizer"] == optimizer].set_index("seed").loc[list(seeds)]
        rows = curves[curves["id"].isin(mine["id"])]
        at = np.unique(positions(rows, axis))
        errors = np.empty((len(mine), at.size))
        for error, run in zip(errors, mine["id"], strict=True):
            one = rows[rows["id"] == run]
            error[:] = step(positions(one, axis), one["error"].to_numpy(dtype=float), at)
        errors[np.isnan(errors)] = np.inf
        cut = ~mine["outcome"].isin(ENDED_BY_ITSELF).to_numpy(dtype=bool)
        return cls(at, errors, mine[axis].to_numpy(dtype=float), cut)

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
