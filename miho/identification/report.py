"""The report of an identification: the optimum, its uncertainty, and remarks on both."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pandas as pd

from miho.identification.alternatives import hull, optima_table
from miho.identification.bootstrap import percentile_intervals, percentiles
from miho.identification.conclusion import Conclusion
from miho.identification.curve_fit import CurveFit
from miho.identification.derived import delta_method, derived, gradient, interval_of
from miho.identification.flags import REMEDY, spread_is_uneven
from miho.identification.irreducible import Irreducible, irreducible_of
from miho.identification.line_wrapping import with_unit
from miho.identification.prior import prior_table
from miho.identification.profile_likelihood import Profile
from miho.identification.stated import (
    reported_slopes,
    reported_space,
    reported_uncertainty,
    reported_values,
)
from miho.identification.uncertainty import Linearised
from miho.identification.validation import BINS, error_on, levels, residual_trends, root_mean_square
from miho.models.derived import Derived
from miho.optim import Descents, Space, in_optimum
from miho.quantities import Array

ROUNDING = 1e-12
"""Errors below this fraction of the output are rounding, not noise."""


@dataclass(frozen=True, eq=False)
class Report:
    """The results of one identification; every table is a function of these fields.

    A report describes one optimum, the end of a descent from the result of the run. `make_report`
    makes it. `print(report)` shows the parameters, the error and all remarks.

    Parameters
    ----------
    problem : CurveFit
        The identified problem.
    run : ndarray of shape (d,)
        The final parameters of the run.
    at : Linearised
        The optimum and its uncertainty.
    conclusion : Conclusion
        The evidence that the optimum is the best one, or the reason to doubt it.
    profiles : tuple of Profile or None
        A profile likelihood per parameter; None if there is none.
    replicates : ndarray of shape (n, d), optional
        Estimates of the bootstrap.
    left_out : DataFrame
        Errors on groups of rows, each from a fit without the group.
    level : float
        Confidence level of all intervals, between 0 and 1.
    omitted : tuple of str
        Sentences on results that the time limit excluded.
    remedy : str
        Advice if the optimum is in doubt.
    searches : tuple of Descents
        The descents of the run, and of a check of the run.
    best_known : float, optional
        Loss of the best optimum, if linear algebra or a record knows it.
    tied_profiles : mapping of str to Profile
        Profile likelihoods of tied parameters by name.
    moving : int
        Evaluations after which the descent to the optimum was still improving; 0 if it converged.
    found_by : str
        The step after the search that found this optimum; empty if the search found it.
    others : tuple of Linearised
        Further optima that the data cannot distinguish from `at`, with their uncertainties. All
        intervals cover them.
    """

    problem: CurveFit
    run: Array
    at: Linearised
    conclusion: Conclusion
    profiles: tuple[Profile | None, ...]
    replicates: Array | None
    left_out: pd.DataFrame
    level: float
    omitted: tuple[str, ...] = ()
    remedy: str = REMEDY
    searches: tuple[Descents, ...] = ()
    best_known: float | None = None
    tied_profiles: Mapping[str, Profile] = field(default_factory=dict)
    moving: int = 0
    found_by: str = ""
    others: tuple[Linearised, ...] = ()

    @cached_property
    def space(self) -> Space:
        """The reported parameters: constrained parameters replace the free shares in them."""
        return reported_space(self.problem.space)

    @cached_property
    def reported(self) -> Linearised:
        """The uncertainty of the reported parameters."""
        return reported_uncertainty(self.problem, self.at)

    @cached_property
    def optima(self) -> pd.DataFrame:
        """A row per optimum that the data cannot distinguish; no row for a single optimum.

        Columns: optimum (from 1), excess (chi-squared minus its value at the best optimum),
        parameters and derived quantities.
        """
        return optima_table(self.problem, (self.at, *self.others))

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """A row per parameter: value, unit, standard errors, the value of the run, intervals."""
        at = self.reported
        frame = pd.DataFrame(
            {
                "parameter": self.space.names,
                "value": at.theta,
                "unit": [p.unit for p in self.space.parameters],
                "standard error": at.standard_errors,
                "sandwich": at.by_sandwich.standard_errors,
                "of the run": reported_values(self.problem, self.run[None])[0],
            }
        )
        optima = [at, *(reported_uncertainty(self.problem, other) for other in self.others)]
        values = [each.theta for each in optima]
        ends = {
            "linearised": hull(values, [each.intervals(self.level) for each in optima]),
            "sandwich": hull(values, [each.by_sandwich.intervals(self.level) for each in optima]),
        }
        if any(self.profiles):
            no_interval = (math.nan, math.nan)
            ends["profile"] = np.array(
                [(p.low, p.high) if p else no_interval for p in self.profiles]
            )
        if self.replicates is not None:
            replicates = reported_values(self.problem, self.replicates)
            slopes = reported_slopes(self.problem, self.at.theta)
            ends["bootstrap"] = self._percentiles(replicates, slopes)
        for name, interval in ends.items():
            frame[f"{name} low"], frame[f"{name} high"] = interval.T
        return frame

    @cached_property
    def correlation(self) -> pd.DataFrame:
        """Correlation matrix of the estimates, with parameter names on both axes."""
        names = list(self.space.names)
        return pd.DataFrame(self.reported.correlation, index=names, columns=names)

    @property
    def quantities(self) -> tuple[Derived, ...]:
        """The derived quantities of the model, and its fixed and tied parameters."""
        return derived(self.problem.model, self.problem.dataset)

    @cached_property
    def derived(self) -> pd.DataFrame:
        """A row per derived quantity: value, unit, standard error and intervals."""
        rows = []
        for quantity in self.quantities:
            if quantity.tied in self.space.names:  # listed among the parameters
                continue
            value, error = delta_method(quantity, self.at)
            slope = gradient(quantity, self.at)[None]
            row: dict[str, Any] = {
                "quantity": quantity.name,
                "value": value,
                "unit": quantity.unit,
                "standard error": error,
                "sandwich": delta_method(quantity, self.at.by_sandwich)[1],
            }
            optima = (self.at, *self.others)
            values = [quantity.evaluate(optimum.theta[None]) for optimum in optima]
            robust = [optimum.by_sandwich for optimum in optima]
            by_kind = {"linearised": optima, "sandwich": robust}
            for kind, each in by_kind.items():
                intervals = [interval_of(quantity, optimum, self.level) for optimum in each]
                row[f"{kind} low"], row[f"{kind} high"] = hull(values, intervals)[0]
            if quantity.tied in self.tied_profiles:
                profile = self.tied_profiles[quantity.tied]
                row |= {"profile low": profile.low, "profile high": profile.high}
            if self.replicates is not None:
                replicates = quantity.evaluate(self.replicates)
                replicates = replicates[np.isfinite(replicates)]
                if replicates.size:
                    interval = self._percentiles(replicates[:, None], slope)[0]
                    row["bootstrap low"], row["bootstrap high"] = interval
            rows.append(row)
        return pd.DataFrame(rows)

    @cached_property
    def priors(self) -> pd.DataFrame:
        """A row per prior: its mean and deviation, and the share of information that it supplies.

        `prior_table` documents the columns.
        """
        return prior_table(self.problem, self.at)

    @cached_property
    def errors(self) -> pd.DataFrame:
        """Root-mean-square errors in the unit of the output.

        Rows: training rows, residual standard deviation, held-out rows, groups of rows left out of
        the fit, and the irreducible error with its interval from `low` to `high`.
        """
        problem, dataset = self.problem, self.problem.dataset
        rows: list[tuple[str, int, float, float, float]] = []

        def add(label: str, count: int, error: float) -> None:
            rows.append((label, count, error, math.nan, math.nan))

        add("training", len(dataset), self.error)
        add(
            f"residual standard deviation, {self.freedom} degrees of freedom",
            len(dataset),
            self.residual_standard_deviation,
        )
        if dataset.held_out is not None:
            held_out = dataset.held_out
            add("held out", len(held_out), error_on(problem, self.at.theta, held_out))
        for name in dict.fromkeys(self.left_out.get("condition", [])):
            part = self.left_out[self.left_out["condition"] == name]
            mean_square = np.average(part["error when left out"] ** 2, weights=part["rows"])
            group = "a fifth" if len(part) == BINS and not levels(dataset[name]) else "one level"
            add(f"leave {group} of {name} out", int(part["rows"].sum()), math.sqrt(mean_square))
        if math.isfinite(self.irreducible.value):
            rows.append(("irreducible, about", len(dataset), *self.irreducible))
        columns = ["on", "rows", "error", "low", "high"]
        return pd.DataFrame(rows, columns=columns).assign(unit=problem.unit)

    @cached_property
    def search(self) -> Descents:
        """All descents of the run and of its check together."""
        return Descents.together(self.searches)

    @cached_property
    def descents(self) -> pd.DataFrame:
        """A row per finished descent, the best first.

        Columns: descent (from 1), error (root of the loss, in the unit of the output), and whether
        the descent ended in the reported optimum. `Descents` keeps only the best of very many.
        """
        problem = self.problem
        ends = self.search.ends
        loss = float(problem.loss(self.at.theta[None])[0])
        ended_here = ["yes" if in_optimum(loss, end, problem.resolution) else "no" for end in ends]
        numbers = np.arange(len(ends)) + 1
        return pd.DataFrame({"descent": numbers, "error": np.sqrt(ends), "ended here": ended_here})

    @cached_property
    def error(self) -> float:
        """Root-mean-square error of the optimum on the training rows, in the unit of the output."""
        return root_mean_square(self.problem.errors(self.at.theta))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residuals: rows minus parameters that are not at a bound."""
        return len(self.problem.dataset) - int((~self.at.at_bound).sum())

    @property
    def residual_standard_deviation(self) -> float:
        """Square root of the sum of squared errors over `freedom`, in the unit of the output."""
        return self.error * math.sqrt(len(self.problem.dataset) / max(self.freedom, 1))

    @cached_property
    def irreducible(self) -> Irreducible:
        """Estimate of the error that no curve in the single input can beat; NaN for more inputs."""
        return irreducible_of(self.problem)

    @cached_property
    def trends(self) -> pd.DataFrame:
        """A row per input and condition: the share of the error variance that it explains."""
        return residual_trends(self.problem, self.at.theta, self.at)

    @cached_property
    def notes(self) -> list[str]:
        """Remarks on the numbers, a sentence each.

        If the optimum is in doubt, they concern the search only, not the data or the model.
        """
        from miho.identification.report_text import notes_of

        return notes_of(self)

    @cached_property
    def uneven(self) -> bool:
        """Whether the spread of the errors changes significantly along the data.

        Sandwich standard errors and intervals allow for that.
        """
        known = self.at.noise > rounding_of(self.problem)
        return known and spread_is_uneven(self.problem, self.at, self.reported)

    def _percentiles(self, replicates: Array, gradients: Array) -> Array:
        """Interval ends (q, 2) from replicates (n, q) of quantities with gradients (q, d)."""
        if self.at.dependence is not None:
            return percentiles(replicates, self.at.quantiles(gradients, self.level))
        units = self.at.events or len(self.problem.dataset)
        return percentile_intervals(replicates, units, self.at.freedom, self.level)

    def band(self, *inputs: Array) -> tuple[Array, Array]:
        """Prediction of the model with the interval of the curve, not of new measurements.

        Parameters
        ----------
        *inputs : ndarray of shape (N,)
            Input columns, in the order and units of the model.

        Returns
        -------
        tuple of ndarray of shape (N,)
            Prediction, and half width of its interval at the level of the report.
        """
        return self.at.band(self.problem.model, self.level, *inputs)

    def __repr__(self) -> str:
        """One line with problem, parameters and error."""
        error = with_unit(f"error {self.error:.5g}", self.problem.unit)
        return f"<Report of {self.problem.name}: {', '.join(self.space.names)}; {error}>"

    def __str__(self) -> str:
        """The parameters with their best intervals, the error, and the remarks."""
        from miho.identification.report_text import text_of

        return text_of(self)

    def _repr_html_(self) -> str:
        """The printed form, for a notebook."""
        return f"<pre>{escape(str(self))}</pre>"

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The tables that have rows, by name."""
        tables = {
            "parameters": self.parameters,
            "optima": self.optima,
            "correlation": self.correlation.rename_axis("parameter").reset_index(),
            "derived": self.derived,
            "priors": self.priors,
            "errors": self.errors,
            "left_out": self.left_out,
            "trends": self.trends,
            "descents": self.descents,
        }
        return {name: table for name, table in tables.items() if len(table)}


def rounding_of(problem: CurveFit) -> float:
    """The largest error, in the unit of the output, that counts as rounding."""
    spread = math.sqrt(problem.variance)
    return max(ROUNDING * spread, math.sqrt(problem.rounding))  # an offset may be far larger


@runtime_checkable
class Reporting(Protocol):
    """A fit, for example of `miho.fit`, which makes its report."""

    def report(self) -> Report:
        """The report of the fit."""


def report_of(result: Report | Reporting) -> Report:
    """A report itself, or the report of a fit; raises ValueError for anything else."""
    if isinstance(result, Report):
        return result
    if not isinstance(result, Reporting):
        raise ValueError(f"expected a fit or its report, got a {type(result).__name__}")
    return result.report()
