"""Test whether a loss is zero up to rounding; a sum of squares has no smaller value.

For data that are not all 0, their size determines the rounding (`Problem.rounding`), unless they
vary by less than a millionth of it: rounding is then close to their variation.

For a system of equations, whose data are all 0, only the model determines it: its terms cancel at
a solution. The size of the terms over the box is no measure: in a box a million times as wide as
the solution, a polynomial of degree four is 10^24 larger. The resolution of the search is one.
Methods search in coordinates from bound to bound. A parameter is therefore rounded by EPSILON of
its larger bound, and a residual by this times its local derivatives. No method finds a solution to
more digits in this box.

The median over the rows is compared, so that a few rows with large derivatives do not excuse the
others. All derivatives may also be large away from a solution, as at (0, 10^6) in Beale's
function. So the terms must cancel too: the residuals must be small relative to the parameters
times their derivatives. The test may miss a solution, for example at 0 if most equations are
squares; then the agreement of brackets is the evidence, as for any optimum. The limit grows with
the box: with bounds of 10^6 for a solution near 1, it is 2e-9 times the derivatives.
"""

from __future__ import annotations

import numpy as np

from miho.optim.evidence import EPSILON
from miho.optim.space import Space
from miho.quantities import Array

ROUNDINGS = 10.0
"""Number of roundings that add up in a residual: of the coordinate, the parameter and the
operations of the model."""
CANCELLED = 1e-4
"""At a solution the residuals are at most this share of the terms that cancel. They are far smaller
if only rounding is left. A double root, as in Powell's singular function, is found to half of the
digits, and its terms cancel to 1e-7, or 4e-6 in a box of 10^5."""


def is_zero(r: Array, J: Array, x: Array, space: Space) -> bool:
    """Whether residuals r (m,) of a problem without a known rounding are zero up to rounding.

    J (m, d) has their derivatives at the search coordinates `x` (d,) of the space.
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
