"""The problem of a joint fit: several datasets or outputs that share parameters by name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from miho.data.dataset import Dataset
from miho.data.stacking import stacked_columns
from miho.fitting.arguments import named, space_of
from miho.fitting.fit_result import Fit
from miho.fitting.search import searched, spread
from miho.identification import CurveFit, Loss, Square, linearised
from miho.identification.constraints import constrained
from miho.identification.curve_fit_checks import SMALLEST, examined
from miho.identification.refit import refit
from miho.models import FunctionModel, Model
from miho.models.joint import JointModel, JointPart, joined, parts_of
from miho.models.layout import PART
from miho.optim import Parameter, Space
from miho.quantities import Array
from miho.units import differ
from miho.validate import is_number

if TYPE_CHECKING:
    from miho.parallel import Evaluations

OUTPUT, SIGMA = "output of the part", "sigma of the row"
SETTLED, ROUNDS = 1e-3, 20
"""Standard deviations of the parts are estimated until they change by less than this share, with a
largest number of rounds."""


class Measured(NamedTuple):
    """A model, its data, and sigma of the output: a number, the name of a column, or None."""

    model: Model
    dataset: Dataset
    sigma: str | float | None = None


@dataclass(frozen=True, eq=False)
class Joint:
    """Several parts with common parameters.

    Parameters
    ----------
    parts : mapping of str to Measured
        The parts by name, at least two.
    local : collection of str
        Parameters with a separate value in each part, named NAME_PART.
    known : bool
        Whether given sigmas are absolute; else they share one unknown factor.

    Raises
    ------
    ValueError
        For fewer than two parts, for a local parameter that no part has, and for a sigma that is
        not a positive number or a column of positive numbers.
    """

    parts: Mapping[str, Measured]
    local: Collection[str] = ()
    known: bool = True

    def __post_init__(self) -> None:
        if len(self.parts) < 2:
            raise ValueError(
                f"parts: expected at least two, got {len(self.parts)}; use miho.fit for one"
            )
        for name in self.local:
            if not any(name in part.model.parameters for part in self.parts.values()):
                raise ValueError(f"local: {name} is not a parameter of any part; remove it")
        for name, part in self.parts.items():
            for own in self._shared & {
                f"{p}_{name}" for p in self.local if p in part.model.parameters
            }:
                raise ValueError(
                    f"local: {own} is also a parameter that is not local; rename part {name!r}"
                )
            _check_units(name, part)
        _ = self.dataset  # raises for an invalid sigma

    @cached_property
    def model(self) -> JointModel:
        """The model of all parts, with joint names of the parameters."""
        parts = []
        for part, (model, *_) in self.parts.items():
            names = (f"{p}_{part}" if p in self.local else p for p in model.parameters)
            parts.append(JointPart(part, model, tuple(names)))
        return JointModel(tuple(parts))

    @cached_property
    def _shared(self) -> set[str]:
        """Parameters of the parts that are not local."""
        return {p for part in self.parts.values() for p in part.model.parameters} - {*self.local}

    @property
    def lacking(self) -> list[str]:
        """The parts without sigma."""
        return [name for name, part in self.parts.items() if part.sigma is None]

    @cached_property
    def dataset(self) -> Dataset:
        """All rows below each other, including held-out rows.

        Columns that a part does not read are 0. Conditions that all parts have in common stay. The
        sigma of a part without one is the standard deviation of its output.
        """
        rows = self._stacked([part.dataset for part in self.parts.values()])
        held_out = [part.dataset.held_out for part in self.parts.values()]
        if all(part is None for part in held_out):
            return rows
        return replace(rows, held_out=self._stacked(held_out))

    def _stacked(self, datasets: Sequence[Dataset | None]) -> Dataset:
        units = {**self._conditions, **self.model.inputs}
        units |= {OUTPUT: self.model.output, SIGMA: self.model.output}
        parts = [
            self._columns(name, dataset) for name, dataset in zip(self.parts, datasets, strict=True)
        ]
        return Dataset("joint", stacked_columns(parts, PART), units, OUTPUT)

    def _columns(self, name: str, dataset: Dataset | None) -> dict[str, Array]:
        """The columns of a part; empty without a dataset."""
        part = self.parts[name]
        if dataset is None:
            return {OUTPUT: np.zeros(0)}
        columns = {key: dataset[key] for key in (*self._conditions, *part.model.inputs)}
        columns[OUTPUT] = dataset[dataset.output]
        return {**columns, SIGMA: deviations(name, part._replace(dataset=dataset))}

    @cached_property
    def _conditions(self) -> dict[str, str]:
        """Columns that all parts have in common, with units, without outputs and sigmas."""
        datasets = [part.dataset for part in self.parts.values()]
        explained = {p.dataset.output for p in self.parts.values()}
        explained |= {p.sigma for p in self.parts.values() if isinstance(p.sigma, str)}
        shared = set.intersection(*(set(dataset.units.items()) for dataset in datasets))
        return {
            name: unit
            for name, unit in datasets[0].units.items()
            if (name, unit) in shared and name not in explained
        }

    def space(
        self,
        bounds: Space | Mapping[str, Any],
        fixed: Mapping[str, float] | None = None,
        tied: Mapping[str, str] | None = None,
        constraints: str | Sequence[str] = (),
        start: Mapping[str, float] | None = None,
    ) -> Space:
        """The space from `bounds` by name; NAME_PART has the bounds of NAME by default."""
        fixed = self.with_local(fixed or {})
        whole = space_of(self.model, self.with_local(bounds), start, fixed, tied or {})
        return constrained(whole, constraints)

    def rho(self, loss: Loss | str | None) -> Loss:
        """A loss, possibly by name; raises ValueError for a robust one if a part lacks sigma."""
        from miho.fitting.named import loss_of

        rho = loss_of(loss, self.dataset[SIGMA])
        self._check_scale(rho)
        return rho

    def problem(self, space: Space, **settings: Any) -> CurveFit:
        """The problem within a space of all parameters; `settings` go to `CurveFit`."""
        model = self._traced(space, settings.get("expensive", False))
        return CurveFit(
            model, self.dataset, space, sigma=SIGMA, sigma_known=self._known, **settings
        )

    @property
    def _known(self) -> bool:
        """Whether sigma is absolute: it is not if all parts lack it."""
        return self.known and len(self.lacking) < len(self.parts)

    def with_local(self, bounds: Space | Mapping[str, Any]) -> dict[str, Any]:
        """Bounds or other values by name; a local parameter has its value in each part."""
        ranges = named(bounds)
        own = {name: value for name, value in ranges.items() if name not in self.local}
        for part in self.model.parts:
            for name, joint in zip(part.model.parameters, part.parameters, strict=True):
                if name in self.local and name in ranges:
                    value = ranges[name]
                    if isinstance(value, Parameter):
                        value = replace(value, name=joint)
                    own.setdefault(joint, value)
        return own

    def _traced(self, space: Space, expensive: bool) -> Model:
        """The model with functions replaced by formulas where possible, as one formula if it is."""
        named = {parameter.name: parameter for parameter in space.parameters}
        members = []
        for part in self.model.parts:
            model = part.model
            if isinstance(model, FunctionModel):
                own = zip(model.parameters, part.parameters, strict=True)
                ranges = Space(tuple(replace(named[joint], name=name) for name, joint in own))
                model = examined(model, self.parts[part.name].dataset, ranges, expensive)
            members.append(part._replace(model=model))
        return joined(JointModel(tuple(members)))

    def complete(
        self,
        space: Space,
        solve: Callable[[CurveFit], Fit] = searched,
        evaluations: Evaluations | None = None,
        **settings: Any,
    ) -> CurveFit:
        """The problem within a space of all parameters, with sigma of all parts.

        A missing sigma is estimated from the residuals of its part, alternately with the parameters
        (Seber and Wild, Nonlinear Regression, 1989, Ch. 11.1, for independent outputs). It is
        rounded to four digits, so it is the same on every machine. If there are priors, a first
        estimate ignores them. Raises ValueError if a part has too few rows.
        """
        if not self.lacking:
            return self.problem(space, **settings)
        self._check_scale(settings.get("rho"))
        self._check_estimable()
        joint = self
        if space.has_priors:
            plain = self.complete(space.without_priors, solve, evaluations, **settings)
            rows = plain.dataset[PART]
            first = {name: float(plain.dataset[SIGMA][rows == k][0])
                     for k, name in enumerate(self.parts) if name in self.lacking}  # fmt: skip
            joint = self._with(first, parts_of(plain.model))
        problem = joint.problem(space, prior_scale=joint._scale, **settings)
        fit = solve(problem)
        models = parts_of(fit.problem.model)  # traced once
        for _ in range(ROUNDS):
            whole = spread(fit.problem, evaluations)
            sigma = self._residual_deviations(replace(fit, problem=whole))
            before = {name: deviations(name, joint.parts[name])[0] for name in sigma}
            joint = self._with(sigma, models)
            problem = joint.problem(space, prior_scale=joint._scale, **settings)
            theta = refit(spread(problem, evaluations), fit.theta).theta
            fit = replace(fit, problem=problem, theta=theta)
            if all(abs(sigma[name] / before[name] - 1) < SETTLED for name in sigma):
                break
        return problem

    def as_examined(self, problem: CurveFit) -> Joint:
        """The same parts with the models of `problem`, whose functions were examined already."""
        return self._with({}, parts_of(problem.model))

    def _with(self, sigma: Mapping[str, float], models: Sequence[JointPart]) -> Joint:
        """The same parts with these models, and with sigma for the parts that lacked it."""
        parts = {
            part.name: Measured(part.model, own.dataset, sigma.get(part.name, own.sigma))
            for part, own in zip(models, self.parts.values(), strict=True)
        }
        return Joint(parts, self.local, self._known)

    @property
    def _scale(self) -> float:
        """The standard deviation of all rows, which sets the weight of priors."""
        return float(1 / np.sqrt(np.mean(1 / self.dataset[SIGMA] ** 2)))

    def _check_scale(self, rho: Loss | None) -> None:
        if self.lacking and not isinstance(rho, Square | None):
            raise ValueError(
                f"{self.lacking[0]}: lacks sigma, which a robust loss needs; give sigma"
            )

    def _check_estimable(self) -> None:
        for name in self.lacking:
            rows, parameters = len(self.parts[name].dataset), len(self.parts[name].model.parameters)
            if rows <= parameters:
                raise ValueError(
                    f"{name}: {rows} rows for {parameters} parameters do not determine sigma; give "
                    "sigma"
                )

    def _residual_deviations(self, fit: Fit) -> dict[str, float]:
        """Standard deviations of the parts that lack sigma, from their residuals."""
        weights, index = fit.problem.weights, self.dataset[PART]
        errors = fit.problem.errors(fit.theta) / (1.0 if weights is None else weights)
        # Parameters count in proportion to the rows of a part; priors supply some of them.
        count = float(fit.theta.size)
        if fit.problem.prior is not None:
            count = errors.size - linearised(fit.problem, fit.theta).freedom
        freedom = max(1 - count / errors.size, np.finfo(float).eps)
        sigma = {}
        for k, name in enumerate(self.parts):
            if name in self.lacking:
                own = index == k
                largest = _size(self.dataset[OUTPUT][own])
                square = float(np.mean(errors[own] ** 2)) / freedom
                sigma[name] = float(f"{max(np.sqrt(square), 1e-12 * largest):.4g}")
        return sigma


def _check_units(name: str, part: Measured) -> None:
    """Refuse data that lack an input of the model or have other units."""
    needed = {**part.model.inputs, part.dataset.output: part.model.output}
    for column, unit in needed.items():
        _ = part.dataset[column]
        own_unit = part.dataset.units[column]
        if differ(own_unit, unit):
            raise ValueError(f"{name}: column {column!r} has unit {own_unit!r}; expected {unit!r}")


def _size(output: Array) -> float:
    """The largest magnitude, or 1 if all numbers are 0."""
    largest = float(np.abs(output).max(initial=0.0))
    return largest if largest > SMALLEST else 1.0


def deviations(name: str, part: Measured) -> Array:
    """Sigma (N,) of the rows of a part, by default the standard deviation of its output."""
    dataset, sigma = part.dataset, part.sigma
    output = dataset[dataset.output]
    if sigma is None:
        spread = float(np.std(output))
        return np.full(output.size, spread if spread > SMALLEST else _size(output))
    if isinstance(sigma, str):
        unit, needed = dataset.units.get(sigma, ""), dataset.units[dataset.output]
        if differ(unit, needed):
            label = "sigma" if sigma == "sigma" else f"sigma {sigma!r}"
            raise ValueError(
                f"{name}: {label} has the unit {unit!r}; expected {needed!r}, the unit of "
                f"{dataset.output!r}"
            )
        values = dataset[sigma]
    elif is_number(sigma):
        values = np.full(output.size, float(sigma))
    else:
        raise ValueError(f"{name}: sigma is {sigma!r}; expected a number or a column's name")
    wrong = np.flatnonzero(~((values > 0) & (values < np.inf)))
    if wrong.size:
        raise ValueError(
            f"{name}: sigma is {values[wrong[0]]:g} in row {wrong[0] + 1}; expected numbers above 0"
        )
    return values
