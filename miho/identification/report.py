"""The report of an identification: what was found, how far to trust it, and where it holds."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.identification.bootstrap import bootstrap, percentile_intervals
from miho.identification.closed_form import linear_optimum
from miho.identification.curve_fit import CurveFit
from miho.identification.derived import delta_method, derived
from miho.identification.evidence import Standing, standing
from miho.identification.flags import (
    difference,
    doubtful,
    flat,
    identifiability,
    independence,
    outliers,
    profiled,
    spread,
    too_few,
    zeros,
)
from miho.identification.irreducible import Irreducible, irreducible_interval
from miho.identification.profile import Profile, profile
from miho.identification.refit import Deadline, OutOfTimeError, Refit, refit
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
from miho.optim import Descents, in_optimum
from miho.optim.seeds import stream
from miho.quantities import Array

MOST_PROFILES = 10
"""Models with more parameters are profiled only if asked: each end costs several refits."""
HEDGE = (
    "what is said of data and model is said of this optimum, and would not hold if all descents "
    "missed a better one."
)
"""Starts are the best of a screen, so a narrow basin can be missed by all of them."""
SUSPICIOUS = 2.0
CHANCE = 1e-3
REFIT = 5000
"""Evaluations of the descent to the optimum that the report is of."""
ELSEWHERE = 10
"""Configurations at which a parameter without effect is tried again."""
BETTER = 1e-4
"""A sum of squares that is smaller by this fraction is another, better optimum."""
ROUNDING = 1e-12
"""Errors below this fraction of the output are rounding, which follows no law and no profile."""
SECONDS = 60.0
REMEDY = "search from more starts, or in a narrower or logarithmic box."
UNMODELLED = 0.1
"""A column that is no input and explains this fraction of the errors' variance is mentioned."""


