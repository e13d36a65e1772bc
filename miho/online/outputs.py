"""The outputs of a tracked system: models that share parameters and inputs by name."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from miho.identification import CurveFit, Linearised, Report
from miho.identification.dependence import widening
from miho.identification.stated import reported_slopes, reported_space, reported_values
from miho.models.joint import parts_of
from miho.models.layout import PART
from miho.models.model import Model
from miho.models.tied import Tied
from miho.optim.space import Parameter, Space
from miho.quantities import Array
from miho.validate import at_least

TIME = "time"
"""Column of the time of a row [s]."""
NEXT = "_next"
"""Ending of a column's name one step later."""
EXACT = 1e-11
"""Errors up to this share of the largest output are rounding, not noise."""

LEAST = 1e-12
"""Least estimate of sigma of a part of a joint fit, as this share of its largest output."""


@dataclass(frozen=True, eq=False)
class Output:
    """One output: its column with a unit, its model, and the standard deviation of its errors.

    `parameters` are names in the system, in the model's order, and `columns` the offline data.
    """

    column: str
    unit: str
    model: Model
    parameters: tuple[str, ...]
    sigma: float
    columns: Mapping[str, Array]

    def examples(self) -> list[Array]:
        """The input columns of the offline data."""
        return [self.columns[name] for name in self.model.inputs]


