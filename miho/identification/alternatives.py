"""Optima that the data cannot distinguish: together they make up the uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.identification.stated import reported_space, reported_uncertainty
from miho.identification.uncertainty import AT_BOUND, Linearised
from miho.identification.within_noise import error_variance
from miho.optim.trace import Minimum
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

MOST_VALUES = 3
"""A sentence lists up to this number of values of a parameter, else their range."""
MOST_FACTORS = 5
"""Largest number of parameters whose products are tried, with 3^5 combinations of exponents."""


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
