"""One descent in a box by one of SciPy's nonlinear least-squares solvers."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import scipy  # loads its subpackages on first use: importing them takes a second

from miho.methods.unit_box import UnitBox
from miho.optim import Oracle, Space, UnusableValueError
from miho.optim.problem import mean_square
from miho.quantities import Array

Vector = Callable[[Array], Array]

METHODS = ("trf", "lm")
SMALLEST_TOLERANCE = float(np.finfo(float).eps)


def descend(
    residuals: Vector,
    jacobian: Vector,
    start: Array,
    space: Space,
    tolerance: float,
    method: str,
    looks: int | None = None,
) -> bool:
    """Run one of SciPy's solvers from a starting point (d,) in the box of `space`.

    Parameters
    ----------
    residuals, jacobian : callable
        Map parameters (d,) to residuals (m,) and derivatives (m, d).
    start : ndarray of shape (d,)
        Starting point.
    space : Space
        The box.
    tolerance : float
        Relative tolerance.
    method : {'trf', 'lm'}
        The solver.
    looks : int, optional
        Most configurations to evaluate, including the start; by default SciPy's 100 per parameter.

    Returns
    -------
    bool
        Whether the solver converged.
    """
    solve = partial(
        scipy.optimize.least_squares, x_scale="jac", ftol=tolerance, xtol=tolerance, max_nfev=looks
    )
    if method == "trf":
        return _trust_region(residuals, jacobian, start, space, solve)
    # gtol is the cosine between residuals and derivatives, without a unit.
    solve = partial(solve, method="lm", gtol=tolerance)
    return _levenberg_marquardt(residuals, jacobian, start, space, solve)


class Lowest:
    """Residuals that record the configuration `theta` (d,) with the smallest mean square, `loss`.

    Before the first evaluation these are the start and infinity.
    """

    def __init__(self, residuals: Vector, start: Array) -> None:
        self._residuals = residuals
        self.theta = start
        self.loss = math.inf

    def __call__(self, theta: Array) -> Array:
        """The residuals (m,) at `theta` (d,)."""
        residuals = self._residuals(theta)
        loss = float(mean_square(residuals))
        if loss < self.loss:
            self.theta, self.loss = theta.copy(), loss
        return residuals


@contextlib.contextmanager
def ending_where_unusable() -> Iterator[None]:
    """Context that ends a descent with unusable residuals or derivatives without an error."""
    with contextlib.suppress(UnusableValueError, ValueError, np.linalg.LinAlgError):
        yield


def local_search(
    oracle: Oracle, start: Array, tolerance: float, method: str, looks: int | None = None
) -> Lowest:
    """One recorded descent from `start` (d,), and the best of its configurations."""
    lowest = Lowest(oracle.residuals, start)
    with ending_where_unusable(), oracle.starts.descent() as descent:
        descent.converged = descend(
            lowest, oracle.jacobian, start, oracle.space, tolerance, method, looks
        )
    return lowest


def _trust_region(
    residuals: Vector, jacobian: Vector, start: Array, space: Space, solve: Callable[..., Any]
) -> bool:
    """Trust-region reflective solver over the parameters that change the residuals.

    These are the parameters with a nonzero derivative. The others are fixed, and freed if they
    have a nonzero derivative at the end of the search. With a rank-deficient Jacobian, SciPy's
    steps would always be as long as its trust region and would use all evaluations. `solve` is
    `scipy.optimize.least_squares` with tolerances.
    """
    theta, free = start.copy(), np.zeros(start.size, dtype=bool)
    converged = True

    def configuration(values: Array) -> Array:
        whole = theta.copy()
        whole[free] = values
        return whole

    # The residuals and derivatives at `theta` are not evaluated again.
    def look(values: Array) -> Array:
        point = configuration(values)
        return known if np.array_equal(point, theta) else residuals(point)

    def slopes(values: Array) -> Array:
        point = configuration(values)
        columns = known_slopes if np.array_equal(point, theta) else jacobian(point)
        # A selection of all columns would have another memory order and other rounding.
        return columns if free.all() else columns[:, free]

    while not free.all():
        known, known_slopes = residuals(theta), jacobian(theta)
        matters = known_slopes.any(axis=0)
        if not (matters & ~free).any():
            break
        free |= matters
        # gtol is an absolute tolerance, but the unit of the residuals is unknown.
        bounds = space.low[free], space.high[free]
        solution = solve(look, theta[free], jac=slopes, method="trf", bounds=bounds, gtol=None)
        theta, converged = configuration(solution.x), solution.status > 0
    return bool(converged)


def _levenberg_marquardt(
    residuals: Vector, jacobian: Vector, start: Array, space: Space, solve: Callable[..., Any]
) -> bool:
    """MINPACK's solver over angles u with x = (1 + sin u) / 2 in the unit cube.

    This is the transformation of MINUIT (James and Roos, Computer Physics Communications 10,
    1975): all evaluations are inside the box, a start on a bound cannot leave it, and progress
    towards a solution on a bound is slow. MINPACK refuses fewer residuals than parameters, so
    zeros are appended. `solve` is `scipy.optimize.least_squares` with tolerances.
    """
    box = UnitBox(space)

    def configuration(u: Array) -> Array:
        return box.theta((1 + np.sin(u)) / 2)

    def tall(rows: Array) -> Array:
        lacking = max(0, start.size - len(rows))
        return np.concatenate((rows, np.zeros((lacking, *rows.shape[1:]))))

    def look(u: Array) -> Array:
        return tall(residuals(configuration(u)))

    def slopes(u: Array) -> Array:
        theta = configuration(u)
        return tall(jacobian(theta) * box.slope(theta) * np.cos(u) / 2)

    return bool(solve(look, np.arcsin(2 * box.x(start) - 1), jac=slopes).status > 0)
