"""A least-squares optimum from nearby: the step that profiles, bootstraps and validation repeat."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from miho.identification.curve_fit import CurveFit

Array = NDArray[np.float64]


class Refit(NamedTuple):
    """A local optimum: its parameters (d,) and the sum of squared (transformed) residuals."""

    theta: Array
    cost: float


def refit(
    problem: CurveFit,
    start: Array,
    weights: Array | None = None,
    fixed: Sequence[int] = (),
    tolerance: float = 1e-10,
) -> Refit:
    """The optimum of the problem near `start` (d,), within the box.

    `weights` (N,) multiply the squared residuals; the parameters at the positions `fixed` stay at
    their start.
    """
    space = problem.space
    theta = space.clip(start)
    free = np.array([i for i in range(theta.size) if i not in fixed], dtype=int)
    root = None if weights is None else np.sqrt(weights)

    def complete(part: Array) -> Array:
        whole = theta.copy()
        whole[free] = part
        return whole

    def residuals(part: Array) -> Array:
        values = problem.residuals(complete(part))
        return values if root is None else values * root

    def jacobian(part: Array) -> Array:
        derivatives = problem.jacobian(complete(part))[:, free]
        return derivatives if root is None else derivatives * root[:, None]

    if not free.size:
        r = residuals(theta[free])
        return Refit(theta, float(r @ r))
    solution = scipy.optimize.least_squares(
        residuals,
        theta[free],
        jac=jacobian,
        bounds=(space.low[free], space.high[free]),
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
    )
    return Refit(complete(solution.x), 2 * float(solution.cost))
