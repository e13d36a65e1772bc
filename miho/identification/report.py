"""The report of an identification: what was found, how far to trust it, and where it holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.identification.bootstrap import bootstrap, percentile_intervals
from miho.identification.curve_fit import CurveFit
from miho.identification.derived import delta_method, derived
from miho.identification.flags import (
    convergence,
    identifiability,
    independence,
    outliers,
    profiled,
    spread,
    too_few,
    zeros,
)
from miho.identification.irreducible import irreducible_error
from miho.identification.profile import Profile, profile
from miho.identification.refit import refit
from miho.identification.uncertainty import Linearised, linearised
from miho.identification.validation import (
    BINS,
    conditions,
    error_on,
    leave_one_out,
    levels,
    residual_trends,
    root_mean_square,
)
from miho.optim.seeds import stream

Array = NDArray[np.float64]

MOST_PROFILES = 10
"""Models with more parameters are profiled only if asked: each end costs several refits."""
SUSPICIOUS = 2.0
CHANCE = 1e-3
UNMODELLED = 0.1
"""A column that is no input and explains this fraction of the errors' variance is mentioned."""


@dataclass(frozen=True, eq=False)
class Report:
    """What is known of one identification; every table is a function of these fields.

    `found` (d,) are the run's parameters, `at` the uncertainty at the optimum nearby, `profiles`
    one per parameter (None where there is none), `replicates` (n, d) the bootstrap's estimates,
    `left_out` the errors on groups that a fit has not seen.
    """

    problem: CurveFit
    found: Array
    at: Linearised
    profiles: tuple[Profile | None, ...]
    replicates: Array | None
    left_out: pd.DataFrame
    level: float

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """A row per parameter: value of the run, unit, optimum nearby, its error and intervals."""
        space = self.problem.space
        frame = pd.DataFrame(
            {
                "parameter": space.names,
                "value": self.found,
                "unit": [p.unit for p in space.parameters],
                "optimum nearby": self.at.theta,
                "standard error": self.at.standard_errors,
                "sandwich": np.where(
                    np.isfinite(self.at.standard_errors),
                    np.sqrt(np.diag(self.at.sandwich)),
                    self.at.standard_errors,
                ),
            }
        )
        ends = {"linearised": self.at.intervals(self.level)}
        if any(self.profiles):
            none = (math.nan, math.nan)
            ends["profile"] = np.array([(p.low, p.high) if p else none for p in self.profiles])
        if self.replicates is not None:
            ends["bootstrap"] = self._percentiles(self.replicates)
        for name, interval in ends.items():
            frame[f"{name} low"], frame[f"{name} high"] = interval.T
        return frame

    @cached_property
    def correlation(self) -> pd.DataFrame:
        """Correlation of the estimates, parameters by parameters."""
        names = list(self.problem.space.names)
        return pd.DataFrame(self.at.correlation, index=names, columns=names)

    @cached_property
    def derived(self) -> pd.DataFrame:
        """A row per derived quantity: value, unit, standard error and intervals."""
        rows = []
        for quantity in derived(self.problem.model, self.problem.dataset):
            value, error = delta_method(quantity, self.at)
            reach = self.at.quantile(self.level) * error
            row: dict[str, Any] = {
                "quantity": quantity.name,
                "value": value,
                "unit": quantity.unit,
                "standard error": error,
                "linearised low": value - reach,
                "linearised high": value + reach,
            }
            if self.replicates is not None:
                values = quantity.evaluate(self.replicates)
                values = values[np.isfinite(values)]
                if values.size:
                    interval = self._percentiles(values[:, None])[0]
                    row["bootstrap low"], row["bootstrap high"] = interval
            rows.append(row)
        return pd.DataFrame(rows)

    @cached_property
    def errors(self) -> pd.DataFrame:
        """Root-mean-square errors in the output's unit: training, held out, irreducible."""
        problem, dataset = self.problem, self.problem.dataset
        rows = [("training", len(dataset), self.error)]
        if dataset.held_out is not None:
            held_out = dataset.held_out
            rows.append(("held out", len(held_out), error_on(problem, self.found, held_out)))
        for name in dict.fromkeys(self.left_out.get("condition", [])):
            part = self.left_out[self.left_out["condition"] == name]
            mean_square = np.average(part["error when left out"] ** 2, weights=part["rows"])
            what = "a fifth" if len(part) == BINS and not levels(dataset[name]) else "one level"
            told = f"leave {what} of {name} out"
            rows.append((told, int(part["rows"].sum()), math.sqrt(mean_square)))
        if math.isfinite(self.irreducible):
            rows.append(("irreducible, about", len(dataset), self.irreducible))
        return pd.DataFrame(rows, columns=["on", "rows", "error"]).assign(unit=problem.unit)

    @cached_property
    def error(self) -> float:
        """Root-mean-square error of the run's parameters on their rows, in the output's unit."""
        return root_mean_square(self.problem.errors(self.found))

    @cached_property
    def irreducible(self) -> float:
        """Estimate of the error no curve in the same single input can beat; NaN for more inputs."""
        if len(self.problem.inputs) != 1:
            return math.nan
        dataset = self.problem.dataset
        return irreducible_error(self.problem.inputs[0], dataset[dataset.output])

    @cached_property
    def trends(self) -> pd.DataFrame:
        """What the errors still follow, a row per input and condition."""
        return residual_trends(self.problem, self.found)

    @cached_property
    def notes(self) -> list[str]:
        """What the numbers mean, a sentence each; empty if there is nothing to warn of."""
        space = self.problem.space
        before, after = (root_mean_square(self.problem.residuals(t)) for t in self._points)
        sentences = convergence(self.found, self.at, space, 1 - after / before if before else 0.0)
        sentences += identifiability(self.at, space) + too_few(self.problem)
        sentences += zeros(self.parameters, self.level)
        sentences += profiled(self.at, space, self.profiles, self.level)
        sentences += spread(self.problem, self.at)
        sentences += independence(self.problem, self.at)
        sentences += outliers(self.problem, self.at)
        error = self.error
        if error > SUSPICIOUS * self.irreducible:
            sentences.append(
                f"the error is {error / self.irreducible:.1f} times the irreducible error: check "
                "units, signs, ranges and the model."
            )
        for row in self.trends.to_dict("records"):
            if row["explained"] > UNMODELLED and row["p"] < CHANCE:
                share = f"{100 * row['explained']:.0f} % of the errors' variance follows"
                if row["an input"] == "yes":
                    sentences.append(f"{share} {row['column']}: the model has the wrong shape.")
                else:
                    sentences.append(
                        f"{share} {row['column']}, which is no input of the model: it is not "
                        "noise, and only a model with that input can remove it."
                    )
        return sentences

    def _percentiles(self, replicates: Array) -> Array:
        units = self.at.events or len(self.problem.dataset)
        return percentile_intervals(replicates, units, self.at.freedom, self.level)

    @property
    def _points(self) -> tuple[Array, Array]:
        return self.found, self.at.theta

    def band(self, *inputs: Array) -> tuple[Array, Array]:
        """Prediction at input columns (N,) and the half width of its interval, (N,) each.

        The interval is of the curve, not of new measurements.
        """
        model = self.problem.model
        spread = self.at.spread(model.jacobian(self.at.theta, *inputs))
        return (
            model.predict(self.at.theta[None], *inputs)[0],
            self.at.quantile(self.level) * spread,
        )

    def __repr__(self) -> str:
        """One line: of which problem, with which error."""
        error = f"error {self.error:.5g} {self.problem.unit}"
        return f"<Report of {self.problem.name}: {', '.join(self.problem.space.names)}; {error}>"

    def __str__(self) -> str:
        """The parameters with their best intervals, the error, and what the numbers mean."""
        kinds = ("profile", "bootstrap", "linearised")
        kind = next(kind for kind in kinds if f"{kind} low" in self.parameters)
        shown = ["parameter", "value", "unit", "standard error", f"{kind} low", f"{kind} high"]
        table = self.parameters[shown].to_string(index=False, float_format="%.5g")
        error = f"error: {self.error:.5g} {self.problem.unit}"
        return "\n\n".join([table, "\n".join([error, *(f"- {note}" for note in self.notes)])])

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """All tables by name, those that have rows."""
        named = {
            "parameters": self.parameters,
            "correlation": self.correlation.rename_axis("parameter").reset_index(),
            "derived": self.derived,
            "errors": self.errors,
            "left_out": self.left_out,
            "trends": self.trends,
        }
        return {name: table for name, table in named.items() if len(table)}


