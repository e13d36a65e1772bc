"""The report of an identification: the optimum, how far to trust it, and where it holds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from miho.identification.alternatives import hull, optima_table, several_values
from miho.identification.bootstrap import percentile_intervals, percentiles
from miho.identification.curve_fit import CurveFit
from miho.identification.derived import (
    Derived,
    delta_method,
    derived,
    gradient,
    interval_of,
    is_held,
)
from miho.identification.flags import (
    doubtful,
    ended_at_bounds,
    followed,
    held_quantities,
    identifiability,
    independence,
    maybe_zero,
    outliers,
    profile_shapes,
    run_differs,
    sigma_disagrees,
    spread_is_uneven,
    too_few,
    uneven_spread,
    wrong_signs,
)
from miho.identification.irreducible import Irreducible, irreducible_interval
from miho.identification.prior import prior_notes, prior_table
from miho.identification.profile_likelihood import Profile
from miho.identification.standing import Standing
from miho.identification.stated import (
    at_limits,
    reported_slopes,
    reported_space,
    reported_uncertainty,
    reported_values,
)
from miho.identification.uncertainty import Linearised
from miho.identification.validation import (
    BINS,
    error_on,
    levels,
    residual_trends,
    root_mean_square,
)
from miho.optim import Descents, Space, in_optimum
from miho.quantities import Array

HEDGE = (
    "these remarks on data and model hold for this optimum, and may not hold if every search "
    "missed a better one."
)
"""Starts are the best of a screen, so a narrow basin can be missed by all of them."""
BIASED = (
    "with several optima the estimates are biased, so bootstrap intervals, which assume unbiased "
    "estimates, may be too narrow: use the profile intervals."
)
"""Measured: they held the truth in 64 to 98 % where profile intervals did in 96 to 100 %
(`experiments.check.coverage --curvature`)."""
SUSPICIOUS = 2.0
"""An error this many times the upper end of the irreducible one is mentioned."""
ROUNDING = 1e-12
"""Errors below this fraction of the output are rounding, which follows no law and no profile."""
REMEDY = "search from more starts, or in a narrower or logarithmic box."


@dataclass(frozen=True, eq=False)
class Report:
    """The results of one identification; every table is a function of these fields.

    All is of one point, the optimum that a descent from the run's result led to: `at` is its
    uncertainty, `standing` the evidence that it is the best. `others` are the uncertainties of
    further optima that the data cannot tell apart from it, which intervals span. `run` (d,) are the
    run's own parameters. `profiles` are one per parameter (None where there is none),
    `tied_profiles` those of tied ones by name, `replicates` (n, d) the bootstrap's estimates,
    `left_out` the errors on groups of rows that a fit was made without. `omitted` says in sentences
    what there was no time for, `remedy` what to do where the optimum is in doubt. `searches` are
    the descents of the run, and of a check; `best_known` is the loss of the optimum where it is
    known. `moving` and `found_by` are those of `standing_of`.
    """

    problem: CurveFit
    run: Array
    at: Linearised
    standing: Standing
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
        """The parameters that the report is of: those that shares stand for in place of these."""
        return reported_space(self.problem.space)

    @cached_property
    def reported(self) -> Linearised:
        """Their uncertainty."""
        return reported_uncertainty(self.problem, self.at)

    @cached_property
    def optima(self) -> pd.DataFrame:
        """A row per optimum that the data cannot tell apart, no row where there is only one.

        Columns: optimum (from 1), excess (of chi-squared above the best), parameters and derived
        quantities.
        """
        return optima_table(self.problem, (self.at, *self.others))

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """A row per parameter: value, unit, standard error and intervals; the run's own value."""
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
        each = [at, *(reported_uncertainty(self.problem, other) for other in self.others)]
        values = [one.theta for one in each]
        ends = {
            "linearised": hull(values, [one.intervals(self.level) for one in each]),
            "sandwich": hull(values, [one.by_sandwich.intervals(self.level) for one in each]),
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
        """Correlation of the estimates, parameters by parameters."""
        names = list(self.space.names)
        return pd.DataFrame(self.reported.correlation, index=names, columns=names)

    @property
    def _quantities(self) -> tuple[Derived, ...]:
        return derived(self.problem.model, self.problem.dataset)

    @cached_property
    def derived(self) -> pd.DataFrame:
        """A row per derived quantity: value, unit, standard error and intervals."""
        rows = []
        for quantity in self._quantities:
            if quantity.tied in self.space.names:  # which is told of as a parameter
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
            values = [quantity.evaluate(one.theta[None]) for one in optima]
            by_kind = {"linearised": optima, "sandwich": [one.by_sandwich for one in optima]}
            for kind, each in by_kind.items():
                intervals = [interval_of(quantity, one, self.level) for one in each]
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
        """A row per prior: what it says, and how much of what is known it gives."""
        return prior_table(self.problem, self.at)

    @cached_property
    def errors(self) -> pd.DataFrame:
        """Errors in the output's unit, on the training rows, on held-out ones and irreducible.

        Root mean squares; of the irreducible error its interval, `low` to `high`.
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
    def descents(self) -> pd.DataFrame:
        """A row per descent that came to an end, the best first.

        Columns: descent (from 1), error (root of the loss, in the output's unit), and whether it
        ended here, in this optimum. Of very many descents of a run the best only, as `Descents`
        keeps them.
        """
        problem = self.problem
        ends = sorted(end for search in self.searches for end in search.ends)
        loss = float(problem.loss(self.at.theta[None])[0])
        ended_here = ["yes" if in_optimum(loss, end, problem.resolution) else "no" for end in ends]
        numbers = np.arange(len(ends)) + 1
        return pd.DataFrame({"descent": numbers, "error": np.sqrt(ends), "ended here": ended_here})

    @cached_property
    def error(self) -> float:
        """Root-mean-square error of the optimum on its rows, in the output's unit."""
        return root_mean_square(self.problem.errors(self.at.theta))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residuals: rows less parameters that are not at a bound."""
        return len(self.problem.dataset) - int((~self.at.at_bound).sum())

    @property
    def residual_standard_deviation(self) -> float:
        """Root of the sum of squared errors by the degrees of freedom, in the output's unit."""
        return self.error * math.sqrt(len(self.problem.dataset) / self.freedom)

    @cached_property
    def irreducible(self) -> Irreducible:
        """Estimate of the error no curve in the same single input can beat; NaN for more inputs."""
        return irreducible_of(self.problem)

    @cached_property
    def trends(self) -> pd.DataFrame:
        """How much of the errors' variance each input and condition explains, a row for each."""
        return residual_trends(self.problem, self.at.theta, self.at)

    @cached_property
    def notes(self) -> list[str]:
        """Warnings on how to read the numbers, a sentence each; empty if there are none.

        Where the optimum is in doubt they are of the search only, not of data or model.
        """
        before, after = (
            root_mean_square(self.problem.residuals(theta)) for theta in (self.run, self.at.theta)
        )
        run = reported_values(self.problem, self.run[None])[0]
        gain = 1 - after / before if before else 0.0
        sentences = run_differs(run, self.reported, self.space, gain) + self._held_quantities()
        several = several_values(self.problem, (self.at, *self.others))
        if several and self.replicates is not None:
            several.append(BIASED)
        sentences = several + sentences
        if self.standing.doubt:
            doubt = doubtful(self.standing.doubt, self.remedy)
            sentences = doubt + ended_at_bounds(self.reported, self.space) + sentences
        else:
            remarks = self._remarks_on_data_and_model()
            if remarks and not self.standing.certain:
                remarks.append(HEDGE)
            sentences += remarks
        return [*sentences, *self.omitted]

    @cached_property
    def uneven(self) -> bool:
        """Whether the errors' spread changes along the data, beyond chance, and intervals with it.

        The sandwich's standard errors and intervals are those that allow for it.
        """
        known = self.at.noise > rounding_of(self.problem)
        return known and spread_is_uneven(self.problem, self.reported)

    def _held_quantities(self) -> list[str]:
        """A sentence if derived quantities depend only on parameters at a bound."""
        return held_quantities([q.name for q in self._quantities if is_held(q, self.at)])

    def _remarks_on_data_and_model(self) -> list[str]:
        at, space = self.reported, self.space

        # The parameters: whether the data determine them, and how well.
        sentences = identifiability(at, space) + too_few(self.problem)
        if self.at.noise <= rounding_of(self.problem):
            return [*sentences, "every row is reproduced to rounding: the data have no error."]
        sentences += maybe_zero(at, space, self.profiles, self.level)
        ends = self.parameters[["linearised low", "linearised high"]].to_numpy()
        sentences += profile_shapes(ends, space, self.profiles)
        sentences += wrong_signs(self.derived, {q.name: q.sign for q in self._quantities})
        # The errors: whether standard errors may be computed from them as they are.
        sentences += uneven_spread(at, space) if self.uneven else []
        sentences += sigma_disagrees(self.problem, self.at)
        sentences += prior_notes(self.priors)
        sentences += [f"{text}." for text in at_limits(self.problem, self.at.theta)]
        sentences += independence(self.problem, at)
        sentences += outliers(self.problem, self.at)
        # The model: whether it computes well, its errors are larger than noise or follow a column.
        sentences += self.problem.model.remarks(self.at.theta, self.at.noise, *self.problem.inputs)
        error, irreducible = self.error, self.irreducible
        if irreducible.resolved and 0 < SUSPICIOUS * irreducible.high < error:
            sentences.append(
                f"the error is {error / irreducible.value:.1f} times the irreducible error: check "
                "units, signs, ranges and the model."
            )
        return sentences + followed(self.problem, self.trends)

    def _percentiles(self, replicates: Array, gradients: Array) -> Array:
        """Ends (q, 2) for replicates (n, q) of quantities with gradients (q, d)."""
        if self.at.dependence is not None:
            return percentiles(replicates, self.at.quantiles(gradients, self.level))
        units = self.at.events or len(self.problem.dataset)
        return percentile_intervals(replicates, units, self.at.freedom, self.level)

    def band(self, *inputs: Array) -> tuple[Array, Array]:
        """Prediction at input columns (N,) and the half width of its interval, (N,) each.

        The interval is of the curve, not of new measurements.
        """
        model = self.problem.model
        return (
            model.predict(self.at.theta[None], *inputs)[0],
            self.at.reach(model.jacobian(self.at.theta, *inputs), self.level),
        )

    def __repr__(self) -> str:
        """One line: of which problem, with which error."""
        error = f"error {self.error:.5g} {self.problem.unit}".rstrip()
        return f"<Report of {self.problem.name}: {', '.join(self.space.names)}; {error}>"

    def __str__(self) -> str:
        """The parameters with their best intervals, the error, and what the numbers mean."""
        kinds = ("profile", "bootstrap", "linearised")
        kind = next(kind for kind in kinds if f"{kind} low" in self.parameters)
        columns = ["parameter", "value", "unit", "standard error", f"{kind} low", f"{kind} high"]
        formatters = dict.fromkeys(columns[-2:], _end) if kind == "profile" else {}
        if self.uneven and not self.standing.doubt:
            columns += ["sandwich", "sandwich low", "sandwich high"]
        table = self.parameters[columns].to_string(
            index=False, float_format="%.5g", formatters=formatters
        )
        lines = [f"error: {self.error:.5g} {self.problem.unit}".rstrip()]
        if not self.standing.doubt:  # else the notes begin with it
            lines.append(self.standing.statement)
        return "\n\n".join([table, "\n".join([*lines, *(f"- {note}" for note in self.notes)])])

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """All tables by name, those that have rows."""
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


def _end(value: float) -> str:
    """An end of a profile interval, which is open where the profile came to the edge of the box."""
    return "open" if math.isinf(value) else f"{value:.5g}"


def rounding_of(problem: CurveFit) -> float:
    """Errors up to this, in the output's unit, are rounding."""
    return ROUNDING * root_mean_square(problem.dataset[problem.dataset.output])


def irreducible_of(problem: CurveFit) -> Irreducible:
    """Estimate of the error no curve in the same single input can beat.

    NaN for more inputs, and for rows of different weights, whose neighbours do not scatter alike.
    """
    if len(problem.inputs) != 1 or problem.weights is not None:
        return Irreducible(math.nan, math.nan, math.nan)
    return irreducible_interval(problem.inputs[0], problem.dataset[problem.dataset.output])
