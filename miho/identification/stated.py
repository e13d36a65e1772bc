"""The parameters of a model as a user stated them: free, fixed and tied ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.identification.uncertainty import Linearised
from miho.models.tied import TiedExpression, TiedModel
from miho.quantities import Array

FREE = "free"
NEAR = 1e-6
"""A tied parameter this close to a limit, as a share of it or of its range, is at the limit."""


class Stated(NamedTuple):
    """One parameter: value, unit and standard error; `held` is FREE, "fixed" or an expression.

    The error is 0 for a fixed one, NaN for one at its bound, infinite for one that the data do not
    determine.
    """

    name: str
    unit: str
    value: float
    standard_error: float
    held: str


def stated_parameters(problem: CurveFit, at: Linearised) -> tuple[list[Stated], Array]:
    """The model's parameters, then those of the space only, and the derivatives of all of them
    with respect to the free ones, (d, f), to first order in which errors propagate."""
    model = problem.model
    units = {parameter.name: parameter.unit for parameter in problem.space.parameters}
    slopes = np.eye(len(units))
    errors = dict(zip(units, at.standard_errors, strict=True))
    values = dict(zip(units, at.theta, strict=True))
    if not isinstance(model, TiedModel | TiedExpression):
        return [Stated(n, units[n], values[n], errors[n], FREE) for n in units], slopes
    ties = model.ties
    own = {**model.model.parameters, **ties.quantities}
    rows = ties.value_slopes(at.theta[None])[0]
    values |= dict(zip(ties.names, ties.values(at.theta[None])[0], strict=True))
    spread = dict(zip(ties.names, at.spread(rows), strict=True))
    extra = [name for name in units if name not in own]
    stated = []
    for name in (*own, *extra):
        tie = ties.ties.get(name)
        held = FREE if tie is None else f"= {tie}" if isinstance(tie, str) else "fixed"
        error = errors[name] if name in errors else spread[name]
        stated.append(Stated(name, units.get(name) or own.get(name, ""), values[name], error, held))
    chosen = [list(units).index(name) for name in extra]
    return stated, np.vstack([rows, slopes[chosen]])


def whole_values(problem: CurveFit, theta: Array) -> dict[str, float]:
    """Values of all parameters by name, those of the model first, at free ones (f,)."""
    model, free = problem.model, dict(zip(problem.space.names, theta.tolist(), strict=True))
    if not isinstance(model, TiedModel | TiedExpression):
        return free
    whole = model.ties.values(theta[None])[0].tolist()
    return {**dict(zip(model.ties.names, whole, strict=True)), **free}


def at_limits(problem: CurveFit, theta: Array) -> list[str]:
    """A sentence for each tied parameter that ends at a limit of its range."""
    model = problem.model
    if not isinstance(model, TiedModel | TiedExpression):
        return []
    values = whole_values(problem, theta)
    return [
        f"{name} ends at its limit {end:g}, so the errors of what it is tied to are no optimum's"
        for name, ends in model.ties.limits.items()
        for end in ends
        if np.isfinite(end) and abs(values[name] - end) <= NEAR * max(abs(end), _width(ends))
    ]


def _width(ends: tuple[float, float]) -> float:
    width = ends[1] - ends[0]
    return width if np.isfinite(width) else 0.0
