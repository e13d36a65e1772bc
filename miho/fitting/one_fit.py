"""A fit in one call: from a function, columns and bounds to parameters, and how sure they are."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from miho.fitting.dear_fit import (
    JournalPath,
    as_begun,
    dear_fit,
    interrupted,
    pace_line,
    spread,
)
from miho.fitting.known_start import best_known, check_start
from miho.fitting.statement import Tire, data_of, inputs_of, of_tire, space_of
from miho.identification.closed_form import linear_optimum
from miho.identification.constraints import constrained, free_values
from miho.identification.curve_fit import CurveFit
from miho.identification.loss import Loss, Square
from miho.identification.refit import refit
from miho.identification.standing import standing
from miho.identification.stated import at_limits, stated_parameters, whole_values
from miho.identification.uncertainty import Linearised, alike_beside_priors, linearised
from miho.models.joint import rows_of_parts
from miho.models.magic_formula import MagicFormula
from miho.models.model import Model
from miho.models.tied import Tied, whole_model
from miho.models.tire_formula import TireFormula
from miho.models.traced import Remade
from miho.optim import MIHOGN, Budget, Descents, Optimizer, Outcome, Space, minimize
from miho.parallel import Evaluations, Workers
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from miho.identification.report import Report

SETTLED, ROUNDS = 1e-6, 100
"""The deviation of the errors is estimated until it changes by less than this share, in so many
rounds at most."""
LINEAR = 1e-9
"""The loss of a linear problem's optimum is known to this share."""


class Prediction(NamedTuple):
    """The curve at some inputs and the ends of its interval, (N,) each; not of new measurements."""

    value: Array
    low: Array
    high: Array


def fit(
    model: Model | Callable[..., Any] | Tire,
    x: Any,
    y: Any,
    space: Space | Mapping[str, Any] | Collection[str] | None = None,
    *,
    sigma: Any = None,
    sigma_known: bool = True,
    start: Mapping[str, float] | Literal["journal"] | None = None,
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    constraints: str | Sequence[str] = (),
    loss: Loss | None = None,
    method: Optimizer | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    compiled: bool | None = None,
    workers: Workers = None,
    evaluation_limit: float | None = None,
    journal: JournalPath = None,
) -> Fit:
    """Fit a model to data, within bounds and without a start, or from a start without a search.

        fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, {"a": (0, 5), "b": (0, 10)})

    `model` is a function of input columns and then parameters, or a `Model`; annotations of a
    function that are strings are units. `x` is a column (N,), a tuple of columns, or a mapping or
    data frame of columns by name, and `y` (N,) or the name of one of its columns. `space` gives
    each parameter its bounds: (low, high), a mapping of the settings of `miho.Parameter`, such as
    {"low": 1, "high": 1e6, "scale": "log"}, or a `Parameter`. `fixed` holds parameters at numbers;
    `tied` at expressions of others, which may be parameters of the space only. `constraints` are
    linear: "a < b < c", "a + b = 1", "b - a < 5", or several of them.

    `sigma` is the standard deviation of the errors: a number, one for each row (N,), or the name of
    a column of `x`; with `sigma_known` false up to a factor, which the residuals then tell. What
    priors count beside errors that are not known is settled with the fit.

    `method` searches within the bounds, `MIHOGN()` by default. With a `start` of every free
    parameter there is one descent from there, and bounds are not needed; with "journal" one from
    the best configuration that stands in the journal, whatever method evaluated it. `loss` is what
    a residual costs: its square, or one that outliers cannot dominate. For a search an arithmetic
    function is compiled at its first fit, unless `compiled` is false: that takes seconds, later
    fits milliseconds.

    A tire, `miho.load_tir` of a property file or its path, is a model too, of Fx, Fy or Mz as `y`
    names it; its coefficients that have bounds or a start are free, all others stay. Only named, as
    in ["PDY1", "PKY1"], they start from the tire's own values.

    Where an evaluation takes long, `workers` make them: a number of processes, -1 for one per core,
    an executor, or the address of a cluster; the result is the same. One that takes longer than
    `evaluation_limit` seconds has no value. In the file `journal` stands every evaluation that
    takes longer than some 10 ms, as soon as it is made: the same call makes none of them again.
    One with other bounds, priors, sigma or another method knows them too, where it comes across the
    same configurations; one of another model or of other data is refused.

    Raises ValueError for what does not fit together, and where no finite value was found.
    """
    from_journal = isinstance(start, str)
    if isinstance(start, str):
        check_start(start, journal)
        start = None
    # A tire has bounds or a start of its own; anything else needs them by name.
    if isinstance(model, MagicFormula | str | os.PathLike):
        model, space, start = of_tire(model, x, y, space or (), start, fixed or {}, tied or {})
    elif isinstance(space, Collection) and not isinstance(space, Mapping | Space):
        raise ValueError(f"bounds are {space!r}; give them by name, as in {{'a': (0, 10)}}")
    named = space.names if isinstance(space, Space) else tuple(space or ())
    parameters = {*named, *(start or ()), *(fixed or ()), *(tied or ())}
    dataset, chosen, sigma = data_of(model, x, y, sigma, parameters)
    if compiled is None:
        compiled = start is None and not isinstance(model, TireFormula)
    bounds = constrained(space_of(chosen, space, start, fixed or {}, tied or {}), constraints)

    first: CurveFit | None = None  # whose model is known for what it is

    def problem_of(bounds: Space, prior_scale: float | None = None, dear: bool = True) -> CurveFit:
        known = chosen if first is None else whole_model(first.model)
        return CurveFit(
            known, dataset, bounds, loss or Square(), sigma=sigma, sigma_known=sigma_known,
            compiled=compiled, prior_scale=prior_scale, dear=dear,
        )  # fmt: skip

    # Beside errors that are not known, priors count by what the residuals say.
    settles = has_priors(bounds) and (sigma is None or not sigma_known)
    plain = without_priors(bounds) if settles else bounds
    first = as_begun(lambda dear: problem_of(plain, dear=dear), journal, evaluation_limit)
    with dear_fit(first, workers, evaluation_limit, journal) as evaluations:

        def solved(problem: CurveFit) -> Fit:
            if from_journal:
                return descended(problem, best_known(spread(problem, evaluations)), evaluations)
            if start is None:
                return searched(problem, method, budget, seed, evaluations)
            return descended(problem, start, evaluations)

        if not settles:
            return solved(first)
        return settled(bounds, lambda *box: solved(problem_of(*box)), evaluations)


