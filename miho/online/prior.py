"""What is known before the first row: a report of a fit, values by name, or the bounds alone."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from miho.identification.report import Report
from miho.online.outputs import System
from miho.optim.space import Parameter
from miho.quantities import Array

UNIFORM = 1 / math.sqrt(12)
"""Standard deviation of a uniform distribution, as a share of its width."""


def start_of(
    system: System, prior: Report | Mapping[str, tuple[float, float]] | None
) -> tuple[Array, Array]:
    """Return the estimate (d,) and its covariance (d, d) before the first row.

    Without a prior, and for names that a mapping lacks, a parameter starts from the prior of its
    `Parameter`, or from the middle of its bounds. Raises ValueError if the prior has an unknown
    parameter, or not a value and a standard deviation above 0.
    """
    each = [_of_bounds(parameter) for parameter in system.space.parameters]
    theta, deviations = (np.array(column, dtype=float) for column in zip(*each, strict=True))
    covariance = np.diag(deviations**2)
    if isinstance(prior, Report):
        return _of_report(system, prior, theta, covariance)
    if prior is None:
        return theta, covariance
    if not isinstance(prior, Mapping):
        raise ValueError(
            f"prior is a {type(prior).__name__}; expected a report, or value and standard "
            "deviation by name"
        )
    for name, pair in prior.items():
        k = place_of("prior", name, system.reported.names)
        if name != system.names[k]:
            raise ValueError(f"prior: {name} has a constraint; expected a fit as the prior")
        value, deviation = _pair(name, pair)
        theta[k], covariance[k, k] = value, deviation**2
    return np.clip(theta, system.space.low, system.space.high), covariance


def place_of(field: str, name: str, names: tuple[str, ...]) -> int:
    """Return the position of a parameter; raises ValueError with the known ones."""
    if name not in names:
        raise ValueError(f"{field}: no parameter {name!r}; expected one of {', '.join(names)}")
    return names.index(name)


def _of_bounds(parameter: Parameter) -> tuple[float, float]:
    """Value and standard deviation from the prior of a parameter, or from its bounds."""
    low, high = parameter.low, parameter.high
    if parameter.scale == "log":
        value, deviation = parameter.prior or (
            math.sqrt(low * high), UNIFORM * math.log(high / low),
        )  # fmt: skip
        return value, min(value * deviation, UNIFORM * (high - low))
    return parameter.prior or ((low + high) / 2, UNIFORM * (high - low))


def _of_report(
    system: System, report: Report, theta: Array, covariance: Array
) -> tuple[Array, Array]:
    """Estimate and covariance of a report; a parameter that it does not know may be anywhere."""
    names = report.problem.space.names
    missing = [name for name in system.names if name not in names]
    if missing:
        raise ValueError(
            f"prior: the report has no parameter {missing[0]!r}; it has {', '.join(names)}"
        )
    places = [names.index(name) for name in system.names]
    covariance = covariance + np.diag((report.at.theta[places] - theta) ** 2)
    theta = report.at.theta[places]
    errors = report.at.standard_errors[places]
    known = np.isfinite(errors) & (errors > 0)
    both = np.outer(known, known)
    return theta, np.where(both, report.at.covariance[np.ix_(places, places)], covariance)


def _pair(name: str, pair: object) -> tuple[float, float]:
    try:
        value, deviation = (float(number) for number in pair)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        value = deviation = math.nan
    if not (math.isfinite(value) and 0 < deviation < math.inf):
        raise ValueError(
            f"prior: {name} is {pair!r}; expected a value and a standard deviation above 0"
        )
    return value, deviation
