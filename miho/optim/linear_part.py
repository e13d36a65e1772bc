"""Solution for the parameters in which the residuals are linear, with the others fixed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads its packages at their first use; importing them here takes a second

from miho.optim.space import Space
from miho.quantities import Array


@dataclass(frozen=True, eq=False)
class LinearPart:
    """Best configuration theta (d,) with the other parameters fixed, and its linear model.

    `residuals` (m,) are at `theta`. `basis` (m, p) has the derivatives with respect to the linear
    parameters off the bounds, each divided by its norm; the residuals are orthogonal to it.
    """

    theta: Array
    residuals: Array
    basis: Array

    def outside(self, columns: Array) -> Array:
        """Part of columns (m, k) that is orthogonal to the basis, (m, k)."""
        if not self.basis.shape[1]:
            return columns
        return np.asarray(columns - self.basis @ np.linalg.lstsq(self.basis, columns)[0])


def solve_linear_part(
    residuals: Callable[[Array], Array], theta: Array, linear: Sequence[int], space: Space
) -> LinearPart | None:
    """Minimise the sum of squared residuals over the parameters at the positions `linear`.

    `theta` (d,) and all evaluated configurations are within the bounds. For p linear parameters
    there are p + 2 evaluations: theta; one for each parameter, as far away as the bounds allow,
    because wide differences of a linear function are more accurate; and the solution. It is the
    ordinary least-squares solution if this is within the bounds, else bounded-variable least
    squares (SciPy, bvls), after one step of iterative refinement [1]_, which recovers from the
    residuals at the solution the digits that the differences lost to rounding. None if a residual
    is not finite.

    References
    ----------
    .. [1] Å. Björck, Numerical Methods for Least Squares Problems, SIAM (1996), section 2.9.
    """
    # The residuals as an offset plus a combination of the columns of the basis.
    theta = theta.copy()
    index = np.asarray(linear)
    offset = residuals(theta)
    basis = np.empty((offset.size, index.size))
    for column, k in enumerate(index):
        probe = theta.copy()
        above, below = space.high[k] - theta[k], theta[k] - space.low[k]
        probe[k] = space.high[k] if above >= below else space.low[k]
        basis[:, column] = (residuals(probe) - offset) / (probe[k] - theta[k])
    offset = offset - basis @ theta[index]
    if not (np.isfinite(offset).all() and np.isfinite(basis).all()):
        return None
    # Solve with columns of norm 1.
    largest = np.abs(basis).max(axis=0, initial=0.0)
    largest[largest == 0] = 1.0
    norm = largest * np.linalg.norm(basis / largest, axis=0)  # no overflow at 1e200
    norm[norm == 0] = 1.0
    low, high = space.low[index], space.high[index]
    basis = basis / norm
    solution = scipy.optimize.lsq_linear(basis, -offset, (low * norm, high * norm), method="bvls")
    theta[index] = np.clip(solution.x / norm, low, high)

    # Refine the parameters that are not at a bound, from the residuals at the solution.
    free = solution.active_mask == 0
    basis, index, norm = basis[:, free], index[free], norm[free]
    solved = residuals(theta)
    if not np.isfinite(solved).all():
        return None
    unrefined = theta[index]
    correction = np.linalg.lstsq(basis, -solved)[0] / norm
    theta[index] = np.clip(unrefined + correction, space.low[index], space.high[index])
    return LinearPart(theta, solved + basis @ ((theta[index] - unrefined) * norm), basis)
