"""Optima that the data cannot tell apart: together they are one uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.identification.derived import delta_method, derived
from miho.identification.refit import Deadline, Refit, refit
from miho.identification.stated import reported_space, reported_uncertainty
from miho.identification.uncertainty import AT_BOUND, Linearised, linearised
from miho.optim import Minimum
from miho.optim.trace import SAME_PLACE
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

GENEROUS = 10.0
"""Dependent rows widen intervals some 3 times: minima up to so many times further above the best as
an interval of independent rows allows are worth the derivatives that tell."""
UNFINISHED = 2.0
"""A search ends a little above its minima: those up to so many times too far above the best are
descended from."""
REPEATED = 0.1
"""Optima this close, in standard errors, are one: their intervals are the same."""
SAME_CURVE = 1e-8
"""Optima whose residuals differ by less than this share of their sum of squares give the same
curve: a descent leaves 1e-10. They are one optimum that a symmetry of the model repeats."""
MOST_VALUES = 3
"""Values of a parameter that a sentence lists; of more it gives the range."""
MOST_FACTORS = 5
"""Parameters at most whose products are tried, of 3^5 exponents."""


def optima_within_noise(
    problem: CurveFit,
    optimum: Refit,
    minima: Sequence[Minimum],
    level: float = 0.95,
    deadline: Deadline | None = None,
) -> tuple[Refit, ...]:
    """The different optima that are as good as the best within the noise, the best first.

    Those are the optima whose sum of squares exceeds the smallest by no more than a profile
    interval of this `level` allows. Optima that give the same curve count once.

    Parameters
    ----------
    problem : CurveFit
        The problem.
    optimum : Refit
        The best optimum so far, where a descent has ended.
    minima : sequence of Minimum
        Where the descents of a search ended. A descent from each that may be within the noise leads
        to its optimum, which takes the place of the best one where it is better.
    level : float
        The level of the intervals.
    deadline : Deadline, optional
        After it no further minimum is looked at.

    Returns
    -------
    tuple of Refit
        At least one. Only the best where the data number events or have no noise, for which there
        is no likelihood ratio.
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
        new = not any(each.is_at(fit.theta) or each.has_curve_of(fit.theta) for each in known)
        other = _Known(problem, fit)
        if new and fit.cost <= optimum.cost + allowed and other.has_derivatives:
            known.append(other)
    fits = sorted((each.fit for each in known), key=lambda fit: fit.cost)
    return tuple(fit for fit in fits if fit.cost <= fits[0].cost + allowed)


def minima_at(problem: CurveFit, optima: Sequence[Linearised]) -> tuple[Minimum, ...]:
    """Where these optima are, with their losses."""
    losses = [float(problem.loss(at.theta[None])[0]) for at in optima]
    thetas = [tuple(at.theta.tolist()) for at in optima]
    return tuple(Minimum(*each) for each in zip(losses, thetas, strict=True))


class _Known:
    """A known optimum, with its derivatives as soon as they are needed."""

    def __init__(self, problem: CurveFit, fit: Refit) -> None:
        self.fit, self._problem = fit, problem

    @cached_property
    def _slopes(self) -> Array:
        return self._problem.jacobian(self.fit.theta)

    @property
    def has_derivatives(self) -> bool:
        """Whether all derivatives are finite, so that it has standard errors."""
        return bool(np.isfinite(self._slopes).all())

    def is_at(self, theta: Array) -> bool:
        """Whether parameters (d,) are within REPEATED standard errors of it."""
        if np.allclose(theta, self.fit.theta, rtol=SAME_PLACE, atol=0):
            return True
        step = self._slopes @ (theta - self.fit.theta)
        return bool(step @ step <= REPEATED**2 * _roughly(self._problem, self.fit)[0])

    def has_curve_of(self, theta: Array) -> bool:
        """Whether its residuals are those at parameters (d,)."""
        change = self._problem.residuals(theta) - self._problem.residuals(self.fit.theta)
        return bool(change @ change <= SAME_CURVE * self.fit.cost)


