"""Optima that the data cannot distinguish: together they make up the uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.identification.deadline import Deadline
from miho.identification.line_wrapping import with_unit
from miho.identification.refit import AT_BOUND, Refit, refit
from miho.identification.stated import reported_space, reported_uncertainty
from miho.identification.uncertainty import Linearised, linearised
from miho.optim.trace import Minimum, in_place
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

MOST_VALUES = 3
"""A sentence lists up to this number of values of a parameter, else their range."""
MOST_FACTORS = 5
"""Largest number of parameters whose products are tried, with 3^5 combinations of exponents."""
GENEROUS = 10.0
"""Minima are examined if their excess of squares is at most this multiple of the excess that an
interval of independent rows allows: dependent rows widen intervals about 3 times."""
UNFINISHED = 2.0
"""A descent starts at minima whose excess is at most this multiple of the allowed excess, because a
search ends slightly above its minima."""
REPEATED = 0.1
"""Optima closer than this number of standard errors count as one: their intervals are the same."""
SAME_CURVE = 1e-8
"""Optima give the same curve if their residuals differ by less than this share of the sum of
squares; descents leave 1e-10. A symmetry of the model repeats such an optimum."""


def optima_within_noise(
    problem: CurveFit,
    optimum: Refit,
    minima: Sequence[Minimum],
    level: float = 0.95,
    deadline: Deadline | None = None,
) -> tuple[Refit, ...]:
    """The distinct optima that are as good as the best within the noise, the best first.

    The sum of squares of these optima exceeds the smallest one by no more than a profile interval
    of this `level` allows. Optima that give the same curve count once.

    A new descent from each of the `minima`, the ends of a search, that may be within the noise
    leads to its optimum, which replaces the best one if it is better. No minimum is examined after
    the deadline. The result is `optimum` alone if the data number events or have no noise, because
    there is no likelihood ratio then.
    """
    count, known = problem.residual_count, [_Known(problem, optimum)]
    highest = _loosely(problem, optimum, level)
    near = [m for m in sorted(minima) if m.loss * count <= highest]
    near = [m for m in near if not known[0].is_at(np.array(m.theta))]
    if not near or optimum.cost <= problem.resolution * count:
        return (optimum,)
    try:
        at = linearised(problem, optimum.theta, neighbours=True)
    except ValueError:
        return (optimum,)
    if at.events:
        return (optimum,)
    allowed = excess(problem, at, level)
    for minimum in near:
        theta, above = np.array(minimum.theta), minimum.loss * count - optimum.cost
        if above > UNFINISHED * allowed or (deadline is not None and deadline.over):
            break
        if any(each.is_at(theta) for each in known):
            continue
        fit = refit(problem, theta, deadline=deadline)
        other = _Known(problem, fit)
        if (
            not any(each.gives(fit.theta) for each in known)
            and fit.cost <= optimum.cost + allowed
            and np.isfinite(other.slopes).all()
        ):
            known.append(other)
    fits = sorted((each.fit for each in known), key=lambda fit: fit.cost)
    return tuple(fit for fit in fits if fit.cost <= fits[0].cost + allowed)


class _Known:
    """A known optimum, with derivatives that are computed on demand."""

    def __init__(self, problem: CurveFit, fit: Refit) -> None:
        self.fit, self._problem = fit, problem

    @cached_property
    def slopes(self) -> Array:
        """Derivatives (m, d) of the residuals."""
        return self._problem.jacobian(self.fit.theta)

    def is_at(self, theta: Array) -> bool:
        """Whether parameters (d,) are within REPEATED standard errors of the optimum."""
        if in_place(theta, self.fit.theta):
            return True
        step = self.slopes @ (theta - self.fit.theta)
        return bool(step @ step <= REPEATED**2 * _roughly(self._problem, self.fit)[0])

    def gives(self, theta: Array) -> bool:
        """Whether parameters (d,) are this optimum, or have the same residuals."""
        if self.is_at(theta):
            return True
        change = self._problem.residuals(theta) - self._problem.residuals(self.fit.theta)
        return bool(change @ change <= SAME_CURVE * self.fit.cost)


def error_variance(problem: CurveFit, at: Linearised) -> float:
    """The variance of the errors in a likelihood ratio: cost / freedom for the square loss."""
    if at.noise_known or problem.prior is not None:
        return at.noise**2
    psi, stiffness = problem.rho.influence(problem.errors(at.theta))
    return float(psi @ psi / at.independent.freedom / stiffness.mean())


def excess(problem: CurveFit, at: Linearised, level: float) -> float:
    """The largest excess of the sum of squares, over the smallest, within intervals of a level.

    If rows depend on each other, the parameter with the widest interval decides.
    """
    reach = at.quantile(level)
    if at.dependence is not None:
        with np.errstate(invalid="ignore", divide="ignore"):
            wider = at.standard_errors / at.independent.standard_errors
        reach *= max(1.0, float(np.max(wider, initial=1.0, where=np.isfinite(wider))))
    return reach**2 * error_variance(problem, at)


def _roughly(problem: CurveFit, optimum: Refit) -> tuple[float, int]:
    """The variance of the errors and its degrees of freedom, without derivatives."""
    freedom = max(len(problem.dataset) - len(problem.space), 1)
    if problem.noise_known and problem.scale is not None:
        return problem.scale**2, freedom
    return optimum.cost / freedom, freedom


def _loosely(problem: CurveFit, optimum: Refit, level: float) -> float:
    """The largest sum of squares of a minimum that may belong to an optimum within the noise."""
    variance, freedom = _roughly(problem, optimum)
    reach = float(scipy.special.stdtrit(freedom, (1 + level) / 2))
    return optimum.cost + GENEROUS * reach**2 * variance


def minima_at(problem: CurveFit, optima: Sequence[Linearised]) -> tuple[Minimum, ...]:
    """These optima as minima with their losses."""
    losses = [float(problem.loss(at.theta[None])[0]) for at in optima]
    thetas = [tuple(at.theta.tolist()) for at in optima]
    return tuple(Minimum(*each) for each in zip(losses, thetas, strict=True))


def hull(values: Sequence[Array], intervals: Sequence[Array]) -> Array:
    """The smallest intervals (q, 2) that contain the intervals of several optima, (q, 2) each.

    An optimum without an interval, for example at a bound, adds its entry of `values`, (q,) each.
    The result is NaN if no optimum has an interval.
    """
    ends, points = np.array(intervals), np.array(values)
    low, high = np.fmin.reduce(ends[:, :, 0]), np.fmax.reduce(ends[:, :, 1])
    unknown = np.isnan(low)
    low, high = np.fmin(low, points.min(axis=0)), np.fmax(high, points.max(axis=0))
    return np.where(unknown[:, None], np.nan, np.stack([low, high], axis=1))


def optima_table(problem: CurveFit, optima: Sequence[Linearised]) -> pd.DataFrame:
    """A row per optimum, the best first; no row for a single optimum.

    Columns: `optimum` (from 1), `excess` (the sum of squares minus its value at the best optimum,
    over the error variance), the parameters, and the derived quantities of the model.
    """
    import pandas as pd

    if len(optima) < 2:
        return pd.DataFrame()
    values, _ = _compared(problem, optima)
    rows = {"optimum": np.arange(len(optima)) + 1, "excess": _excesses(problem, optima)}
    return pd.DataFrame(rows | values)


def several_values(problem: CurveFit, optima: Sequence[Linearised]) -> list[str]:
    """Sentences on optima that the data cannot distinguish; empty for a single optimum.

    They name the parameters whose values differ by more than a standard error, and the quantities
    that all optima have in common: derived quantities of the model, else the shortest product of
    these parameters.
    """
    if len(optima) < 2:
        return []
    from miho.identification.derived import derived

    values, errors = _compared(problem, optima)
    space = reported_space(problem.space)
    parameters = space.names
    at_bound = {p.name: AT_BOUND * (p.high - p.low) for p in space.parameters}
    several = {
        name: v for name, v in values.items() if np.ptp(v) > (errors[name] or at_bound.get(name, 0))
    }
    listed = "; ".join(
        f"{name} is {_listed(several[name])}" for name in parameters if name in several
    )
    excess = _excesses(problem, optima)[1:].max()
    listed = listed or "they agree in all that the data determine"
    sentences = [
        f"{len(optima)} optima differ by less than the noise (chi-squared by {excess:.2g} at "
        f"most), so the data cannot distinguish them: {listed}. Each interval covers all optima, "
        "including values between them that may not fit; standard errors hold for the first "
        "optimum only."
    ]
    units = {quantity.name: quantity.unit for quantity in derived(problem.model, problem.dataset)}
    shared = [
        f"{name}: {with_unit(f'{_listed(values[name])} ± {errors[name]:.2g}', units[name])}"
        for name in values
        if name not in parameters and name not in several and 0 < errors[name] < np.inf
    ]
    shared = shared or _shared_product(problem, optima, several)
    if shared:
        sentences.append(
            f"the optima agree within a standard error on {'; '.join(shared)}. Trust this more "
            "than the single parameters."
        )
    return sentences


def _listed(values: Array) -> str:
    """The distinct values as text, or their range if there are many."""
    texts = list(dict.fromkeys(f"{value:.4g}" for value in values))
    if len(texts) <= MOST_VALUES:
        return " or ".join(texts)
    return f"{values.min():.4g} to {values.max():.4g}"


def _compared(
    problem: CurveFit, optima: Sequence[Linearised]
) -> tuple[dict[str, Array], dict[str, float]]:
    """Values (k,) of parameters and derived quantities at k optima, and least standard errors.

    An error is 0 if no optimum has one, for example at a bound, and infinite if the data determine
    the quantity at no optimum.
    """
    from miho.identification.derived import delta_method, derived

    each = [reported_uncertainty(problem, at) for at in optima]
    names = reported_space(problem.space).names
    values = dict(zip(names, np.array([at.theta for at in each]).T, strict=True))
    spread = dict(zip(names, np.array([at.standard_errors for at in each]).T, strict=True))
    for quantity in derived(problem.model, problem.dataset):
        pairs = np.array([delta_method(quantity, at) for at in optima])
        if np.isfinite(pairs[:, 0]).all():
            values[quantity.name], spread[quantity.name] = pairs.T
    return values, {name: float(min(e[e > 0], default=0.0)) for name, e in spread.items()}


def _shared_product(
    problem: CurveFit, optima: Sequence[Linearised], several: Collection[str]
) -> list[str]:
    """The shortest product of parameters with the same value at all optima, as name and values.

    Exponents are 1 and -1. Empty if no product of two or more parameters agrees within a standard
    error.
    """
    each = [reported_uncertainty(problem, at) for at in optima]
    values, names = np.array([at.theta for at in each]), reported_space(problem.space).names
    same_sign = np.abs(np.sign(values).sum(axis=0)) == len(values)
    places = [k for k, name in enumerate(names) if name in several and same_sign[k]][:MOST_FACTORS]
    logarithms = np.log(np.abs(values[:, places]))
    best: tuple[int, float, float, Array] | None = None
    for exponents in product((1, 0, -1), repeat=len(places)):
        powers = np.array(exponents)
        factors, difference = int(np.count_nonzero(powers)), float(np.ptp(logarithms @ powers))
        if factors < 2 or powers[powers != 0][0] < 0:
            continue
        slopes = np.zeros_like(values)
        slopes[:, places] = powers / values[:, places]
        spreads = [at.spread(slope[None])[0] for at, slope in zip(each, slopes, strict=True)]
        error = float(min(spreads))
        if difference <= error < np.inf and (best is None or (factors, difference) < best[:2]):
            best = factors, difference, error, powers
    if best is None:
        return []
    _, _, error, powers = best
    chosen = [names[k] for k, e in zip(places, powers, strict=True) if e > 0]
    below = [names[k] for k, e in zip(places, powers, strict=True) if e < 0]
    products = np.prod(values[:, places] ** powers, axis=1)
    label = " ".join(chosen) + "".join(f" / {name}" for name in below)
    return [f"{label} = {_listed(products)} ± {error * abs(products[0]):.2g}"]


def _excesses(problem: CurveFit, optima: Sequence[Linearised]) -> Array:
    """Chi-squared (k,) minus its value at the first optimum."""
    costs = np.array([float(np.sum(problem.residuals(at.theta) ** 2)) for at in optima])
    return np.asarray((costs - costs[0]) / error_variance(problem, optima[0]))
