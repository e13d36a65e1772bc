"""A least-squares optimum from nearby: the step that profiles, bootstraps and validation repeat."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from miho.identification.curve_fit import CurveFit

Array = NDArray[np.float64]


EVALUATIONS = 200
"""Enough from nearby; a valley that takes longer has no optimum to speak of."""


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
    low, high = space.bounds
    theta = space.clip(start)
    free = np.array([i for i in range(theta.size) if i not in fixed], dtype=int)
    root = None if weights is None else np.sqrt(weights)
    logs = np.array([p.scale == "log" for p in space.parameters])

    def complete(part: Array) -> Array:
        whole = space.encode(theta).copy()
        whole[free] = low[free] + (high - low)[free] * part
        moved = space.decode(whole)
        moved[list(fixed)] = theta[list(fixed)]
        return np.asarray(space.clip(moved))

    def residuals(part: Array) -> Array:
        values = problem.residuals(complete(part))
        return values if root is None else values * root

    def jacobian(part: Array) -> Array:
        moved = complete(part)
        stretch = (high - low) * np.where(logs, moved, 1.0)
        derivatives = problem.jacobian(moved)[:, free] * stretch[free]
        return np.asarray(derivatives if root is None else derivatives * root[:, None])

    before = problem.residuals(theta) if root is None else problem.residuals(theta) * root
    here = Refit(theta, float(before @ before))
    if not free.size or here.cost == 0:
        return here
    # From 0 to 1 across the box and without an absolute tolerance: no unit is too small.
    solution = scipy.optimize.least_squares(
        residuals,
        np.clip(((space.encode(theta) - low) / (high - low))[free], 0.0, 1.0),
        jac=jacobian,
        bounds=(0.0, 1.0),
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=None,
        max_nfev=EVALUATIONS,
    )
    cost = 2 * float(solution.cost)
    return Refit(complete(solution.x), cost) if cost < here.cost else here
