"""When a loss is zero to rounding: a sum of squares has no smaller one, so that this is the best.

Where the data are other than 0, their size says what rounding is (`Problem.rounding`), unless they
vary by less than a millionth of it, so that rounding is not far below all that they tell.

For a system of equations, whose data are all 0, nothing but the model says it, whose terms cancel
at a solution. Their size over the box is no measure: in a box a million times as wide as the
solution a polynomial of degree four is 10^24 larger. What a search can resolve at all is one.
Methods search in coordinates from one bound to the other, so that a parameter is rounded by EPSILON
of its larger bound, and a residual with it by that times its derivatives where they are. No method
finds a solution to more digits than that in this box.

The median over the rows counts, so that a few rows with large derivatives do not excuse the others.
And since all derivatives may be large where nothing is solved, as at (0, 10^6) in Beale's function,
the terms have to cancel too: the residuals are small next to the parameters times their
derivatives. So a solution may be overlooked, such as one at 0 where most equations are squares; its
evidence are then the brackets that agree, as anywhere. The wider the box, the larger is what counts
as zero: in one of 10^6 for a solution near 1, an error of 2e-9 times the derivatives.
"""

from __future__ import annotations

import numpy as np

from miho.optim.space import Space
from miho.quantities import Array

EPSILON = float(np.finfo(float).eps)
ROUNDINGS = 10.0
"""So many roundings add up in a residual: of the coordinate, of the parameter that it stands for,
and of the operations of the model."""
CANCELLED = 1e-4
"""At a solution the residuals are at most this share of the terms that cancel. Where rounding is
all that is left they are far less; a double root, such as that of Powell's singular function, is
found to half of the digits, and its terms cancel to 1e-7, or 4e-6 in a box of 10^5."""


def is_rounding(loss: float, rounding: float, resolution: float) -> bool:
    """Whether a loss is zero by the `rounding` of a problem, which is below its `resolution`.

    An error that counts as zero is then below 1.5e-8 of the data's standard deviation, the root of
    EPSILON, which is what `resolution` is of their variance.
    """
    return loss == 0 or loss <= rounding < resolution


def is_zero(r: Array, J: Array, x: Array, space: Space) -> bool:
    """Whether residuals r (m,), of which nobody says what rounding is, are zero to rounding.

    J (m, d) are their derivatives at the search coordinates `x` (d,) of the space.
    """
    error = float(np.sqrt(np.mean(r**2)))
    if error == 0:
        return True
    low, high = space.bounds
    bound = np.maximum(np.abs(low), np.abs(high))
    size = np.where([p.scale == "log" for p in space.parameters], 1.0, np.abs(x))
    with np.errstate(over="ignore", invalid="ignore"):
        resolved, terms = (float(np.median(np.abs(J) @ part)) for part in (bound, size))
    limit = min(ROUNDINGS * EPSILON * resolved, CANCELLED * terms)
    return bool(np.isfinite(limit) and error <= limit)
