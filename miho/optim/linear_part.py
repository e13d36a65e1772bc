"""The parameters in which residuals are linear, solved for while the others are held."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.optim.space import Space
from miho.quantities import Array


@dataclass(frozen=True, eq=False)
class LinearPart:
    """The best configuration (d,) with the other parameters held, and what it was found from.

    `residuals` (m,) are those at `theta`. `basis` (m, p) holds the derivatives of the residuals
    with respect to those linear parameters that are not at a bound, each divided by its norm: the
    directions in which nothing can be gained.
    """

    theta: Array
    residuals: Array
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

    `theta` (d,) is in the space, and so is every configuration asked for. They are, for p linear
    parameters, p + 2: it, one more for each of them, which is as far away as the box allows,
    because differences of a linear function are the more exact the wider they are, and the
    solution. That is of ordinary least squares if the box holds it, else of bounded-variable least
    squares (SciPy, bvls), after one step of iterative refinement (Björck, Numerical Methods for
    Least Squares Problems, 1996, section 2.9): what the differences have lost to rounding comes
    back from the residuals at the solution. None if a residual is not finite.
    """
    theta = theta.copy()
    at = np.asarray(linear)
    offset = residuals(theta)
    basis = np.empty((offset.size, at.size))
    for column, k in enumerate(at):
        moved = theta.copy()
        above, below = space.high[k] - theta[k], theta[k] - space.low[k]
        moved[k] = space.high[k] if above >= below else space.low[k]
        basis[:, column] = (residuals(moved) - offset) / (moved[k] - theta[k])
    offset = offset - basis @ theta[at]
    if not (np.isfinite(offset).all() and np.isfinite(basis).all()):
        return None
    largest = np.abs(basis).max(axis=0, initial=0.0)
    largest[largest == 0] = 1.0
    norm = largest * np.linalg.norm(basis / largest, axis=0)  # of 1e200 too, without overflow
    norm[norm == 0] = 1.0
    low, high = space.low[at], space.high[at]
    basis = basis / norm
    solution = scipy.optimize.lsq_linear(basis, -offset, (low * norm, high * norm), method="bvls")
    theta[at] = np.clip(solution.x / norm, low, high)

    free = solution.active_mask == 0
    basis, at, norm = basis[:, free], at[free], norm[free]
    rest = residuals(theta)
    if not np.isfinite(rest).all():
        return None
    before = theta[at]
    correction = np.linalg.lstsq(basis, -rest)[0] / norm
    theta[at] = np.clip(before + correction, space.low[at], space.high[at])
    return LinearPart(theta, rest + basis @ ((theta[at] - before) * norm), basis)
