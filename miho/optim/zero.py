"""When a loss is zero to rounding: a sum of squares has no smaller one, so that this is the best.

Where the data are other than 0, their size says what rounding is (`Problem.rounding`). For a system
of equations, whose data are all 0, nothing but the model does, whose terms cancel at a solution.
Their size over the box says nothing either: in a box a million times as wide as the solution a
polynomial of degree four is 10^24 larger. What a search can resolve at all is the measure here.
Methods search in coordinates from one bound to the other, so that a parameter is rounded by EPSILON
of its larger bound, and the residuals with it by that times their derivatives where they are. No
method finds a solution to more digits than that in this box, and near a solution the terms that
cancel are of the same size as the parameters times their derivatives.

So the wider the box, the larger is what counts as zero: in one of 10^6 for a solution near 1, an
error of 1e-9 times the derivatives. Rows count together: one that is not zero is overlooked where
the derivatives of others are 10^14 times larger.
"""

from __future__ import annotations

import numpy as np

from miho.optim.space import Space
from miho.quantities import Array

EPSILON = float(np.finfo(float).eps)
ROUNDINGS = 10.0
"""So many roundings add up in a residual: of the coordinate, of the parameter that it stands for,
and of the operations of the model."""


def is_zero(loss: float, rounding: float, slopes: Array, space: Space) -> bool:
    """Whether a loss, a mean square of residuals, is zero to rounding.

    Losses up to `rounding` are, that of the problem, if it is above 0. If it is not, losses up to
    the square of what rounded parameters change: `slopes` (d,) are the root mean squares over the
    rows of the residuals' derivatives with respect to the search coordinates of the space.
    """
    if rounding > 0:
        return loss <= rounding
    low, high = space.bounds
    size = np.maximum(np.abs(low), np.abs(high))
    with np.errstate(over="ignore", invalid="ignore"):
        resolved = float((ROUNDINGS * EPSILON) ** 2 * np.sum((slopes * size) ** 2))
    return bool(np.isfinite(resolved) and loss <= resolved)