def settled(
    bounds: Space,
    solved: Callable[[Space, float | None], Fit],
    evaluations: Evaluations | None = None,
) -> Fit:
    """The fit beside priors whose weight depends on the errors, which are not known.

    `solved` fits within bounds, with priors that count beside errors of a standard deviation. That
    is estimated without priors first (Theil and Goldberger, International Economic Review 2, 1961),
    then from the residuals of the fit, in turn with the fit, with the degrees of freedom that
    `linearised` takes. Raises ValueError where it is not settled after ROUNDS.
    """

    def noise(fit: Fit) -> float:
        at = linearised(spread(fit.problem, evaluations), fit.theta)
        return max(at.noise, math.sqrt(fit.problem.rounding))

    fit = solved(bounds, noise(solved(without_priors(bounds), None)))
    for _ in range(ROUNDS):
        scale = noise(fit)
        before = fit.problem.prior_scale or scale
        if abs(scale - before) <= SETTLED * before:
            return fit if fit.descents is None else solved(bounds, scale)
        problem = replace(fit.problem, prior_scale=scale, dear=True)
        theta = refit(spread(problem, evaluations), fit.theta).theta
        fit = replace(fit, problem=problem, theta=theta)
    raise ValueError("the errors and what priors count beside them do not settle; give sigma")


def has_priors(space: Space) -> bool:
    """Whether anything is known besides the data."""
    return any(parameter.prior is not None for parameter in space.parameters)


def without_priors(space: Space) -> Space:
    """The same bounds, and nothing known besides."""
    return replace(space, parameters=tuple(replace(p, prior=None) for p in space.parameters))


def descended(
    problem: CurveFit, start: Mapping[str, float], evaluations: Evaluations | None = None
) -> Fit:
    """The optimum that a descent from a start of every free parameter leads to."""
    model = problem.model
    theta = np.array([float(start.get(name, 0.0)) for name in problem.space.names])
    if isinstance(model, Tied):
        theta = free_values(problem.space, model.ties, start)
    descent = refit(spread(problem, evaluations), theta)
    if not math.isfinite(descent.cost):
        raise ValueError(f"{problem.name}: is not finite at the start; give another one")
    return Fit(problem, descent.theta, descent.theta)


