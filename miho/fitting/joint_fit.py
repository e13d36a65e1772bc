"""A fit of several datasets or outputs at once, which share parameters."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from miho.data.dataset import Dataset
from miho.fitting.one_fit import Fit, searched, without_priors
from miho.fitting.statement import FAR, data_of, space_of
from miho.identification.constraints import constrained
from miho.identification.curve_fit import CurveFit
from miho.identification.curve_fit_checks import traced_where_alike
from miho.identification.refit import refit
from miho.identification.stated import stated_parameters
from miho.identification.uncertainty import linearised
from miho.models.function_model import FunctionModel
from miho.models.joint import PART, JointModel, JointPart
from miho.models.model import Model
from miho.models.tied import whole_model
from miho.optim import Budget, Optimizer, Parameter, Space
from miho.quantities import Array

OUTPUT, SIGMA = "output of the part", "sigma of the row"
SETTLED, ROUNDS = 1e-3, 20
"""Deviations of the parts are estimated until they change by less than this share, in so many
rounds at most."""


class Part(NamedTuple):
    """One output over its columns: model, `x`, `y` and `sigma` are those of `miho.fit`."""

    model: Model | Callable[..., Any]
    x: Any
    y: Any
    sigma: Any = None


def fit_joint(
    parts: Mapping[str, Part | tuple[Any, ...]],
    space: Space | Mapping[str, Any],
    *,
    local: Collection[str] = (),
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    constraints: str | Sequence[str] = (),
    method: Optimizer | None = None,
    budget: Budget | None = None,
    seed: int = 0,
) -> JointFit:
    """Fit several datasets, or several outputs of one motion, with parameters in common.

    `parts` are named. A parameter of one name is the same in all parts; one in `local` is one of
    each part's own, called NAME_PART, whose bounds are those of NAME unless it has its own.
    `space`, `fixed`, `tied`, `constraints`, `method`, `budget` and `seed` are those of `miho.fit`.

    Without sigma each part's is estimated from its own residuals, alternately with the parameters
    (Seber and Wild, Nonlinear Regression, 1989, Ch. 11.1, for independent outputs). Give `sigma` of
    all parts or of none. Raises ValueError for what does not fit together.
    """
    stated = {name: Part(*part) for name, part in parts.items()}
    if len(stated) < 2:
        raise ValueError(f"{len(stated)} part; give at least two, or use miho.fit")
    has_sigma = [part.sigma is not None for part in stated.values()]
    if any(has_sigma) and not all(has_sigma):
        lacking = [name for name, has in zip(stated, has_sigma, strict=True) if not has]
        raise ValueError(f"{', '.join(lacking)}: lacks sigma, which other parts have; give it too")
    datasets, members = [], []
    for name, part in stated.items():
        dataset, model, _ = data_of(part.model, part.x, part.y, None)
        names = tuple(f"{p}_{name}" if p in local else p for p in model.parameters)
        datasets.append(dataset)
        members.append(JointPart(name, model, names))
    model = JointModel(tuple(members))
    for name in local:
        if not any(name in part.model.parameters for part in members):
            raise ValueError(f"local: {name} is no parameter of any part")
    whole = space_of(model, _with_local(space, local, members), None, fixed or {}, tied or {})
    bounds = constrained(whole, constraints)
    named = {parameter.name: parameter for parameter in bounds.parameters}
    for k, (member, dataset) in enumerate(zip(members, datasets, strict=True)):
        if isinstance(member.model, FunctionModel):
            own = zip(member.model.parameters, member.parameters, strict=True)
            ranges = Space(tuple(replace(named[joint], name=name) for name, joint in own))
            members[k] = member._replace(model=traced_where_alike(member.model, dataset, ranges))
    model = JointModel(tuple(members))
    sigma = [np.asarray(p.sigma, dtype=float) for p in stated.values()] if all(has_sigma) else None
    if sigma is None:
        sigma = _estimated(model, datasets, bounds, method, budget, seed)
    problem = _problem(model, datasets, bounds, sigma, known=all(has_sigma))
    fit = searched(problem, method, budget, seed)
    return JointFit(fit.problem, fit.theta, fit.run, fit.descents)


@dataclass(frozen=True, eq=False)
class JointFit(Fit):
    """A fit of several parts; errors are weighted by sigma, and `scale` is their common unit."""

    def part(self, name: str) -> Fit:
        """One part's fit, with the values and uncertainties of all parts together."""
        model = whole_model(self.problem.model)
        if not isinstance(model, JointModel):
            raise TypeError("a joint fit is of a joint model")
        names = [part.name for part in model.parts]
        if name not in names:
            raise ValueError(f"no part {name!r}; choose from {', '.join(names)}")
        part, rows = model.parts[names.index(name)], self.problem.dataset
        of_part = rows[PART] == names.index(name)
        columns = {key: rows[key][of_part] for key in (*part.model.inputs, rows.output)}
        units = {**part.model.inputs, rows.output: part.model.output}
        stated, slopes = stated_parameters(self.problem, self.uncertainty)
        places = [[parameter.name for parameter in stated].index(p) for p in part.parameters]
        values, own = np.array([stated[k].value for k in places]), slopes[places]
        # The space only says that these values are inside.
        parameters = zip(part.model.parameters.items(), values, strict=True)
        space = Space(
            tuple(Parameter(n, u, v - FAR * (1 + abs(v)), v + FAR * (1 + abs(v)))
                  for (n, u), v in parameters)
        )  # fmt: skip
        fit = Fit(
            CurveFit(part.model, Dataset(name, columns, units, rows.output), space, compiled=False),
            values, values,
        )  # fmt: skip
        errors = np.array([stated[k].standard_error for k in places])
        vars(fit)["uncertainty"] = replace(
            self.uncertainty.mapped(values, own, ~np.isfinite(errors), np.isinf(errors)),
            dependence=None,
        )
        return fit


