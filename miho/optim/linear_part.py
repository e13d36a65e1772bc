"""The parameters in which residuals are linear, solved for while the others are held."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from miho.optim.space import Space

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearPart:
    """The best configuration (d,) with the other parameters held, and what it was found from.

    `basis` (m, p) holds the derivatives of the residuals with respect to those linear parameters
    that are not at a bound, each divided by its norm: the directions in which nothing can be
    gained.
    """

    theta: Array
    basis: Array

    def outside(self, columns: Array) -> Array:
        """The part of columns (m, k) that is orthogonal to the basis, (m, k)."""
        if not self.basis.shape[1]:
            return columns
        return np.asarray(columns - self.basis @ np.linalg.lstsq(self.basis, columns)[0])


def solve_linear_part(
    residuals: Callable[[Array], Array], theta: Array, linear: Sequence[int], space: Space
) -> LinearPart | None:
    """Minimise the sum of squared residuals over the parameters at the positions `linear`.

    `theta` (d,) is in the space, and so is every configuration asked for: it, and one more for
    each linear parameter, which is as far away as the box allows, because differences of a linear
    function are the more exact the wider they are. The solution is that of ordinary least squares
    if the box holds it, else of bounded-variable least squares (SciPy, bvls). None if a residual
    is not finite.
    """
    theta = theta.copy()
    offset = residuals(theta)
    basis = np.empty((offset.size, len(linear)))
    for column, k in enumerate(linear):
        moved = theta.copy()
        above, below = space.high[k] - theta[k], theta[k] - space.low[k]
        moved[k] = space.high[k] if above >= below else space.low[k]
        basis[:, column] = (residuals(moved) - offset) / (moved[k] - theta[k])
    offset = offset - basis @ theta[linear]
    if not (np.isfinite(offset).all() and np.isfinite(basis).all()):
        return None
    norm = np.linalg.norm(basis, axis=0)
    norm[norm == 0] = 1.0
    low, high = space.low[linear], space.high[linear]
    basis = basis / norm
    found = lsq_linear(basis, -offset, (low * norm, high * norm), method="bvls")
    theta[linear] = np.clip(found.x / norm, low, high)
    return LinearPart(theta, basis[:, found.active_mask == 0])