def error_variance(problem: CurveFit, at: Linearised) -> float:
    """The variance of the errors in a likelihood ratio: cost / freedom for the square loss."""
    if at.noise_known or problem.prior is not None:
        return at.noise**2
    psi, stiffness = problem.rho.influence(problem.errors(at.theta))
    return float(psi @ psi / at.independent.freedom / stiffness.mean())


def excess(problem: CurveFit, at: Linearised, level: float) -> float:
    """By how much a sum of squares may exceed the smallest within the intervals of a level.

    Where rows depend on each other, for the parameter that this widens most.
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
    if problem.scale is not None and problem.sigma_known:
        return problem.scale**2, freedom
    return optimum.cost / freedom, freedom


def _loosely(problem: CurveFit, optimum: Refit, level: float) -> float:
    """The sum of squares up to which a search's minimum may belong to an optimum within noise."""
    variance, freedom = _roughly(problem, optimum)
    reach = float(scipy.special.stdtrit(freedom, (1 + level) / 2))
    return optimum.cost + GENEROUS * reach**2 * variance


def hull(values: Sequence[Array], intervals: Sequence[Array]) -> Array:
    """The smallest intervals (q, 2) that contain the intervals of several optima, (q, 2) each.

    An optimum without an interval of a quantity, as at a bound, adds its own of the `values`, (q,)
    each; NaN where none has an interval.
    """
    ends, points = np.array(intervals), np.array(values)
    low, high = np.fmin.reduce(ends[:, :, 0]), np.fmax.reduce(ends[:, :, 1])
    unknown = np.isnan(low)
    low, high = np.fmin(low, points.min(axis=0)), np.fmax(high, points.max(axis=0))
    return np.where(unknown[:, None], np.nan, np.stack([low, high], axis=1))


def optima_table(problem: CurveFit, optima: Sequence[Linearised]) -> pd.DataFrame:
    """A row per optimum, the best first; no row where there is only one.

    Columns: `optimum` (from 1), `excess` (by how much chi-squared exceeds the best one's, in units
    of the errors' variance), the parameters, and the derived quantities of the model.
    """
    import pandas as pd

    if len(optima) < 2:
        return pd.DataFrame()
    values, _ = _compared(problem, optima)
    rows = {"optimum": np.arange(len(optima)) + 1, "excess": _excesses(problem, optima)}
    return pd.DataFrame(rows | values)


def several_values(problem: CurveFit, optima: Sequence[Linearised]) -> list[str]:
    """Sentences on the optima that the data cannot tell apart; none where there is only one.

    They name the parameters whose values differ by more than a standard error, none that the data
    determine nowhere, and what the optima share: quantities that the model declares, else the
    shortest product of these parameters.
    """
    if len(optima) < 2:
        return []
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
    shared = [
        f"{name} = {_listed(values[name])} ± {errors[name]:.2g}"
        for name in values
        if name not in parameters and name not in several and 0 < errors[name] < np.inf
    ]
    shared = shared or _shared_product(problem, optima, several)
    if shared:
        sentences.append(
            f"the optima agree within a standard error on {', '.join(shared)}. Trust this more "
            "than the single parameters."
        )
    return sentences


def _listed(values: Array) -> str:
    """Values in words: once if they are alike, the range if they are many."""
    texts = list(dict.fromkeys(f"{value:.4g}" for value in values))
    if len(texts) <= MOST_VALUES:
        return " or ".join(texts)
    return f"{values.min():.4g} to {values.max():.4g}"


def _compared(
    problem: CurveFit, optima: Sequence[Linearised]
) -> tuple[dict[str, Array], dict[str, float]]:
    """The values (k,) of parameters and derived quantities at k optima, and their least error.

    The error is 0 where no optimum has one, as at a bound, and infinite where none determines it.
    """
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
    """The name and the values of the shortest product of parameters that the optima share.

    Exponents are 1 and -1. Empty where no product of two or more stays within a standard error.
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
    """By how much chi-squared (k,) exceeds that of the first."""
    costs = np.array([float(np.sum(problem.residuals(at.theta) ** 2)) for at in optima])
    return np.asarray((costs - costs[0]) / error_variance(problem, optima[0]))