def _with_local(
    space: Space | Mapping[str, Any], local: Collection[str], parts: list[JointPart]
) -> dict[str, Any]:
    """Bounds by name, those of a local parameter under the name of each part's own."""
    ranges: dict[str, Any] = dict(space) if isinstance(space, Mapping) else {}
    if isinstance(space, Space):
        ranges = {parameter.name: parameter for parameter in space.parameters}
    bounds = {name: value for name, value in ranges.items() if name not in local}
    for part in parts:
        for name in part.model.parameters:
            if name in local and name in ranges:
                value = ranges[name]
                if isinstance(value, Parameter):
                    value = replace(value, name=f"{name}_{part.name}")
                bounds.setdefault(f"{name}_{part.name}", value)
    return bounds


def _problem(
    model: JointModel, datasets: list[Dataset], bounds: Space, sigma: list[Array], known: bool
) -> CurveFit:
    """All rows below each other; columns that a part does not read are 0 there."""
    columns: dict[str, list[Array]] = {name: [] for name in (*model.inputs, OUTPUT, SIGMA)}
    for k, (part, dataset, deviation) in enumerate(zip(model.parts, datasets, sigma, strict=True)):
        rows = len(dataset)
        own = {name: dataset[name] for name in part.model.inputs}
        own |= {PART: np.full(rows, float(k)), OUTPUT: dataset[dataset.output]}
        own[SIGMA] = np.broadcast_to(deviation, rows)
        for name, values in columns.items():
            values.append(own.get(name, np.zeros(rows)))
    units = {**model.inputs, OUTPUT: model.output, SIGMA: model.output}
    stacked = {name: np.concatenate(values) for name, values in columns.items()}
    dataset = Dataset("joint", stacked, units, OUTPUT)
    mean = float(1 / np.sqrt(np.mean(1 / dataset[SIGMA] ** 2)))
    return CurveFit(
        model, dataset, bounds, sigma=SIGMA, sigma_known=known, compiled=False, prior_scale=mean
    )


def _estimated(
    model: JointModel,
    datasets: list[Dataset],
    bounds: Space,
    method: Optimizer | None,
    budget: Budget | None,
    seed: int,
) -> list[Array]:
    """The standard deviation of each part's errors."""
    sizes = np.array([len(dataset) for dataset in datasets])
    outputs = [dataset[dataset.output] for dataset in datasets]
    sigma = [np.asarray(max(float(np.std(y)), np.finfo(float).tiny)) for y in outputs]
    plain = without_priors(bounds)
    if plain != bounds:
        sigma = _estimated(model, datasets, plain, method, budget, seed)
    problem = _problem(model, datasets, bounds, sigma, known=False)
    fit = searched(problem, method, budget, seed)
    for _ in range(ROUNDS):
        errors = fit.problem.model.predict(fit.theta[None], *fit.problem.inputs)[0]
        errors -= fit.problem.dataset[OUTPUT]
        squares = [part @ part for part in np.split(errors, np.cumsum(sizes)[:-1])]
        # Each part's share of the parameters is that of its rows; priors know a part of them.
        count = fit.theta.size
        if fit.problem.prior is not None:
            count = sizes.sum() - linearised(fit.problem, fit.theta).freedom
        freedom = sizes * max(1 - count / sizes.sum(), np.finfo(float).eps)
        before = np.array(sigma, dtype=float)
        least = 1e-12 * np.array([float(np.abs(y).max(initial=0.0)) for y in outputs])
        now = np.maximum(np.sqrt(np.array(squares) / freedom), np.maximum(least, 1e-300))
        sigma = [np.asarray(value) for value in now]
        problem = _problem(model, datasets, bounds, sigma, known=False)
        fit = replace(fit, problem=problem, theta=refit(problem, fit.theta).theta)
        if np.abs(now / before - 1).max() < SETTLED:
            break
    return sigma