def make_report(
    problem: CurveFit,
    found: Array,
    *,
    replicates: int = 0,
    profiles: bool | None = None,
    level: float = 0.95,
    seed: int = 0,
    each: Callable[[str], object] = lambda stage: None,
) -> Report:
    """The report on parameters `found` (d,) of a problem.

    `replicates` bootstrap estimates (1000 for an interval, 0 for none), drawn from `seed`;
    `profiles` by default for models of up to MOST_PROFILES parameters, none for data in events.
    `each` is called before each of many steps with the name of the stage, for progress. Raises
    ValueError where there is no uncertainty to be had: fewer rows than parameters, or derivatives
    that are not finite.
    """
    if not 0 < level < 1:
        raise ValueError(f"level is {level!r}; expected between 0 and 1, such as 0.95")
    at = linearised(problem, refit(problem, found).theta)
    wanted = len(problem.space) <= MOST_PROFILES if profiles is None else profiles
    possible = np.isfinite(at.standard_errors) & (at.standard_errors > 0)
    possible &= not at.events  # a profile takes every row for independent
    held = np.flatnonzero(at.blind).tolist()  # no refit moves what the data do not see
    drawn = None
    if replicates:
        rng = stream("bootstrap", problem.dataset.digest, seed)
        drawn = bootstrap(problem, at.theta, replicates, rng, lambda: each("bootstrap"), held)
    left_out = []
    for condition in conditions(problem):
        each(f"leave one {condition} out")
        left_out.append(leave_one_out(problem, at.theta, condition, held))
    curves: list[Profile | None] = []
    for i, name in enumerate(problem.space.names):
        each(f"profile of {name}")
        curves.append(profile(problem, at, i, level) if wanted and possible[i] else None)
    return Report(
        problem=problem,
        found=found,
        at=at,
        profiles=tuple(curves),
        replicates=drawn,
        left_out=pd.concat(left_out, ignore_index=True) if left_out else pd.DataFrame(),
        level=level,
    )