def searched(
    problem: CurveFit,
    method: Optimizer | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    evaluations: Evaluations | None = None,
) -> Fit:
    """The optimum of a problem, by `MIHOGN()` unless another method is given.

    `evaluations` make those of search and descent. Raises KeyboardInterrupt after a Ctrl-C.
    """
    method = method or MIHOGN()
    if problem.kernel is not None and method.uncompiled:
        sys.stderr.write(
            "miho: compiling the search, once on this machine, for about half a minute "
            "(compiled=False does without)\n"
        )
    run = minimize(
        method, problem, budget, seed, rehearse=False, workers=evaluations,
        observer=pace_line(problem, budget),
    )  # fmt: skip
    if run.outcome is Outcome.INTERRUPTED:
        raise interrupted(run)
    if run.theta is None:
        raise ValueError(f"{problem.name}: no finite value was found: {run.error or run.rejected}")
    if run.error is not None:
        reason = run.error.strip().splitlines()[-1]
        sys.stderr.write(f"miho: {problem.name}: its best is taken, the search failed: {reason}\n")
    theta = refit(spread(problem, evaluations), run.theta).theta
    return Fit(problem, theta, run.theta, run.descents)


@dataclass(frozen=True, eq=False)
class Fit(Remade):
    """The optimum `theta` (f,) of the free parameters of a problem, and what it can tell.

    `run` (f,) is where the search ended, from which a descent led there, and `descents` what it
    knows of other optima; None without a search.
    """

    problem: CurveFit
    theta: Array
    run: Array
    descents: Descents | None = None
    level: float = 0.95

    @cached_property
    def uncertainty(self) -> Linearised:
        """Standard errors and correlations, which allow for errors that depend on neighbours'.

        Raises ValueError with no more rows than parameters.
        """
        return linearised(self.problem, self.theta, neighbours=True)

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """A row per parameter, free, fixed or tied: value, standard error, linearised interval."""
        import pandas as pd

        try:
            at = self.uncertainty
        except ValueError:  # as many parameters as rows: values without errors
            values = whole_values(self.problem, self.theta)
            frame = pd.DataFrame({"value": values})
            return frame.assign(standard_error=math.nan, low=math.nan, high=math.nan)
        stated, slopes = stated_parameters(self.problem, at)
        frame = pd.DataFrame(stated).set_index("name").rename_axis(None)
        reach = at.quantiles(slopes, self.level) * frame["standard_error"]
        frame.insert(3, "low", frame["value"] - reach)
        frame.insert(4, "high", frame["value"] + reach)
        return frame[["value", "standard_error", "low", "high", "unit", "held"]]

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values by name."""
        return whole_values(self.problem, self.theta)

    @cached_property
    def error(self) -> float:
        """Root-mean-square error, in the output's unit."""
        return float(np.sqrt(np.mean(self.problem.errors(self.theta) ** 2)))

    @cached_property
    def optimum(self) -> str:
        """What is known of the optimum: how many searches ended in it."""
        loss = float(self.problem.loss(self.theta[None])[0])
        searches = () if self.descents is None else (self.descents,)
        exact = linear_optimum(self.problem)
        if exact is not None and loss <= exact[1] * (1 + LINEAR) + self.problem.resolution:
            evidence = "linear in all parameters, so that no other optimum is better"
        else:
            evidence = standing(loss, self.problem.resolution, searches).evidence
        return "; ".join([evidence, *at_limits(self.problem, self.theta)])

    def report(self, **settings: Any) -> Report:
        """All that can be told, with profile intervals; `settings` are those of `make_report`.

        Takes up to some seconds.
        """
        from miho.identification.report_steps import make_report

        settings = {"descents": self.descents, "level": self.level, **settings}
        return make_report(self.problem, self.run, **settings)

    @cached_property
    def notes(self) -> list[str]:
        """What the report has to say of search, data and model, a sentence each."""
        return self.report().notes

    def predict(self, x: Any) -> Prediction:
        """The curve at inputs, given as to `fit`, with its interval at `level`."""
        inputs = inputs_of(self.problem.model, x)
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
        """The parameters, the error, and what is known of the optimum."""
        table = self.parameters.to_string(float_format=lambda number: f"{number:.5g}")
        rows = len(self.problem.dataset)
        error = f"error {self.error:.5g} {self.problem.unit}".rstrip()
        weights = "" if self.problem.weights is None else ", weighted by sigma"
        alike = "; intervals allow for errors that depend on those of neighbouring rows"
        narrow = (
            "; errors of neighbouring rows are alike, so intervals beside priors are too narrow"
        )
        priors = bool(alike_beside_priors(self.problem, self.theta))
        return (
            f"{table}\n{error} (root mean square of {rows:,} rows{weights}); {self.optimum}"
            f"{alike * self._dependent}{narrow * priors}"
        )

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
        last = escape(str(self).rpartition("\n")[2])
        return f"{table}<p>{last}</p>"
