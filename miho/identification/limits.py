"""Descents along the limits of tied parameters, beyond which a configuration has no value.

A descent that reaches such a limit can only shorten its steps. Sequential quadratic programming
continues from there (Nocedal and Wright, Numerical Optimization, 2nd ed. 2006, Ch. 18), with the
limits as constraints and a model that has values beyond them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.models.tied import Tied, Ties, tie
from miho.optim.space import Parameter
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.curve_fit import CurveFit

CLOSE = 1e-2
"""A limit may be active if a tied parameter is this close to it, as a share of its size."""
MARGIN = 1e-9
"""Distance to a limit that allows for rounding, as a share of the size."""
STEPS = 200
CORRECTIONS = 5


class Pin(NamedTuple):
    """A further residual: `weight` times the distance of a tied parameter from `value`.

    A large weight fixes the parameter there (Nocedal and Wright 2006, Ch. 17.1).
    """

    ties: Ties
    name: str
    value: float
    weight: float

    def residual(self, theta: Array) -> float:
        """The residual at free parameters (d,)."""
        value = self.ties.values(theta[None])[0, self.ties.names.index(self.name)]
        return float(self.weight * (value - self.value))

    def slope(self, theta: Array) -> Array:
        """Derivatives (d,) of the residual."""
        slopes = self.ties.value_slopes(theta[None])[0, self.ties.names.index(self.name)]
        return np.asarray(self.weight * slopes)


def along_limits(
    problem: CurveFit, theta: Array, fixed: Collection[int] = (), pin: Pin | None = None
) -> Array:
    """A better configuration (d,) along limits close to `theta` (d,); `theta` if there is none.

    `theta` may be beyond a limit. Parameters at the positions `fixed` do not change.
    """
    model = problem.model
    if not isinstance(model, Tied) or not model.ties.limits:
        return theta
    sides = _Sides(model.ties)
    slack = float(sides.slack(theta).min())
    if not slack <= CLOSE:
        return theta
    # The problem without limits, its cost relative to the start, in shares of the box.
    unlimited = tie(model.model, replace(model.ties, limits={}))
    cost = _Cost(replace(problem, model=unlimited, compiled=False, expensive=True), pin)
    start = cost.value(theta)
    if not start > 0:
        return theta
    space = problem.space
    low, high = space.low.copy(), space.high.copy()
    low[list(fixed)] = high[list(fixed)] = theta[list(fixed)]
    width = np.where(high > low, high - low, 1.0)

    limits = {
        "type": "ineq",
        "fun": lambda u: sides.slack(low + u * width) - MARGIN,
        "jac": lambda u: sides.slopes(low + u * width) * width,
    }
    u = cost.lowest(theta, start, low, width, (high - low) / width, limits)
    # At curved limits it may end slightly beyond them.
    end = np.clip(low + u * width, low, high)
    for _ in range(CORRECTIONS):
        beyond = sides.slack(end) < 0
        if not beyond.any():
            break
        missing = MARGIN - sides.slack(end)[beyond]
        shares = np.linalg.pinv(sides.slopes(end)[beyond] * (high - low)) @ missing
        end = np.clip(end + shares * (high - low), low, high)
    end = space.clip(end)
    # Accept an end within the limits that is better, or if the start was beyond a limit.
    end[list(fixed)] = theta[list(fixed)]
    inside = sides.slack(end).min() >= 0
    return end if inside and cost.value(end) < (np.inf if slack < 0 else start) else theta


def along_sides(problem: CurveFit, theta: Array) -> Array:
    """A better configuration (d,) along the sides of a radial polytope; `theta` if there is none.

    The map from shares to points has a kink wherever another side becomes the nearest one. A
    descent in shares stops there, so this one uses the points.
    """
    model = problem.model
    if not isinstance(model, Tied) or model.ties.radial is None:
        return theta
    radial, places = model.ties.radial, model.ties.shares
    # The problem in terms of points, its cost relative to the start, in shares of their ranges.
    parameters = list(problem.space.parameters)
    for k, low, high in zip(places, radial.low.tolist(), radial.high.tolist(), strict=True):
        parameters[k] = Parameter(parameters[k].name, "", low, high)
    space = replace(problem.space, parameters=tuple(parameters), radial=None)
    plain = tie(model.model, replace(model.ties, radial=None))
    cost = _Cost(replace(problem, model=plain, space=space, compiled=False, expensive=True), None)
    first = theta.copy()
    first[places] = radial.points(theta[None, places])[0]
    start, low, width = cost.value(first), space.low, space.high - space.low
    sides = np.zeros((len(radial.sides), theta.size))
    sides[:, places] = radial.sides * width[places] / radial.width
    beyond = 1 - MARGIN + radial.sides @ ((radial.centre - low[places]) / radial.width)

    if not 0 < start < np.inf:
        return theta
    limits = {"type": "ineq", "fun": lambda u: beyond - sides @ u, "jac": lambda u: -sides}
    u = cost.lowest(first, start, low, width, np.ones(theta.size), limits)
    end = space.clip(low + u * width)
    if not (sides @ u <= beyond + MARGIN).all() or not cost.value(end) < start:
        return theta
    end[places] = radial.shares(end[places])
    return end


class _Cost:
    """The sum of squared residuals, including a pin."""

    def __init__(self, problem: CurveFit, pin: Pin | None) -> None:
        self._problem, self._pin = problem, pin

    def value(self, theta: Array) -> float:
        """The sum at one configuration (d,)."""
        pinned = 0.0 if self._pin is None else self._pin.residual(theta) ** 2
        return float(np.sum(self._problem.residuals(theta) ** 2)) + pinned

    def gradient(self, theta: Array) -> Array:
        """Derivatives (d,) of the sum."""
        residuals, J = self._problem.residuals(theta), self._problem.jacobian(theta)
        slope = 2 * J.T @ residuals
        if self._pin is not None:
            slope += 2 * self._pin.residual(theta) * self._pin.slope(theta)
        return np.asarray(slope)

    def lowest(
        self, theta: Array, start: float, low: Array, width: Array, ends: Array, limits: Any
    ) -> Array:
        """Shares (d,) of the box, up to `ends`, with the lowest sum within the limits.

        The descent begins at `theta` (d,), and `start` is the sum there.
        """

        def scaled(u: Array) -> tuple[float, Array]:
            at = low + u * width
            return self.value(at) / start, self.gradient(at) * width / start

        solution = scipy.optimize.minimize(
            scaled, (theta - low) / width, jac=True, method="SLSQP", constraints=limits,
            bounds=list(zip(np.zeros(low.size), ends, strict=True)),
            options={"maxiter": STEPS, "ftol": 1e-14},
        )  # fmt: skip
        return np.asarray(solution.x)


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
        """Distances (k,) to the limits, as shares of their sizes; negative beyond a limit."""
        values = self._ties.values(theta[None])[0, self._places]
        return np.asarray(self._signs * (values - self._ends) / self._sizes)

    def slopes(self, theta: Array) -> Array:
        """Derivatives (k, d) of the slacks."""
        slopes = self._ties.value_slopes(theta[None])[0, self._places]
        return np.asarray(slopes * (self._signs / self._sizes)[:, None])
