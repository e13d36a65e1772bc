"""Descents along the limits of tied parameters, beyond which no configuration has a value.

A descent that meets such a limit can only shorten its steps. From there sequential quadratic
programming goes on (Nocedal and Wright, Numerical Optimization, 2nd ed. 2006, Ch. 18), with the
limits as constraints and values beyond them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.models.tied import TiedExpression, TiedModel, Ties, tie
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.curve_fit import CurveFit

CLOSE = 1e-2
"""A tied parameter this close to a limit, as a share of its size, may be held back by it."""
MARGIN = 1e-9
"""What is kept from a limit, as a share of the size, for rounding."""
STEPS = 200


def along_limits(problem: CurveFit, theta: Array, fixed: Collection[int] = ()) -> Array:
    """A better configuration (d,) along the limits that `theta` (d,) is close to, else `theta`.

    The parameters at the positions `fixed` stay where they are.
    """
    model = problem.model
    if not isinstance(model, TiedModel | TiedExpression) or not model.ties.limits:
        return theta
    sides = _Sides(model.ties)
    if sides.slack(theta).min() > CLOSE:
        return theta
    beyond = replace(
        problem, model=tie(model.model, replace(model.ties, limits={})), compiled=False
    )
    space = problem.space
    low, high = space.low.copy(), space.high.copy()
    low[list(fixed)] = high[list(fixed)] = theta[list(fixed)]
    width = np.where(high > low, high - low, 1.0)
    start = float(np.sum(problem.residuals(theta) ** 2))
    if not start > 0:
        return theta

    def cost(u: Array) -> tuple[float, Array]:
        at = low + u * width
        r, J = beyond.residuals(at), beyond.jacobian(at)
        return float(r @ r) / start, 2 * (J.T @ r) * width / start

    solution = scipy.optimize.minimize(  # type: ignore[call-overload]
        cost,
        (theta - low) / width,
        jac=True,
        method="SLSQP",
        bounds=list(zip(np.zeros(low.size), (high - low) / width, strict=True)),
        constraints={
            "type": "ineq",
            "fun": lambda u: sides.slack(low + u * width) - MARGIN,
            "jac": lambda u: sides.slopes(low + u * width) * width,
        },
        options={"maxiter": STEPS, "ftol": 1e-14},
    )
    end = space.clip(low + solution.x * width)
    end[list(fixed)] = theta[list(fixed)]
    inside = sides.slack(end).min() >= 0
    return end if inside and float(np.sum(problem.residuals(end) ** 2)) < start else theta


class _Sides:
    """The finite limits of tied parameters, each as a slack that is 0 at the limit."""

    def __init__(self, ties: Ties) -> None:
        self._ties = ties
        sides = []
        for name, ends in ties.limits.items():
            size = ends[1] - ends[0] if np.isfinite(ends).all() else max(np.abs(
                [end for end in ends if np.isfinite(end)]).max(), 1.0)  # fmt: skip
            place = ties.names.index(name)
            sides += [(place, sign, end, max(size, 1e-300))
                      for sign, end in zip((1.0, -1.0), ends, strict=True)
                      if np.isfinite(end)]  # fmt: skip
        self._places = [side[0] for side in sides]
        self._signs, self._ends, self._sizes = (np.array([s[k] for s in sides]) for k in (1, 2, 3))

    def slack(self, theta: Array) -> Array:
        """How far each is inside, (k,), as a share of its size."""
        values = self._ties.values(theta[None])[0, self._places]
        return np.asarray(self._signs * (values - self._ends) / self._sizes)

    def slopes(self, theta: Array) -> Array:
        """Its derivatives, (k, d)."""
        slopes = self._ties.value_slopes(theta[None])[0, self._places]
        return np.asarray(slopes * (self._signs / self._sizes)[:, None])
