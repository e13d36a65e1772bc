"""Accuracy of an identified curve on a drive with other data (Sec. V-A.1, Fig. 4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

NEAR = 0.8
"""Smallest share of the peak that counts as near the peak."""
RESAMPLES = 2000


class Generalisation(NamedTuple):
    """Root mean square errors of a curve on a drive, all forces in one unit.

    Attributes
    ----------
    error : float
        Error over all rows.
    largest : float
        Largest magnitude of the measured force.
    near, below : float
        Error over the rows near the peaks, and over the other rows.
    ratio : float
        `near` divided by `below`.
    low, high : float
        95 % interval of the ratio.
    """

    error: float
    largest: float
    near: float
    below: float
    ratio: float
    low: float
    high: float

    @property
    def share(self) -> float:
        """The error divided by the largest force."""
        return self.error / self.largest

    @property
    def less_near_the_peaks(self) -> bool:
        """Whether the error near the peaks is significantly larger than below them."""
        return self.low > 1

    def text(self) -> str:
        """The figures as text, with forces in N."""
        return (
            f"error {self.error:.0f} N, {100 * self.share:.1f} % of the largest force "
            f"({self.largest:.0f} N); near the peaks {self.near:.0f} N, {self.ratio:.2f} "
            f"[{self.low:.2f}, {self.high:.2f}] times the {self.below:.0f} N below"
        )


def near_peaks(force: Array, peaks: tuple[float, float]) -> NDArray[np.bool_]:
    """Mask (n,) of forces that reach `NEAR` of the lowest or the highest force in `peaks`."""
    low, high = peaks
    return (force <= NEAR * low) | (force >= NEAR * high)


def generalisation(
    measured: Array, predicted: Array, near: NDArray[np.bool_], rng: np.random.Generator
) -> Generalisation:
    """Judge a curve's forces on a drive.

    Errors of neighbouring rows are correlated, so the interval resamples whole swings: from one
    change of the curve's sign to the next.

    Parameters
    ----------
    measured, predicted : ndarray of shape (n,)
        Lateral forces in the order of the drive, and the curve's forces at the same slip angles.
    near : bool ndarray of shape (n,)
        The rows near the peaks, see `near_peaks`.
    rng : numpy.random.Generator
        Draws the swings of each of `RESAMPLES` resamples.

    Returns
    -------
    Generalisation
        The errors and the interval of their ratio.

    Raises
    ------
    ValueError
        If no row, or every row, is near the peaks.
    """
    if near.all() or not near.any():
        raise ValueError(
            f"{near.sum()} of {near.size} rows are near the peaks; expected a drive with some rows "
            "near the peaks and some below"
        )
    square = (predicted - measured) ** 2
    swing = np.concatenate([[0], np.cumsum(np.diff(np.sign(predicted)) != 0)])
    sums = np.array(
        [
            np.bincount(swing, weights=column, minlength=swing[-1] + 1)
            for column in (square * near, near, square * ~near, ~near)
        ]
    )
    picks = rng.integers(sums.shape[1], size=(RESAMPLES, sums.shape[1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = _ratio(sums[:, picks].sum(axis=2))
    low, high = np.nanquantile(ratios, [0.025, 0.975])
    total = sums.sum(axis=1)
    return Generalisation(
        error=float(np.sqrt(square.mean())),
        largest=float(np.abs(measured).max()),
        near=float(np.sqrt(total[0] / total[1])),
        below=float(np.sqrt(total[2] / total[3])),
        ratio=float(_ratio(total)),
        low=float(low),
        high=float(high),
    )


def _ratio(sums: Array) -> Array:
    """Error near the peaks divided by the error below, from sums of squares and numbers of rows."""
    return np.asarray(np.sqrt((sums[0] / sums[1]) / (sums[2] / sums[3])))