@dataclass(frozen=True, eq=False)
class System:
    """All outputs, the parameters with their bounds, and the problems of the outputs."""

    outputs: tuple[Output, ...]
    space: Space
    problems: Sequence[CurveFit]

    @cached_property
    def inputs(self) -> Mapping[str, str]:
        """Units of the input columns of all outputs."""
        return {name: unit for output in self.outputs for name, unit in output.model.inputs.items()}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.space.names

    @cached_property
    def reported(self) -> Space:
        """The parameters as the user stated them, in which constraints leave no shares."""
        return reported_space(self.space)

    def reported_at(self, theta: Array) -> tuple[Array, Array]:
        """Values (d,) of the reported parameters at `theta`, and their derivatives (d, d)."""
        values, slopes = theta.copy(), np.eye(theta.size)
        for problem in self.problems:
            k = [self.names.index(name) for name in problem.space.names]
            values[k] = reported_values(problem, theta[None, k])[0]
            slopes[np.ix_(k, k)] = reported_slopes(problem, theta[k])
        return values, slopes

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of the errors of each output."""
        return np.array([output.sigma for output in self.outputs])

    def states(self, noisy: Collection[str]) -> tuple[str, ...]:
        """The inputs with noise whose values one step later are outputs, as `vy` and `vy_next`."""
        names = [output.column.removesuffix(NEXT) for output in self.outputs]
        later = zip(names, self.outputs, strict=True)
        return tuple(name for name, output in later if name != output.column and name in noisy)

    def with_first(self, states: Collection[str]) -> System:
        """Return the same system whose first outputs are these states one step later."""
        later = {state + NEXT for state in states}
        outputs = sorted(self.outputs, key=lambda output: output.column not in later)
        return replace(self, outputs=tuple(outputs))


def system_of(problems: CurveFit | Sequence[CurveFit], noise: float | None = None) -> System:
    """Return the outputs and parameters of a problem, a joint problem or one problem per output.

    `noise` is the standard deviation of the errors of a problem without sigma. Raises ValueError if
    a model needs all rows in order, if sigma is unknown, or if problems do not agree.
    """
    each = [problems] if isinstance(problems, CurveFit) else problems
    if not isinstance(each, Sequence) or not each or not all(isinstance(p, CurveFit) for p in each):
        raise ValueError(
            f"problem is {problems!r:.60}; expected a CurveFit, one for each output, or a fit"
        )
    outputs = [output for problem in each for output in _outputs(problem, noise)]
    columns = [output.column for output in outputs]
    for name in columns:
        if columns.count(name) > 1:
            raise ValueError(
                f"problem: the output {name!r} occurs twice; expected different outputs"
            )
    return System(tuple(outputs), _common(each), each)


def _outputs(problem: CurveFit, noise: float | None) -> list[Output]:
    parts = parts_of(problem.model)
    if problem.model.ordered:
        raise ValueError(
            f"problem: the model of {problem.name} needs all rows in order; expected a model of "
            "each row alone, as `miho.online.one_step` makes them of a `Trajectory`"
        )
    if not parts:
        data = problem.dataset
        sigma = _sigma(problem, noise)
        names = tuple(problem.model.parameters)
        model = problem.model
        return [Output(data.output, data.units[data.output], model, names, sigma, data.columns)]
    if isinstance(problem.model, Tied):
        raise ValueError(
            f"problem: {problem.name} fixes or ties parameters of several parts; expected a "
            "sequence of problems, one for each output"
        )
    outputs = []
    for k, part in enumerate(parts):
        rows = problem.dataset[PART] == k
        columns = {name: problem.dataset[name][rows] for name in part.model.inputs}
        sigma = float(np.median(problem.dataset[str(problem.sigma)][rows]))
        if _is_rounding(sigma, _largest(problem, rows), problem.sigma_known):
            raise ValueError(
                _exact(part.name, "as the fourth entry of this part of miho.fit_joint")
            )
        unit = part.model.output
        outputs.append(Output(part.name, unit, part.model, part.parameters, sigma, columns))
    return outputs


def _sigma(problem: CurveFit, noise: float | None) -> float:
    """The standard deviation of the errors of an output."""
    if problem.scale is not None and (problem.sigma_known or noise is None):
        return float(problem.scale)
    if noise is None:
        raise ValueError(
            f"problem: {problem.name} has no sigma; give sigma, or its fit as the prior"
        )
    if noise <= EXACT * _largest(problem):
        raise ValueError(_exact(problem.name, "to the fit, as sigma of miho.fit"))
    return float(noise)


def _largest(problem: CurveFit, rows: Any = slice(None)) -> float:
    return float(np.abs(problem.dataset[problem.dataset.output][rows]).max(initial=0.0))


def _is_rounding(sigma: float, largest: float, some_given: bool) -> bool:
    """Whether sigma of a part was estimated from errors that are rounding.

    If sigma of some parts was given, only the least estimate is certain to be none of them.
    """
    least = float(f"{LEAST * largest:.4g}")
    return sigma == least if some_given else sigma <= EXACT * largest


def _exact(name: str, place: str) -> str:
    return (
        f"problem: the fit of {name} has no errors, which leaves the noise of further rows "
        f"unknown; give its standard deviation {place}"
    )


def _common(problems: Sequence[CurveFit]) -> Space:
    """The parameters of all problems; those with the same name must be equal."""
    known: dict[str, Parameter] = {}
    for problem in problems:
        for parameter in problem.space.parameters:
            first = known.setdefault(parameter.name, parameter)
            if (first.low, first.high, first.unit) != (
                parameter.low, parameter.high, parameter.unit,
            ):  # fmt: skip
                raise ValueError(
                    f"problem: {parameter.name} has the bounds {first.low:g} to {first.high:g} "
                    f"{first.unit} and {parameter.low:g} to {parameter.high:g} {parameter.unit}; "
                    "expected the same in all problems"
                )
    return Space(tuple(known.values()))


def noise_of_fits(reports: Iterable[Report]) -> float | None:
    """Return the noise of the first fit that has errors; None without fits."""
    noises = [(noise_of_rows(report.at), EXACT * _largest(report.problem)) for report in reports]
    exact = noises[0][0] if noises else None
    return next((noise for noise, rounding in noises if noise > rounding), exact)


def problem_of(report: Report) -> CurveFit:
    """Return the problem of a report; a known sigma then allows for correlated errors of rows."""
    problem, at = report.problem, report.at
    if not at.noise_known or at.dependence is None or problem.model.ordered:
        return problem
    return problem if parts_of(problem.model) else replace(problem, sigma=noise_of_rows(at))


def noise_of_rows(at: Linearised) -> float:
    """Return the noise of independent rows that say as much as a fit's rows, perhaps correlated."""
    usable = np.isfinite(at.standard_errors) & (at.standard_errors > 0)
    if at.dependence is None or not usable.any():
        return at.noise
    return at.noise * float(np.median(widening(at, np.eye(usable.size)[usable])))


def noise_of(system: System, noise: Mapping[str, float]) -> dict[str, float]:
    """Standard deviations of inputs with noise."""
    for name, deviation in noise.items():
        if name not in system.inputs:
            raise ValueError(
                f"input_noise: no input {name!r}; expected one of {', '.join(system.inputs)}"
            )
        at_least(f"input_noise.{name}", deviation, 0.0)
    return {name: float(deviation) for name, deviation in noise.items() if deviation > 0}
