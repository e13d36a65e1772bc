"""The result of a fit: what its optimum tells, from a table of parameters to predictions."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import time
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from miho.fitting.statement import inputs_of
from miho.identification.alternatives import (
    hull,
    minima_at,
    optima_table,
    optima_within_noise,
    several_values,
)
from miho.identification.curve_fit import CurveFit
from miho.identification.refit import Refit
from miho.identification.standing import Standing
from miho.identification.stated import (
    at_limits,
    marked,
    reported_space,
    reported_uncertainty,
    stated_parameters,
    whole_values,
)
from miho.identification.uncertainty import Linearised, alike_beside_priors, linearised
from miho.models.joint import rows_of_parts
from miho.models.tied import whole_model
from miho.models.tire_formula import TireFormula
from miho.models.traced import Remade
from miho.optim import Descents, Minimum, in_optimum
from miho.parallel.remote import Raised
from miho.parallel.worth import is_dear
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from miho.identification.report import Report

SAME = 1e-9
"""Two errors that differ by less than this share of the largest output belong to one model:
rounding on another machine differs by 1e-16 to 1e-15 in each operation."""


class Prediction(NamedTuple):
    """The curve at some inputs and the ends of its interval, (N,) each; not of new measurements."""

    value: Array
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class Fit(Remade):
    """The optimum `theta` (f,) of the free parameters of a problem, and what it can tell.

    `run` (f,) is where the search ended, from which a descent led there, and `descents` what it
    knows of other optima; None without a search. `moving` and `found_by` are those of
    `miho.identification.optimum.standing_of`: whether that descent has come to its end, and which
    later step has found the optimum. `minima` are further optima within the noise that a report
    met. A pickled fit keeps its error, which takes an evaluation; where the model gives another
    one when it is loaded, a line on stderr says so.
    """

    problem: CurveFit
    theta: Array
    run: Array
    descents: Descents | None = None
    level: float = 0.95
    moving: int = 0
    found_by: str = ""
    minima: tuple[Minimum, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """The fields, and the error by which a changed model is known."""
        return super().__getstate__() | {"error": self.error}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Evaluate the model, whose function may be another one than when the fit was stored."""
        before = state.pop("error", None)
        vars(self).update(state)
        if before is None:  # of a version that stored none
            return
        dataset = self.problem.dataset
        close = SAME * float(np.abs(dataset[dataset.output]).max())
        try:
            if np.isclose(self.error, before, rtol=SAME, atol=close, equal_nan=True):
                return
            now = f"its error at the optimum is {self.error:.9g}"
        except Exception as error:  # noqa: BLE001 -- whatever the model raises
            now = f"it raises {Raised.of(error).line}"
        sys.stderr.write(
            f"miho: {self.problem.name}: the model has changed since this fit was stored: {now}, "
            f"not {before:.9g}; fit again, or restore the model\n"
        )

    @cached_property
    def uncertainty(self) -> Linearised:
        """Standard errors and correlations, which allow for errors that depend on neighbours'.

        Raises ValueError with no more rows than parameters.
        """
        return linearised(self.problem, self.theta, neighbours=True)

    @cached_property
    def _optima(self) -> tuple[Linearised, ...]:
        """The uncertainties at all optima within the noise, that of this one first."""
        here = self.uncertainty
        minima = self.minima + (() if self.descents is None else self.descents.minima)
        if not minima:
            return (here,)
        best = Refit(self.theta, float(np.sum(self.problem.residuals(self.theta) ** 2)))
        within = optima_within_noise(self.problem, best, minima, self.level)
        others = [fit.theta for fit in within if fit is not best]
        return (here, *(linearised(self.problem, theta, neighbours=True) for theta in others))

    @cached_property
    def alternatives(self) -> pd.DataFrame:
        """The optima that the data cannot tell apart, a row each; no row where there is only one.

        The chi-squared of each exceeds the smallest by no more than an interval of `level` allows,
        by a factor that the residuals tell where the noise is not known. Columns are `optimum`
        (from 1, this fit), `excess` (of chi-squared above the first), the parameters, and the
        derived quantities of the model. The intervals of `parameters` span all of them. Raises
        ValueError with no more rows than parameters.
        """
        return optima_table(self.problem, self._optima)

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """A row per parameter, free, fixed or tied: value, standard error, linearised interval.

        Where the data cannot tell several optima apart (`alternatives`), the interval spans all of
        them; the standard error is that of this one.
        """
        import pandas as pd

        try:
            optima = self._optima
        except ValueError:  # as many parameters as rows: values without errors
            values = whole_values(self.problem, self.theta)
            frame = pd.DataFrame({"value": values})
            return frame.assign(standard_error=math.nan, low=math.nan, high=math.nan)
        tables, ends = [], []
        for at in optima:
            stated, slopes = stated_parameters(self.problem, at)
            table = pd.DataFrame(stated).set_index("name").rename_axis(None)
            value, reach = (
                table["value"],
                at.quantiles(slopes, self.level) * table["standard_error"],
            )
            tables.append(table)
            ends.append(np.stack([value - reach, value + reach], axis=1))
        frame = tables[0]
        points = [table["value"].to_numpy() for table in tables]
        frame["low"], frame["high"] = hull(points, ends).T
        return frame[["value", "standard_error", "low", "high", "unit", "held"]]

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values by name."""
        return whole_values(self.problem, self.theta)

    @cached_property
    def error(self) -> float:
        """Root-mean-square error, in the output's unit."""
        return float(np.sqrt(np.mean(self.problem.errors(self.theta) ** 2)))

    @property
    def optimum(self) -> str:
        """The evidence that the optimum is the best one, or the reason to doubt it."""
        limits = (f"{limit}." for limit in at_limits(self.problem, self.theta))
        return " ".join([self._standing.statement, *limits])

    @cached_property
    def _standing(self) -> Standing:
        """The evidence for the optimum, or the doubt about it, as in the report."""
        from miho.identification.optimum import standing_of

        searches = () if self.descents is None else (self.descents,)
        started = time.perf_counter()
        self.problem.loss(self.theta[None])
        at = None
        # To see whether a parameter has an effect elsewhere takes many evaluations.
        if not is_dear(time.perf_counter() - started):
            with contextlib.suppress(ValueError):  # too few rows
                at = self.uncertainty
        return standing_of(
            self.problem, self.theta, self.run, searches, at=at, moving=self.moving,
            found_by=self.found_by,
        )  # fmt: skip

    @cached_property
    def caveats(self) -> list[str]:
        """Sentences on what takes the numbers away: `print` shows them below the table.

        They are of parameters at a bound or not identifiable, of optima that the data cannot tell
        apart, and of an optimum in doubt. All else is in `notes`, which takes longer.
        """
        from miho.identification.flags import doubtful, ended_at_bounds, held_at_bounds, unseen
        from miho.identification.report import REMEDY

        stand = self._standing
        sentences = doubtful(stand.doubt, REMEDY) if stand.doubt else []
        try:
            at = reported_uncertainty(self.problem, self.uncertainty)
        except ValueError as error:
            return [*sentences, f"there are no standard errors: {error}."]
        sentences += several_values(self.problem, self._optima)
        space = reported_space(self.problem.space)
        sentences += (ended_at_bounds if stand.doubt else held_at_bounds)(at, space)
        return sentences + unseen(at, space, everywhere=False)

    def report(self, **settings: Any) -> Report:
        """All that can be told, with profile intervals; `settings` are those of `make_report`.

        Takes up to some seconds. Where it meets a better optimum, this becomes the fit's own, so
        that the fit tells what its report does.
        """
        from miho.identification.report_steps import make_report

        settings = {
            "descents": self.descents, "level": self.level, "optimum": self.theta,
            "moving": self.moving, "found_by": self.found_by, "minima": self.minima, **settings,
        }  # fmt: skip
        report = make_report(self.problem, self.run, **settings)
        self._adopt(report)
        return report

    def _adopt(self, report: Report) -> None:
        """Take the optimum of a report, and the report's statement on it.

        It is the fit's own, another and better one, or the same to more digits. Then those within
        the noise are the same, and no descent has to lead to them again.
        """
        if not np.array_equal(report.at.theta, self.theta):
            before, after = self.problem.loss(np.stack([self.theta, report.at.theta]))
            known = in_optimum(after, before, self.problem.resolution) and "_optima" in vars(self)
            others = self._optima[1:] if known else ()
            for name in (
                "uncertainty", "_optima", "alternatives", "parameters", "error", "notes",
            ):  # fmt: skip
                vars(self).pop(name, None)
            minima = minima_at(self.problem, report.others)
            vars(self).update(theta=report.at.theta, found_by=report.found_by, minima=minima)
            if known:
                vars(self)["_optima"] = (self.uncertainty, *others)
        vars(self).pop("caveats", None)
        vars(self).update(moving=report.moving, _standing=report.standing)

    @cached_property
    def notes(self) -> list[str]:
        """What the report has to say of search, data and model, a sentence each."""
        return self.report().notes

    def predict(self, x: Any) -> Prediction:
        """The curve at inputs, given as to `fit`, with its interval at `level`.

        Of a tire in ISO-W signs.
        """
        inputs = inputs_of(self.problem.model, x)
        if isinstance(whole_model(self.problem.model), TireFormula) and np.median(inputs["Fz"]) < 0:
            raise ValueError("Fz is mostly negative; predict takes a tire's inputs in ISO-W signs")
        columns = np.broadcast_arrays(*(np.atleast_1d(c).astype(float) for c in inputs.values()))
        value, reach = self._band(*columns)
        return Prediction(value, value - reach, value + reach)

    def to_tir(self, path: str | os.PathLike[str]) -> None:
        """Write a fitted tire as a property file; what else its own file says is kept."""
        model = whole_model(self.problem.model)
        if not isinstance(model, TireFormula):
            raise TypeError("only a fit of a tire can be written as a property file")
        model.write(self.values, path)

    def posterior(self, **settings: Any) -> Any:
        """The posterior distribution, as an ArviZ object (extra `posterior`).

        `settings` are those of `miho.identification.sample_posterior`.
        """
        from miho.identification.posterior import sample_posterior

        return sample_posterior(self.problem, self.theta, **settings)

    def _band(self, *columns: Array) -> tuple[Array, Array]:
        """The curve at input columns (N,), and the half width of its interval."""
        value = self.problem.model.predict(self.theta[None], *columns)[0]
        slopes = self.problem.model.jacobian(self.theta, *columns)
        return value, self.uncertainty.reach(slopes, self.level)

    def plot(self) -> Figure:
        """Data and curve with its interval; over several inputs, measured over predicted values."""
        from miho.analysis.figures.report import Column, curve_band, fit_figure

        dataset, inputs = self.problem.dataset, self.problem.model.inputs
        parts = rows_of_parts(self.problem.model, self.problem.inputs)
        shown = "output" if parts else dataset.output
        measured = Column(shown, self.problem.unit, dataset[dataset.output])
        predicted = self.problem.model.predict(self.theta[None], *self.problem.inputs)[0]
        x = band = None
        if len(inputs) == 1:
            (name,) = inputs
            x = Column(name, dataset.units[name], dataset[name])
            band = curve_band(x.values, self.problem.model.ordered, self._band)
        return fit_figure(measured, predicted, x, band, parts)

    def __str__(self) -> str:
        """The parameters, the error, what is known of the optimum, and what takes them away."""
        table = self.parameters.to_string(float_format=lambda number: f"{number:.5g}")
        rows = len(self.problem.dataset)
        error = f"error {self.error:.5g} {self.problem.unit}".rstrip()
        weights = "" if self.problem.weights is None else ", weighted by sigma"
        alike = "; intervals allow for correlated errors of neighbouring rows"
        narrow = (
            "; errors of neighbouring rows are correlated, and intervals do not allow for them "
            "together with priors"
        )
        priors = bool(alike_beside_priors(self.problem, self.theta))
        try:
            marks = marked(self.problem, self.theta, self.uncertainty)
        except ValueError:  # too few rows
            marks = marked(self.problem, self.theta, None)
        size = "; ".join([f"{error} (root mean square of {rows:,} rows{weights})", *marks])
        size += f"{alike * self._dependent}{narrow * priors}"
        # The caveats explain an optimum in doubt.
        limits = " ".join(f"{limit}." for limit in at_limits(self.problem, self.theta))
        known = (
            limits if self._standing.doubt else self.optimum.replace(" Estimated", "\nEstimated")
        )
        caveats = (f"- {sentence}" for sentence in self.caveats)
        return "\n".join(filter(None, [table, size, known, *caveats]))

    @property
    def _dependent(self) -> bool:
        try:
            return self.uncertainty.dependence is not None
        except ValueError:  # too few rows to tell
            return False

    def __repr__(self) -> str:
        """As it is printed, so that an interpreter shows it."""
        return str(self)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        table = self.parameters.to_html(float_format=lambda number: f"{number:.5g}")
        lines = str(self).splitlines()[len(self.parameters) + 1 :]
        return table + "".join(f"<p>{escape(line)}</p>" for line in lines)
