"""The content of `parameters.json`: an identified model, from a report or from its optimum."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.identification.refit import refit
from miho.identification.stated import stated_intervals, stated_parameters
from miho.identification.uncertainty import Linearised, linearised
from miho.models.identified import Identified, Value
from miho.models.model import Model
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

    from miho.identification.report import Report

KINDS = ("profile", "bootstrap", "linearised")
"""Kinds of intervals, the best first."""


def interval_kind(table: pd.DataFrame) -> str:
    """The best kind of interval in a table of a report; empty if there is none."""
    return next((kind for kind in KINDS if f"{kind} low" in table.columns), "")


def identified(report: Report, origin: Mapping[str, Any]) -> Identified:
    """The content of `parameters.json` from a report.

    Parameters
    ----------
    report : Report
        The report on the identified model.
    origin : mapping of str
        The provenance of the run: all that is needed to repeat it.

    Returns
    -------
    Identified
        The model with values, intervals, correlation, ranges of the data, derived quantities and
        provenance.
    """
    kind = interval_kind(report.parameters)
    values = {row["parameter"]: _value(row, kind) for row in report.parameters.to_dict("records")}
    model, values, correlation = _whole(report.problem, report.at, values, report.level)
    for name in values.keys() & report.tied_profiles.keys():
        curve = report.tied_profiles[name]
        values[name] = replace(values[name], low=curve.low, high=curve.high)
    return Identified(
        model=model,
        parameters=values,
        correlation=correlation,
        ranges=_ranges(report.problem),
        derived={
            row["quantity"]: _value(row, "linearised")
            for row in report.derived.to_dict("records")
            if math.isfinite(row["value"])
        },
        provenance={
            "error": report.error,
            "residual_standard_deviation": report.residual_standard_deviation,
            "degrees_of_freedom": report.freedom,
            "optimum": report.conclusion.statement,
            **origin,
            "interval": kind,
        },
        level=report.level,
    )


def identified_at(problem: CurveFit, theta: Array) -> Identified:
    """The model at `theta` (d,), without a report, with linearised intervals of the nearby optimum.

    Standard errors are NaN if there are no intervals, for example with fewer rows than parameters.
    """
    size = len(theta)
    errors, ends, at = np.full(size, math.nan), np.full((size, 2), math.nan), None
    with contextlib.suppress(ValueError):
        at = linearised(problem, refit(problem, theta).theta)
        errors, ends = at.standard_errors, at.intervals()
    parameters = {
        p.name: Value(float(theta[i]), p.unit, float(errors[i]), *map(float, ends[i]))
        for i, p in enumerate(problem.space.parameters)
    }
    model, correlation = problem.model, np.eye(size)
    if at is not None:
        model, parameters, correlation = _whole(problem, at, parameters)
    loss = float(problem.loss(theta[None])[0])
    about = {"problem": problem.name, "data": problem.dataset.digest, "error": math.sqrt(loss)}
    return Identified(model, parameters, correlation, _ranges(problem), {}, about)


def _whole(
    problem: CurveFit, at: Linearised, free: Mapping[str, Value], level: float = 0.95
) -> tuple[Model, dict[str, Value], Array]:
    """The model of all parameters, their values from values of the free ones, and correlations.

    Tied parameters get linearised intervals; fixed parameters have standard error 0.
    """
    model = problem.model.whole
    if model is problem.model:
        return model, dict(free), at.correlation
    stated, slopes = stated_parameters(problem, at)
    stated, slopes = stated[: len(model.parameters)], slopes[: len(model.parameters)]
    ends = stated_intervals(stated, slopes, at, level).tolist()
    values = {
        p.name: free.get(p.name)
        or Value(p.value, model.parameters[p.name], p.standard_error, *interval)
        for p, interval in zip(stated, ends, strict=True)
    }
    covariance = slopes @ at.covariance @ slopes.T
    errors = np.sqrt(np.diag(covariance))
    usable = np.where(errors > 0, errors, np.nan)
    return model, values, np.asarray(covariance / np.outer(usable, usable))


def _ranges(problem: CurveFit) -> dict[str, tuple[float, float]]:
    """The range of each input of the model in the data."""
    return {
        name: (float(problem.dataset[name].min()), float(problem.dataset[name].max()))
        for name in problem.model.inputs
    }


def _value(row: Mapping[Any, Any], kind: str) -> Value:
    ends = row[f"{kind} low"], row[f"{kind} high"]
    return Value(row["value"], row["unit"], row["standard error"], *ends)
