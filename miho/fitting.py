"""A fit in one call: from a function, columns and bounds to parameters, and how sure they are."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from miho.data.dataset import Dataset
from miho.identification.curve_fit import CurveFit
from miho.identification.loss import Loss, Square
from miho.identification.refit import refit
from miho.identification.standing import standing
from miho.identification.stated import stated_parameters
from miho.identification.uncertainty import Linearised, linearised
from miho.models.function_model import FunctionModel
from miho.models.model import Model
from miho.models.traced import Remade
from miho.optim import MIHOGN, Budget, Descents, Optimizer, Parameter, Space, minimize
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from miho.identification.report import Report

GRID = 400
"""Points of a curve that is drawn."""
FAR = 1e6
"""A parameter without bounds is sought so many times its start on either side of it."""


class Prediction(NamedTuple):
    """The curve at some inputs and the ends of its interval, (N,) each; not of new measurements."""

    value: Array
    low: Array
    high: Array


def fit(
    model: Model | Callable[..., Any],
    x: Any,
    y: Any,
    space: Space | Mapping[str, Any] | None = None,
    *,
    sigma: Any = None,
    sigma_known: bool = True,
    start: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    loss: Loss | None = None,
    method: Optimizer | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    compiled: bool = True,
) -> Fit:
    """Fit a model to data, within bounds and without a start, or from a start without a search.

        fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, {"a": (0, 5), "b": (0, 10)})

    `model` is a function of input columns and then parameters, or a `Model`; annotations of a
    function that are strings are units. `x` is a column (N,), a tuple of columns, or a mapping or
    data frame of columns by name, and `y` (N,) or the name of one of its columns. `space` gives
    each parameter its bounds: (low, high), a mapping of the settings of `miho.Parameter`, such as
    {"low": 1, "high": 1e6, "scale": "log"}, or a `Parameter`. `fixed` holds parameters at numbers;
    `tied` at expressions of others, which may be parameters of the space only.

    `sigma` is the standard deviation of the errors: a number, one for each row (N,), or the name of
    a column of `x`; with `sigma_known` false up to a factor, which the residuals then tell.

    `method` searches within the bounds, `MIHOGN()` by default. With a `start` of every free
    parameter there is one descent from there, and bounds are not needed. `loss` is what a residual
    costs: its square, or one that outliers cannot dominate. The function is `compiled` at its first
    fit, if it is arithmetic: that takes seconds, later fits milliseconds.

    Raises ValueError for what does not fit together, and where no finite value was found.
    """
    dataset, chosen, sigma = _data(model, x, y, sigma)
    bounds = _space(chosen, space, start, fixed or {}, tied or {})
    rho = Square() if loss is None else loss
    problem = CurveFit(
        chosen, dataset, bounds, rho, compiled=compiled, sigma=sigma, sigma_known=sigma_known
    )
    if start is not None:
        descent = refit(problem, np.array([float(start[name]) for name in problem.space.names]))
        if not math.isfinite(descent.cost):
            raise ValueError(f"{problem.name}: is not finite at the start; give another one")
        return Fit(problem, descent.theta, descent.theta)
    run = minimize(method or MIHOGN(), problem, budget, seed)
    if run.theta is None:
        raise ValueError(f"{problem.name}: no finite value was found: {run.error or run.rejected}")
    return Fit(problem, refit(problem, run.theta).theta, run.theta, run.descents)


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
        """Standard errors and correlations; raises ValueError with no more rows than parameters."""
        return linearised(self.problem, self.theta)

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """A row per parameter, free, fixed or tied: value, standard error, linearised interval."""
        import pandas as pd

        stated, _ = stated_parameters(self.problem, self.uncertainty)
        frame = pd.DataFrame(stated).set_index("name").rename_axis(None)
        reach = self.uncertainty.quantile(self.level) * frame["standard_error"]
        frame.insert(3, "low", frame["value"] - reach)
        frame.insert(4, "high", frame["value"] + reach)
        return frame[["value", "standard_error", "low", "high", "unit", "held"]]

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values by name."""
        return {str(name): value for name, value in self.parameters["value"].items()}

    @cached_property
    def error(self) -> float:
        """Root-mean-square error, in the output's unit."""
        return float(np.sqrt(np.mean(self.problem.errors(self.theta) ** 2)))

    @cached_property
    def optimum(self) -> str:
        """What is known of the optimum: how many searches ended in it."""
        loss = float(self.problem.loss(self.theta[None])[0])
        searches = () if self.descents is None else (self.descents,)
        return standing(loss, self.problem.resolution, searches).evidence

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
        inputs = _inputs(self.problem.model, x)
        columns = np.broadcast_arrays(*(np.atleast_1d(c).astype(float) for c in inputs.values()))
        value = self.problem.model.predict(self.theta[None], *columns)[0]
        spread = self.uncertainty.spread(self.problem.model.jacobian(self.theta, *columns))
        reach = self.uncertainty.quantile(self.level) * spread
        return Prediction(value, value - reach, value + reach)

    def plot(self) -> Figure:
        """Data and curve with its interval; over several inputs, measured over predicted values."""
        from miho.analysis.figures.report import Column, fit_figure

        dataset, inputs = self.problem.dataset, self.problem.model.inputs
        measured = Column(dataset.output, self.problem.unit, dataset[dataset.output])
        predicted = self.problem.model.predict(self.theta[None], *self.problem.inputs)[0]
        x = band = None
        if len(inputs) == 1:
            (name,) = inputs
            x = Column(name, dataset.units[name], dataset[name])
            grid = np.linspace(x.values.min(), x.values.max(), GRID)
            curve = self.predict(grid)
            band = (grid, curve.value, curve.high - curve.value)
        return fit_figure(measured, predicted, x, band)

    def __str__(self) -> str:
        """The parameters, the error, and what is known of the optimum."""
        table = self.parameters.to_string(float_format=lambda number: f"{number:.5g}")
        rows = len(self.problem.dataset)
        error = f"error {self.error:.5g} {self.problem.unit}".rstrip()
        weights = "" if self.problem.weights is None else ", weighted by sigma"
        return f"{table}\n{error} (root mean square of {rows:,} rows{weights}); {self.optimum}"

    def __repr__(self) -> str:
        """As it is printed, so that an interpreter shows it."""
        return str(self)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        table = self.parameters.to_html(float_format=lambda number: f"{number:.5g}")
        last = escape(str(self).rpartition("\n")[2])
        return f"{table}<p>{last}</p>"