@dataclass(frozen=True, eq=False)
class Report:
    """What is known of one identification; every table is a function of these fields.

    All is of one point, the optimum that a descent from the run's result led to: `at` is its
    uncertainty, `standing` what is known of it. `run` (d,) are the run's own parameters. `profiles`
    are one per parameter (None where there is none), `replicates` (n, d) the bootstrap's estimates,
    `left_out` the errors on groups that a fit has not seen. `omitted` says in sentences what there
    was no time for, `remedy` what to do where the optimum is in doubt. `searches` are the descents
    of the run, and of a check; `best_known` is the loss of the optimum where it is known.
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

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """A row per parameter: value, unit, standard error and intervals; the run's own value."""
        space = self.problem.space
        frame = pd.DataFrame(
            {
                "parameter": space.names,
                "value": self.at.theta,
                "unit": [p.unit for p in space.parameters],
                "standard error": self.at.standard_errors,
                "sandwich": np.where(
                    np.isfinite(self.at.standard_errors),
                    np.sqrt(np.diag(self.at.sandwich)),
                    self.at.standard_errors,
                ),
                "of the run": self.run,
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
        """Errors in the output's unit, on the training rows, on held-out ones and irreducible.

        Root mean squares; of the irreducible error its interval, `low` to `high`.
        """
        problem, dataset = self.problem, self.problem.dataset
        rows: list[tuple[str, int, float, float, float]] = []

        def add(what: str, count: int, error: float) -> None:
            rows.append((what, count, error, math.nan, math.nan))

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
            what = "a fifth" if len(part) == BINS and not levels(dataset[name]) else "one level"
            add(f"leave {what} of {name} out", int(part["rows"].sum()), math.sqrt(mean_square))
        if math.isfinite(self.irreducible.value):
            rows.append(("irreducible, about", len(dataset), *self.irreducible))
        columns = ["on", "rows", "error", "low", "high"]
        return pd.DataFrame(rows, columns=columns).assign(unit=problem.unit)

    @cached_property
    def descents(self) -> pd.DataFrame:
        """A row per descent that came to an end, the best first: its error, and whether it is here.

        Columns: descent (from 1), error (root of the loss, in the output's unit), ended here. Of
        very many descents of a run the best only, as `Descents` keeps them.
        """
        problem = self.problem
        ends = sorted(end for each in self.searches for end in each.ends)
        loss = float(problem.loss(self.at.theta[None])[0])
        here = ["yes" if in_optimum(loss, end, problem.resolution) else "no" for end in ends]
        rows = {"descent": np.arange(len(ends)) + 1, "error": np.sqrt(ends), "ended here": here}
        return pd.DataFrame(rows)

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
        return _irreducible(self.problem)

    @cached_property
    def trends(self) -> pd.DataFrame:
        """What the errors still follow, a row per input and condition."""
        return residual_trends(self.problem, self.at.theta)

    @cached_property
    def notes(self) -> list[str]:
        """What the numbers mean, a sentence each; empty if there is nothing to warn of.

        Where the optimum is in doubt they are of the search only, not of data or model.
        """
        space = self.problem.space
        before, after = (
            root_mean_square(self.problem.residuals(theta)) for theta in (self.run, self.at.theta)
        )
        sentences = difference(self.run, self.at, space, 1 - after / before if before else 0.0)
        if self.standing.doubt:
            sentences = doubtful(self.standing.doubt, self.remedy, self.at, space) + sentences
        else:
            remarks = self._of_data_and_model()
            if remarks and not self.standing.certain:
                remarks.append(HEDGE)
            sentences += remarks
        return [*sentences, *self.omitted]

    def _of_data_and_model(self) -> list[str]:
        space = self.problem.space
        sentences = identifiability(self.at, space) + too_few(self.problem)
        if self.at.noise <= _rounding(self.problem):
            return [*sentences, "every row is reproduced to rounding: the data have no error."]
        sentences += zeros(self.parameters, self.level)
        sentences += profiled(self.at, space, self.profiles, self.level)
        sentences += spread(self.problem, self.at)
        sentences += independence(self.problem, self.at)
        sentences += outliers(self.problem, self.at)
        error, irreducible = self.error, self.irreducible
        if irreducible.resolved and 0 < SUSPICIOUS * irreducible.high < error:
            sentences.append(
                f"the error is {error / irreducible.value:.1f} times the irreducible error: check "
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
            "descents": self.descents,
        }
        return {name: table for name, table in named.items() if len(table)}


def make_report(
    problem: CurveFit,
    run: Array,
    *,
    descents: Descents | None = None,
    check: Descents | None = None,
    better: Array | None = None,
    best_known: float | None = None,
    replicates: int = 0,
    profiles: bool | None = None,
    level: float = 0.95,
    seed: int = 0,
    seconds: float = SECONDS,
    remedy: str = REMEDY,
    each: Callable[[str], object] = lambda stage: None,
) -> Report:
    """The report on the optimum near `run` (d,), the parameters that a run of a problem found.

    `descents` says where those of the run ended, `check` those of a check, and the report is of the
    optimum near its result `better` (d,) if that is better; `best_known` is the loss
    of a recorded optimum. `replicates` bootstrap estimates (1000 for an interval, 0 for none),
    drawn from `seed`; `profiles` by default for models of up to MOST_PROFILES parameters, none for
    data in events. What is computed by default ends after `seconds`: what is missing then is said.
    What is asked for (replicates, profiles) takes the time it takes. `each` is called before each
    of many steps with the name of the stage, for progress. Raises ValueError where there is no
    uncertainty to be had: fewer rows than parameters, or derivatives that are not finite.
    """
    if not 0 < level < 1:
        raise ValueError(f"level is {level!r}; expected between 0 and 1, such as 0.95")
    deadline = Deadline(time.perf_counter() + seconds)
    each("optimum")
    optimum = _optimum(problem, run, deadline)
    if better is not None:
        optimum = min(optimum, _optimum(problem, better, deadline), key=lambda each: each.cost)
    wanted = len(problem.space) <= MOST_PROFILES if profiles is None else profiles
    while True:
        at = linearised(problem, optimum.theta)
        omitted: list[str] = []
        curves: list[Profile | None] = [None] * len(problem.space)
        possible = np.isfinite(at.standard_errors) & (at.standard_errors > 0)
        possible &= not at.events  # a profile takes every row for independent
        possible &= at.noise > _rounding(problem)
        for i in np.flatnonzero(possible) if wanted else ():
            each(f"profile of {problem.space.names[i]}")
            try:
                curves[i] = profile(problem, at, int(i), level, None if profiles else deadline)
            except OutOfTimeError:
                lacking = ", ".join(problem.space.names[k] for k in np.flatnonzero(possible)[i:])
                omitted.append(_omission(f"profile intervals of {lacking}", seconds))
                break
        lowest = min((p.best for p in curves if p), key=lambda each: each.cost, default=optimum)
        if lowest.cost >= (1 - BETTER) * optimum.cost:
            break
        each("better optimum")
        optimum = _optimum(problem, lowest.theta, deadline)
    held = np.flatnonzero(at.blind).tolist()  # no refit moves what the data do not see
    drawn = None
    if replicates:
        rng = stream("bootstrap", problem.dataset.digest, seed)
        drawn = bootstrap(problem, at.theta, replicates, rng, lambda: each("bootstrap"), held)
    left_out = []
    for condition in conditions(problem):
        each(f"leave one {condition} out")
        try:
            left_out.append(leave_one_out(problem, at.theta, condition, held, deadline))
        except OutOfTimeError:
            omitted.append(_omission(f"errors with {condition} left out", seconds))
            break
    searches = tuple(each for each in (descents, check) if each is not None)
    exact = linear_optimum(problem)
    best_known = best_known if exact is None else exact[1]
    return Report(
        problem=problem,
        run=run,
        at=at,
        standing=_standing(problem, at, optimum, searches, best_known, exact is not None),
        profiles=tuple(curves),
        replicates=drawn,
        left_out=pd.concat(left_out, ignore_index=True) if left_out else pd.DataFrame(),
        level=level,
        omitted=tuple(omitted),
        remedy=remedy,
        searches=searches,
        best_known=best_known,
    )


def _optimum(problem: CurveFit, start: Array, deadline: Deadline) -> Refit:
    """The optimum near `start` (d,), or how far the deadline let the descent come.

    What nothing depends on at the start is held, and so the run's value of it is kept.
    """
    derivatives = problem.jacobian(problem.space.clip(start))
    without = np.flatnonzero(~derivatives.any(axis=0)).tolist()
    return refit(problem, start, fixed=without, evaluations=REFIT, deadline=deadline)


def _standing(
    problem: CurveFit,
    at: Linearised,
    optimum: Refit,
    searches: Sequence[Descents],
    best_known: float | None,
    linear: bool,
) -> Standing:
    """What is known of the optimum that the report is of; `linear`: the best known is exact."""
    found = standing(
        optimum.cost / len(problem.dataset),
        problem.resolution,
        searches,
        best_known=best_known,
        irreducible=_irreducible(problem),
        error=root_mean_square(problem.errors(at.theta)),
    )
    if not optimum.converged and not linear:
        moving = (
            f"a descent from it was still moving after {optimum.evaluations:,} evaluations, so "
            "standard errors and intervals are not those of an optimum"
        )
        return Standing(found.evidence, _joined(found.doubt, moving))
    if at.blind.any():
        local = flat(at, problem.space, _without_effect(problem))
        return Standing(found.evidence, _joined(found.doubt, local), certain=found.certain)
    return found


def _joined(*reasons: str) -> str:
    return "; ".join(filter(None, reasons))


def _without_effect(problem: CurveFit) -> NDArray[np.bool_]:
    """The parameters (d,) that cannot be told at any of some configurations across the box.

    The rank of the derivatives is the same almost everywhere for a smooth model, so a parameter
    that is blind at all of them is not identifiable from these inputs.
    """
    blind = np.ones(len(problem.space), dtype=bool)
    for theta in problem.space.decode(problem.space.initial(ELSEWHERE)):
        with contextlib.suppress(ValueError):
            blind &= linearised(problem, theta).blind
    return blind


def _rounding(problem: CurveFit) -> float:
    """Errors up to here are rounding, in the output's unit."""
    return ROUNDING * root_mean_square(problem.dataset[problem.dataset.output])


def _irreducible(problem: CurveFit) -> Irreducible:
    if len(problem.inputs) != 1:
        return Irreducible(math.nan, math.nan, math.nan)
    return irreducible_interval(problem.inputs[0], problem.dataset[problem.dataset.output])


def _omission(what: str, seconds: float) -> str:
    return (
        f"{what} are left out: there were {seconds:g} s for such refits "
        f"(--seconds {10 * seconds:g} gives more)."
    )
