"""A fit of several datasets or outputs at once, which share parameters."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, NoReturn

import numpy as np

from miho.data.dataset import Dataset
from miho.fitting.dear_fit import JournalPath, as_begun, dear_fit
from miho.fitting.fit_result import Fit
from miho.fitting.joint_problem import Joint, Measured
from miho.fitting.one_fit import without_priors
from miho.fitting.search import searched
from miho.fitting.statement import FAR, data_of
from miho.identification.alternatives import optima_table
from miho.identification.curve_fit import CurveFit
from miho.identification.stated import stated_parameters
from miho.identification.uncertainty import Linearised
from miho.models.joint import PART, parts_of
from miho.models.model import Model
from miho.optim import Budget, Optimizer, Parameter, Space
from miho.parallel import Workers


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
    missing: Literal["raise", "drop"] = "raise",
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    constraints: str | Sequence[str] = (),
    method: Optimizer | str | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    compiled: bool = True,
    workers: Workers = None,
    evaluation_limit: float | None = None,
    journal: JournalPath = None,
) -> JointFit:
    """Fit several datasets, or several outputs of one motion, with parameters in common.

    `parts` are named. A parameter of one name is the same in all parts; one in `local` is one of
    each part's own, called NAME_PART, whose bounds are those of NAME unless it has its own.
    `space`, `missing`, `fixed`, `tied`, `constraints`, `method`, `budget`, `seed`, `compiled`,
    `workers`, `evaluation_limit` and `journal` are those of `miho.fit`.

    A part's sigma that is not given is estimated from its own residuals, see `Joint.complete`.
    Raises ValueError for what does not fit together.
    """
    measured = {}
    for name, (model, x, y, *sigma) in parts.items():
        dataset, chosen, deviation = data_of(
            model, x, y, sigma[0] if sigma else None, missing=missing
        )
        measured[name] = Measured(chosen, dataset, deviation)
    joint = Joint(measured, local)
    bounds = joint.space(space, fixed, tied, constraints)
    plain = without_priors(bounds) if joint.lacking else bounds  # which need sigma
    problem = as_begun(
        lambda dear: joint.problem(plain, compiled=compiled, dear=dear), journal, evaluation_limit
    )
    with dear_fit(problem, workers, evaluation_limit, journal) as evaluations:
        if joint.lacking:
            settings = {"compiled": compiled, "dear": True}
            joint = joint.as_examined(problem)
            problem = joint.complete(bounds, method, budget, seed, evaluations, **settings)
        fit = searched(problem, method, budget, seed, evaluations)
    return JointFit(fit.problem, fit.theta, fit.run, fit.descents, moving=fit.moving)


@dataclass(frozen=True, eq=False)
class JointFit(Fit):
    """A fit of several parts; errors are weighted by sigma, and `scale` is their common unit."""

    def part(self, name: str) -> PartFit:
        """One part's fit, with the values and uncertainties of all parts together."""
        parts = parts_of(self.problem.model)
        names = [part.name for part in parts]
        if name not in names:
            raise ValueError(f"no part {name!r}; choose from {', '.join(names)}")
        part, rows = parts[names.index(name)], self.problem.dataset
        of_part = rows[PART] == names.index(name)
        output = f"output of {name}"
        columns = {key: rows[key][of_part] for key in part.model.inputs}
        columns[output] = rows[rows.output][of_part]
        units = {**part.model.inputs, output: part.model.output}
        optima = tuple(_of_parameters(self.problem, at, part.parameters) for at in self._optima)
        values = optima[0].theta
        # The space only says that these values are inside.
        parameters = zip(part.model.parameters.items(), values, strict=True)
        space = Space(
            tuple(Parameter(n, u, v - FAR * (1 + abs(v)), v + FAR * (1 + abs(v)))
                  for (n, u), v in parameters)
        )  # fmt: skip
        fit = PartFit(
            CurveFit(part.model, Dataset(name, columns, units, output), space, compiled=False),
            values, values, joint=self, name=name,
        )  # fmt: skip
        alternatives = optima_table(fit.problem, optima)
        if len(alternatives):
            alternatives["excess"] = self.alternatives["excess"]
        vars(fit).update(
            uncertainty=optima[0], _optima=optima, alternatives=alternatives,
            _standing=self._standing, caveats=self.caveats,
        )  # fmt: skip
        return fit


@dataclass(frozen=True, eq=False)
class PartFit(Fit):
    """One part of a `joint` fit, whose uncertainties are those of all parts together."""

    joint: JointFit = field(kw_only=True)
    name: str = field(kw_only=True)

    def __reduce__(self) -> tuple[Any, ...]:
        """The joint fit, of which it is made again."""
        return JointFit.part, (self.joint, self.name)

    def report(self, **settings: Any) -> NoReturn:
        """Raises ValueError: a report of these data alone would have other values."""
        self._refuse("report")

    def posterior(self, **settings: Any) -> NoReturn:
        """Raises ValueError: a posterior of these data alone would be another one."""
        self._refuse("posterior")

    def _refuse(self, what: str) -> NoReturn:
        raise ValueError(f"{what}: part {self.name!r} needs the joint fit; call it there")


def _of_parameters(problem: CurveFit, at: Linearised, names: Sequence[str]) -> Linearised:
    """The uncertainty of the parameters of a part, some of which may be fixed or tied."""
    stated, slopes = stated_parameters(problem, at)
    places = [[parameter.name for parameter in stated].index(name) for name in names]
    values = np.array([stated[k].value for k in places])
    errors = np.array([stated[k].standard_error for k in places])
    mapped = at.mapped(values, slopes[places], np.isnan(errors), np.isinf(errors))
    return replace(mapped, dependence=None)