def _data(model: Any, x: Any, y: Any, sigma: Any) -> tuple[Dataset, Model, str | float | None]:
    """The dataset, the model with the units that its function declares, and sigma as it has it."""
    by_name = isinstance(x, Mapping) or hasattr(x, "columns")
    if isinstance(y, str):
        if not by_name or y not in x:
            raise ValueError(f"y is {y!r}, which is no column of x; give its values or its name")
        output, values = y, x[y]
    else:
        output, values = "y", y
    if not isinstance(model, Model):
        model = FunctionModel(model, columns=_column_names(model, x))
    inputs = _inputs(model, x)
    while output in inputs:
        output += "_"
    columns, units = {**inputs, output: values}, {**model.inputs, output: model.output}
    if isinstance(sigma, str):
        if not by_name or sigma not in x:
            raise ValueError(f"sigma is {sigma!r}, which is no column of x; give values or a name")
        sigma = x[sigma]
    if sigma is not None and np.ndim(sigma):
        name = "sigma"
        while name in columns:
            name += "_"
        columns[name], units[name], sigma = sigma, model.output, name
    return Dataset(model.name or "data", columns, units, output), model, sigma


def _column_names(function: Any, x: Any) -> tuple[str, ...]:
    """Which arguments of a function are columns: those before the *, else as many as x has."""
    try:
        arguments = inspect.signature(function).parameters
    except (TypeError, ValueError):
        return ()  # which the function model refuses
    if any(a.kind is a.KEYWORD_ONLY for a in arguments.values()):
        return ()
    if isinstance(x, Mapping) or hasattr(x, "columns"):
        return tuple(name for name in arguments if name in x)
    return tuple(arguments)[: len(x) if isinstance(x, tuple) else 1]


def _inputs(model: Model, x: Any) -> dict[str, Any]:
    """The input columns by name."""
    names = list(model.inputs)
    if isinstance(x, Mapping) or hasattr(x, "columns"):
        lacking = [name for name in names if name not in x]
        if lacking:
            raise ValueError(
                f"x has no column {', '.join(lacking)}; {model.name} needs {', '.join(names)}"
            )
        return {name: np.asarray(x[name], dtype=float) for name in names}
    columns = x if isinstance(x, tuple) else (x,)
    if len(columns) != len(names):
        raise ValueError(
            f"x is {len(columns)} columns; {model.name} needs {len(names)}: {', '.join(names)}; "
            "give them as a tuple or by name"
        )
    return dict(zip(names, (np.asarray(column, dtype=float) for column in columns), strict=True))


def _space(
    model: Model,
    bounds: Space | Mapping[str, Any] | None,
    start: Mapping[str, float] | None,
    fixed: Mapping[str, float],
    tied: Mapping[str, str],
) -> Space:
    """The space that bounds, start, and what is fixed or tied make, the model's parameters first.

    Parameters without bounds reach FAR times their start to either side.
    """
    given = bounds if isinstance(bounds, Mapping) else {}
    if isinstance(bounds, Space):
        given = {parameter.name: parameter for parameter in bounds.parameters}
    names = list(dict.fromkeys([*model.parameters, *given]))
    for label, part in (("start", start or {}), ("fixed", fixed), ("tied", tied)):
        for name in part:
            if name not in names:
                raise ValueError(f"{label}: {name} is no parameter; choose from {', '.join(names)}")
    parameters = []
    for name in names:
        unit = model.parameters.get(name, "")
        settings = _settings(name, given.get(name))
        if name in fixed:
            settings |= {"fixed": float(fixed[name])}
        elif name in tied:
            settings |= {"tied": tied[name]}
        elif start is not None and name in start and "low" not in settings:
            reach = FAR * max(abs(float(start[name])), 1.0)
            settings |= {"low": start[name] - reach, "high": start[name] + reach}
        elif not settings:
            raise ValueError(
                f"{name} has no bounds; give them, as in {{{name!r}: (0, 10)}}, or a start of "
                "every parameter"
            )
        elif start is not None and name not in start and "fixed" not in settings:
            raise ValueError(f"start: lacks {name}; give a start of every free parameter")
        parameters.append(Parameter(**{"name": name, "unit": unit, **settings}))
    return Space(tuple(parameters))


def _settings(name: str, given: Any) -> dict[str, Any]:
    """The settings of a parameter from the forms that they may have."""
    if given is None:
        return {}
    if isinstance(given, Parameter):
        return vars(given).copy()
    if isinstance(given, Mapping):
        return dict(given)
    if isinstance(given, Sequence) and not isinstance(given, str) and len(given) == 2:
        return {"low": float(given[0]), "high": float(given[1])}
    raise ValueError(f"bounds of {name} are {given!r}; expected (low, high), such as (0, 10)")
