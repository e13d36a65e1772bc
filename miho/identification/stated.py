"""The parameters of a model as the user stated them: free, fixed and tied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.identification.line_wrapping import with_unit
from miho.identification.uncertainty import Linearised, at_bounds, parameters_at_bounds
from miho.optim.space import Space
from miho.quantities import Array

FREE = "free"
NEAR = 1e-6
"""A tied parameter is at a limit if it is this close, as a share of the limit or of its range."""


class Stated(NamedTuple):
    """One parameter with its value, unit, standard error, and the reason if it is not free.

    `status` is "free", "fixed", "= EXPRESSION", "at lower bound", "at upper bound" or "not
    identifiable". The standard error is 0 for a fixed parameter, NaN at a bound, and infinite if
    the data do not determine the parameter.
    """

    name: str
    unit: str
    value: float
    standard_error: float
    status: str


def reported_space(space: Space) -> Space:
    """The space of reported parameters: constrained parameters replace the shares in them."""
    return replace(space, parameters=tuple(p.stands_for or p for p in space.parameters))


def reported_values(problem: CurveFit, thetas: Array) -> Array:
    """Values (n, d) of the reported parameters at free parameters (n, d)."""
    swapped, ties = _swapped(problem.space), problem.model.ties
    if ties is None or not swapped:
        return thetas
    places = [ties.names.index(name) for name in swapped.values()]
    values = thetas.copy()
    values[:, list(swapped)] = ties.values(thetas)[:, places]
    return values


def reported_slopes(problem: CurveFit, theta: Array) -> Array:
    """Derivatives (d, d) of the reported parameters with respect to the free ones (d,)."""
    swapped, slopes = _swapped(problem.space), np.eye(theta.size)
    if swapped:
        slopes[list(swapped)] = tied_slopes(problem, theta, list(swapped.values()))
    return slopes


def reported_uncertainty(problem: CurveFit, at: Linearised) -> Linearised:
    """The uncertainty of the reported parameters."""
    places = list(_swapped(problem.space))
    if not places:
        return at
    slopes = reported_slopes(problem, at.theta)
    values = reported_values(problem, at.theta[None])[0]
    at_bound, lost = at.at_bound.copy(), at.unidentifiable.copy()
    at_bound[places] = at_bounds(reported_space(problem.space), values)[places]
    lost[places] = np.isinf(at.spread(slopes[places]))
    return at.mapped(values, slopes, at_bound, lost)


def tied_names(problem: CurveFit) -> list[str]:
    """The tied parameters and quantities that have no share."""
    ties = problem.model.ties
    if ties is None:
        return []
    reported = reported_space(problem.space).names
    return [n for n in ties.names if isinstance(ties.ties.get(n), str) and n not in reported]


def tied_slopes(problem: CurveFit, theta: Array, names: Sequence[str]) -> Array:
    """Derivatives (k, d) of tied parameters with respect to the free ones (d,)."""
    ties = problem.model.ties
    if ties is None:
        raise ValueError(f"{problem.name} has no tied parameters")
    places = [ties.names.index(name) for name in names]
    return np.asarray(ties.value_slopes(theta[None])[0, places])


def _swapped(space: Space) -> dict[int, str]:
    """Positions of the shares, and names of the parameters that they determine."""
    return {k: p.stands_for.name for k, p in enumerate(space.parameters) if p.stands_for}


def stated_parameters(problem: CurveFit, at: Linearised) -> tuple[list[Stated], Array]:
    """All parameters as stated, and their derivatives (d, f) with respect to the free ones.

    Parameters of the model come first, then quantities, then parameters of the space only. Shares
    are omitted, and the parameters that they determine count as free.
    """
    ties = problem.model.ties
    units = {parameter.name: parameter.unit for parameter in problem.space.parameters}
    slopes = np.eye(len(units))
    errors = dict(zip(units, at.standard_errors, strict=True))
    values = dict(zip(units, at.theta, strict=True))
    own_uncertainty = reported_uncertainty(problem, at)
    free = _status(own_uncertainty, reported_space(problem.space))
    if ties is None:
        return [Stated(n, units[n], values[n], errors[n], free[n]) for n in units], slopes
    own = {**problem.model.whole.parameters, **ties.quantities}
    rows = ties.value_slopes(at.theta[None])[0]
    values |= dict(zip(ties.names, ties.values(at.theta[None])[0], strict=True))
    spread = dict(zip(ties.names, at.spread(rows), strict=True))
    swapped = _swapped(problem.space)
    extra = [n for k, n in enumerate(units) if n not in own and k not in swapped]
    errors |= {name: own_uncertainty.standard_errors[k] for k, name in swapped.items()}
    stated = []
    for name in (*own, *extra):
        tie = ties.ties.get(name)
        status = f"= {tie}" if isinstance(tie, str) else "fixed"
        if tie is None or name in errors:
            status = free[name]
        error = errors[name] if name in errors else spread[name]
        unit = units.get(name) or own.get(name, "")
        stated.append(Stated(name, unit, values[name], error, status))
    chosen = [list(units).index(name) for name in extra]
    return stated, np.vstack([rows, slopes[chosen]])


def stated_intervals(
    stated: Sequence[Stated], slopes: Array, at: Linearised, level: float
) -> Array:
    """Linearised intervals (d, 2) of stated parameters with derivatives (d, f)."""
    values, errors = np.array([(p.value, p.standard_error) for p in stated]).reshape(-1, 2).T
    reach = at.quantiles(slopes, level) * errors
    return np.stack([values - reach, values + reach], axis=1)


def _status(at: Linearised, space: Space) -> dict[str, str]:
    """The state of each parameter of a space: FREE, at a bound, or not identifiable."""
    status = dict.fromkeys(space.names, FREE)
    status |= {space.names[k]: "not identifiable" for k in np.flatnonzero(at.unidentifiable)}
    return status | {
        name: f"at {end} bound"
        for name, end, _ in parameters_at_bounds(space, at.theta, at.at_bound)
    }


def marked(problem: CurveFit, theta: Array, at: Linearised | None) -> list[str]:
    """The parameters without a finite standard error, each with its value and the reason.

    For example "b = 1e+06 1/s (at its upper bound)" and "c = 3.2 (± not determined)". `at` is the
    uncertainty of the optimum `theta` (d,), or None.
    """
    space = reported_space(problem.space)
    values = reported_values(problem, theta[None])[0]
    reached = parameters_at_bounds(space, values, at_bounds(space, values))
    bounds = {name: f"at its {end} bound" for name, end, _ in reached}
    units = {p.name: p.unit for p in space.parameters}
    errors = dict.fromkeys(space.names, np.nan)
    if at is not None:
        stated = stated_parameters(problem, at)[0]
        units |= {parameter.name: parameter.unit for parameter in stated}
        errors = {parameter.name: parameter.standard_error for parameter in stated}
    whole = whole_values(problem, theta)
    return [
        with_unit(f"{name} = {whole[name]:.5g}", units[name])
        + f" ({bounds.get(name, '± not determined')})"
        for name, error in errors.items()
        if name in bounds or not np.isfinite(error)
    ]


def profiled_parameters(problem: CurveFit, at: Linearised) -> dict[str, int | str]:
    """Position or name of the parameters with a finite standard error, the tied ones last."""
    free, reported = problem.space.names, reported_space(problem.space).names
    errors = reported_uncertainty(problem, at).standard_errors
    usable = np.flatnonzero(np.isfinite(errors) & (errors > 0)).tolist()
    places: dict[str, int | str] = {
        reported[k]: k if reported[k] == free[k] else reported[k] for k in usable
    }
    tied = tied_names(problem)
    if tied:
        spread = at.independent.spread(tied_slopes(problem, at.theta, tied))
        places |= {n: n for n, e in zip(tied, spread, strict=True) if 0 < e < np.inf}
    return places


def whole_values(problem: CurveFit, theta: Array) -> dict[str, float]:
    """Values of all parameters by name at free ones (f,), the parameters of the model first."""
    ties, free = problem.model.ties, dict(zip(problem.space.names, theta.tolist(), strict=True))
    if ties is None:
        return free
    whole = ties.values(theta[None])[0].tolist()
    shares = [problem.space.names[k] for k in _swapped(problem.space)]
    values = {**dict(zip(ties.names, whole, strict=True)), **free}
    return {name: value for name, value in values.items() if name not in shares}


def at_limits(problem: CurveFit, theta: Array) -> list[str]:
    """A sentence for each tied parameter that ends at a limit of its range."""
    ties = problem.model.ties
    if ties is None:
        return []
    values = whole_values(problem, theta)
    sentences = [
        f"{name} ends at its limit {end:g}, so the standard errors of the parameters that it is "
        "tied to do not hold; profile intervals respect the limit"
        for name, ends in ties.limits.items()
        for end in ends
        if np.isfinite(end) and abs(values[name] - end) <= NEAR * max(abs(end), _width(ends))
    ]
    free = at_bounds(problem.space, theta)
    own = at_bounds(reported_space(problem.space), reported_values(problem, theta[None])[0])
    return sentences + [
        f"{name} ends at a constraint, where it is {values[name]:.6g}: its standard error and the "
        "standard errors of the other parameters in that constraint do not hold; profile intervals "
        "respect the constraint"
        for k, name in _swapped(problem.space).items()
        if free[k] and not own[k]
    ]


def _width(ends: tuple[float, float]) -> float:
    width = ends[1] - ends[0]
    return width if np.isfinite(width) else 0.0
