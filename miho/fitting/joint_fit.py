"""A joint fit of several datasets or outputs that share parameters."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, NoReturn

import numpy as np

from miho.data.dataset import Dataset
from miho.fitting.arguments import NEAR, by_label, data_of
from miho.fitting.datasets import check_bounds, largest_values
from miho.fitting.expensive_fit import JournalPath, as_begun, expensive_fit
from miho.fitting.fit_result import Fit
from miho.fitting.joint_problem import Joint, Measured
from miho.fitting.one_descent import descended
from miho.fitting.search import searched
from miho.identification import CurveFit, Linearised, Loss
from miho.identification.alternatives import optima_table
from miho.identification.stated import stated_parameters
from miho.models.joint import parts_of
from miho.models.layout import PART
from miho.models.model import Model
from miho.optim import Budget, Optimizer, Parameter, Space
from miho.parallel import Workers
from miho.validate import one_of


class Part(NamedTuple):
    """One dataset or output of a joint fit.

    Parameters
    ----------
    model : Model or callable
        A model, or a function of input columns and parameters, as in `miho.fit`.
    x : array_like, tuple, mapping or DataFrame
        Input columns, (N,) each.
    y : array_like of shape (N,) or str
        Measured output, or the name of its column in `x`.
    sigma : float, array_like of shape (N,) or str, optional
        Standard deviation of the errors of `y`, in the same unit. By default `fit_joint` estimates
        it from the residuals of the part.
    convention, ranges : optional
        Sign convention and plausible ranges of the data of a tire, as in `miho.fit`.
    """

    model: Model | Callable[..., Any]
    x: Any
    y: Any
    sigma: Any = None
    convention: str = "iso-w"
    ranges: Mapping[str, Sequence[float] | None] | None = None


def fit_joint(
    parts: Mapping[str, Part | tuple[Any, ...]],
    space: Space | Mapping[str, Any] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    local: str | Collection[str] = (),
    missing: Literal["raise", "drop"] = "raise",
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    constraints: str | Sequence[str] = (),
    loss: Loss | str | None = None,
    method: Optimizer | str | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    compiled: bool = True,
    workers: Workers = None,
    evaluation_limit: float | None = None,
    journal: JournalPath = None,
) -> JointFit:
    """Fit several datasets, or several outputs of one motion, with common parameters.

    A parameter has the same value in all parts that have a parameter of its name, unless it is
    `local`.

    Parameters
    ----------
    parts : mapping of str to Part or tuple
        The parts by name: model, x, y and optionally sigma of each, and for a tire the other
        fields of `Part`. A missing sigma is estimated from the residuals of its part, in turn with
        the parameters [1]_.
    space : Space or mapping of str, optional
        Bounds of all parameters by name, as in `miho.fit`.
    start : mapping of str to float, optional
        A start of every free parameter, for descents in place of a search, as in `miho.fit`.
    local : str or collection of str, optional
        Parameters with a separate value in each part. The value of parameter NAME in part PART has
        the name NAME_PART. It has the bounds, the start or the fixed value of NAME unless NAME_PART
        has its own.
    missing, fixed, tied, constraints : optional
        As in `miho.fit`.
    loss : Loss or str, optional
        Loss of a residual, as in `miho.fit`. A robust loss needs the sigma of all parts, and its
        scale is for errors weighted by sigma with a mean weight of 1; "huber" and "cauchy" set it.
    method, budget, seed, compiled, workers, evaluation_limit, journal : optional
        As in `miho.fit`.

    Returns
    -------
    JointFit
        The fit; `part(name)` gives the fit of one part.

    Raises
    ------
    ValueError
        If there are fewer than two parts, if parts, parameters and data do not fit together, or if
        the search finds no finite value.

    References
    ----------
    .. [1] Seber and Wild, Nonlinear Regression, 1989, Ch. 11.1.

    Examples
    --------
    Two lines with a common slope `b`:

    >>> import numpy as np
    >>> import miho
    >>> def line(t, a, b):
    ...     return a + b * t
    >>> t = np.linspace(0.0, 1.0, 11)
    >>> parts = {"low": (line, t, 1 + 2 * t, 0.1), "high": (line, t, 3 + 2 * t, 0.1)}
    >>> fit = miho.fit_joint(parts, {"a": (0, 5), "b": (0, 5)}, local=["a"])
    >>> {name: round(value, 6) for name, value in fit.values.items()}
    {'a_low': 1.0, 'b': 2.0, 'a_high': 3.0}
    """
    if not isinstance(parts, Mapping):
        raise ValueError(f"parts are a {type(parts).__name__}; give them by name: {{'left': ...}}")
    check_bounds(space)
    start, fixed = by_label("start", start), by_label("fixed", fixed)
    tied = by_label("tied", tied)
    if start is not None and not (method is None and budget is None):  # else the search checks
        from miho.fitting.named import method_of

        method = method_of(method, budget)
    local = [local] if isinstance(local, str) else local
    largest = largest_values((space, tied, start, fixed))
    measured = {}
    for name, fields in parts.items():
        own = {each: largest[f"{each}_{name}"] for each in local if f"{each}_{name}" in largest}
        measured[name] = _measured(name, fields, missing, largest | own)
    joint = Joint(measured, local)
    start = None if start is None else joint.with_local(start)
    rho = joint.rho(loss)
    bounds = joint.space(space or {}, fixed, tied, constraints, start)
    plain = bounds.without_priors if joint.lacking else bounds  # priors need sigma
    problem = as_begun(
        lambda expensive: joint.problem(plain, rho=rho, compiled=compiled, expensive=expensive),
        journal,
        evaluation_limit,
    )
    with expensive_fit(problem, workers, evaluation_limit, journal) as evaluations:

        def solved(problem: CurveFit) -> Fit:
            if start is not None:
                return descended(problem, start, evaluations)
            return searched(problem, method, budget, seed, evaluations)

        if joint.lacking:
            settings = {"compiled": compiled, "expensive": True}
            joint = joint.as_examined(problem)
            problem = joint.complete(bounds, solved, evaluations, **settings)
        fit = solved(problem)
    return JointFit(fit.problem, fit.theta, fit.run, fit.descents, moving=fit.moving)


def _measured(
    name: str, fields: Part | tuple[Any, ...], missing: str, largest: Mapping[str, float]
) -> Measured:
    """A part with its data; errors name the part."""
    if not isinstance(name, str) or not name:
        raise ValueError(f"parts: {name!r} is no name; give the parts by names such as 'left'")
    if not isinstance(fields, tuple | list) or not 3 <= len(fields) <= len(Part._fields):
        size = f" of {len(fields)} entries" if isinstance(fields, tuple | list) else ""
        raise ValueError(
            f"{name}: expected (model, x, y) or (model, x, y, sigma), got a "
            f"{type(fields).__name__}{size}"
        )
    part = Part(*fields)
    # A parameter of one part may be a column of the function of another one.
    stated = [largest] if isinstance(part.model, Model) else ()
    try:
        dataset, model, sigma = data_of(
            part.model, part.x, part.y, part.sigma, missing, part.convention, part.ranges, stated
        )
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    return Measured(model, dataset, sigma)


@dataclass(frozen=True, eq=False)
class JointFit(Fit):
    """The result of `fit_joint`; errors are weighted by sigma, and `scale` is their common unit."""

    def part(self, name: str) -> PartFit:
        """The fit of the part of this name, with values and uncertainties from the joint fit."""
        parts = parts_of(self.problem.model)
        names = [part.name for part in parts]
        one_of("part", name, names)
        part, rows = parts[names.index(name)], self.problem.dataset
        of_part = rows[PART] == names.index(name)
        output = f"output of {name}"
        columns = {key: rows[key][of_part] for key in part.model.inputs}
        columns[output] = rows[rows.output][of_part]
        units = {**part.model.inputs, output: part.model.output}
        optima = tuple(_of_parameters(self.problem, at, part.parameters) for at in self._optima)
        values = optima[0].theta
        known = self.parameters.loc[list(part.parameters)].set_axis([*part.model.parameters])
        # A space around these values: far from them, a simulation may have no value at any row.
        own = list[Parameter]()
        for (key, unit), value, status in zip(
            part.model.parameters.items(), values, known["status"], strict=True
        ):
            near = NEAR * (abs(value) or 1.0)
            low = value - near * (status != "at lower bound")
            own.append(Parameter(key, unit, low, value + near * (status != "at upper bound")))
        fit = PartFit(
            CurveFit(part.model, Dataset(name, columns, units, output), Space(tuple(own)),
                     compiled=False),
            values, values, joint=self, name=name,
        )  # fmt: skip
        alternatives = optima_table(fit.problem, optima)
        if len(alternatives):
            alternatives["excess"] = self.alternatives["excess"]
        others = tuple(f"{other}: " for other in names if other != name)
        vars(fit).update(
            parameters=known, uncertainty=optima[0], _optima=optima, alternatives=alternatives,
            _conclusion=self._conclusion,
            caveats=[caveat for caveat in self.caveats if not caveat.startswith(others)],
        )  # fmt: skip
        return fit


@dataclass(frozen=True, eq=False)
class PartFit(Fit):
    """One part of a `joint` fit, with values and uncertainties from all parts together."""

    joint: JointFit = field(kw_only=True)
    name: str = field(kw_only=True)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the joint fit and the name of the part."""
        return JointFit.part, (self.joint, self.name)

    def report(self, **settings: Any) -> NoReturn:
        """Raise ValueError: a report on the data of one part alone would have other values."""
        self._refuse("report")

    def posterior(self, **settings: Any) -> NoReturn:
        """Raise ValueError: a posterior from the data of one part alone would differ."""
        self._refuse("posterior")

    def _refuse(self, what: str) -> NoReturn:
        raise ValueError(
            f"{what}: part {self.name!r} needs the joint fit; call {what} of the joint fit"
        )


def _of_parameters(problem: CurveFit, at: Linearised, names: Sequence[str]) -> Linearised:
    """The uncertainty of the parameters of a part; some of them may be fixed or tied."""
    stated, slopes = stated_parameters(problem, at)
    places = [[parameter.name for parameter in stated].index(name) for name in names]
    values = np.array([stated[k].value for k in places])
    errors = np.array([stated[k].standard_error for k in places])
    mapped = at.mapped(values, slopes[places], np.isnan(errors), np.isinf(errors))
    return replace(mapped, dependence=None)
