"""One descent in a box by one of SciPy's nonlinear least-squares solvers."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second
from numpy.typing import NDArray

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
    """One of SciPy's solvers from one start (d,), in the box of `space`; whether it converged.

    It looks at `looks` configurations at most, the start among them; by default SciPy's 100 a
    parameter.
    """
    solve = _trust_region if method == "trf" else _levenberg_marquardt
    return solve(residuals, jacobian, start, space, tolerance, looks)


class Lowest:
    """Residuals that remember where their mean square, `loss`, was smallest: `theta` (d,)."""

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
def given_up() -> Iterator[None]:
    """A descent that comes to unusable residuals or derivatives ends there."""
    with contextlib.suppress(UnusableValueError, ValueError, np.linalg.LinAlgError):
        yield


def local_search(
    oracle: Oracle, start: Array, tolerance: float, method: str, looks: int | None = None
) -> Lowest:
    """One descent of the run from `start` (d,): where it was lowest, +inf where nowhere."""
    lowest = Lowest(oracle.residuals, start)
    with given_up(), oracle.descent() as descent:
        descent.converged = descend(
            lowest, oracle.jacobian, start, oracle.space, tolerance, method, looks
        )
    return lowest


def _trust_region(
    residuals: Vector,
    jacobian: Vector,
    start: Array,
    space: Space,
    tolerance: float,
    looks: int | None,
) -> bool:
    """Moves the parameters that the residuals depend on: those with a derivative that is not zero.

    On a Jacobian without full rank SciPy takes only steps as long as its trust region, and spends
    all its looks on them. The other parameters are held, and move too if they have derivatives
    where the first ones end.
    """
    theta, moved = start.copy(), np.zeros(start.size, dtype=bool)
    converged = True
    while not moved.all():
        known, slopes = residuals(theta), jacobian(theta)
        if not (slopes.any(axis=0) & ~moved).any():
            break
        moved |= slopes.any(axis=0)
        theta, converged = _solve(
            residuals, jacobian, theta, (known, slopes), moved, space, tolerance, looks
        )
    return converged


def _solve(
    residuals: Vector,
    jacobian: Vector,
    theta: Array,
    known: tuple[Array, Array],
    moved: NDArray[np.bool_],
    space: Space,
    tolerance: float,
    looks: int | None,
) -> tuple[Array, bool]:
    """The solution from `theta`, and whether it is one.

    The residuals and the Jacobian of `theta` are `known`, and not paid for again.
    """

    def at(part: Array) -> Array:
        whole = theta.copy()
        whole[moved] = part
        return whole

    def look(part: Array) -> Array:
        here = at(part)
        return known[0] if np.array_equal(here, theta) else residuals(here)

    def slopes(part: Array) -> Array:
        here = at(part)
        columns = known[1] if np.array_equal(here, theta) else jacobian(here)
        # A selection of all columns would be stored, and so rounded, in another order.
        return columns if moved.all() else columns[:, moved]

    solution = scipy.optimize.least_squares(
        look,
        theta[moved],
        jac=slopes,
        bounds=(space.low[moved], space.high[moved]),
        method="trf",
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=None,  # it is absolute, and no unit of the residuals is known here
        max_nfev=looks,
    )
    return at(solution.x), solution.status > 0


def _levenberg_marquardt(
    residuals: Vector,
    jacobian: Vector,
    start: Array,
    space: Space,
    tolerance: float,
    looks: int | None,
) -> bool:
    """Moves angles u with x = (1 + sin u) / 2 in the unit cube, the transformation of MINUIT.

    James and Roos (Computer Physics Communications 10, 1975): no look leaves the box, a start on a
    bound cannot leave it, and towards a solution on a bound progress is slow. Where residuals are
    fewer than parameters, which MINPACK refuses, residuals of zero are added.
    """
    box = UnitBox(space)

    def at(u: Array) -> Array:
        return box.theta((1 + np.sin(u)) / 2)

    def tall(rows: Array) -> Array:
        lacking = max(0, start.size - len(rows))
        return np.concatenate((rows, np.zeros((lacking, *rows.shape[1:]))))

    def look(u: Array) -> Array:
        return tall(residuals(at(u)))

    def slopes(u: Array) -> Array:
        theta = at(u)
        return tall(jacobian(theta) * box.slope(theta) * np.cos(u) / 2)

    solution = scipy.optimize.least_squares(
        look,
        np.arcsin(2 * box.x(start) - 1),
        jac=slopes,
        method="lm",
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,  # the cosine between residuals and derivatives: it has no unit
        max_nfev=looks,
    )
    return bool(solution.status > 0)
