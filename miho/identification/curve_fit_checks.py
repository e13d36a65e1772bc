"""Checks that model, data and space fit together, and that the model is as it declares."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from miho.data.dataset import Dataset
from miho.identification.loss import Square
from miho.models.function_calls import UNTRIED
from miho.models.function_model import FunctionFormula, FunctionModel
from miho.models.model import DifferencedModel, ExternalModel, Model, expensive_leaves
from miho.optim.space import Parameter, Space
from miho.parallel.worth import is_expensive
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.curve_fit import CurveFit

TRIALS = 5
"""Number of trial configurations of a new problem."""
RAISING = 1000
"""A model is refused if it raises at this number of configurations."""
LINEAR = 1e-9
"""Relative tolerance for the value of a linear model halfway: the mean of both ends."""
FAR = 2.0
"""A nominal value is far from the data if it is beyond them by more than this factor."""
SMALLEST, LARGEST = 1e-140, 1e150
"""Range of the largest magnitude of the output. Its square, the square of its rounding and the sum
of squares over all rows then stay within double precision, 1e-308 to 1e308."""


def check_curve_fit(problem: CurveFit, expensive: bool = False) -> None:
    """Raise ValueError for parts that do not fit together; warn about far nominal values.

    Mistakes show before a search starts, instead of as losses without a value. The check evaluates
    the model at a few configurations: at a single one if that takes long, and at none if the model
    is known to be expensive (`expensive`).
    """
    model, dataset = problem.model, problem.dataset
    model_name = model.name or type(model).__name__
    if problem.space.names != tuple(model.parameters):
        raise ValueError(space_mismatch(model_name, list(model.parameters), problem.space.names))
    if model.ordered and dataset.held_out is not None and not expensive:  # may be unknown yet
        raise ValueError(f"{model_name} needs every row in order; expected no held-out rows")
    _ = problem.inputs  # raises for a column that the data lack

    # Units of space, data and model agree.
    declared = {f"parameter {p.name!r} of the space": p.unit for p in problem.space.parameters}
    declared |= {f"column {name!r} of {dataset.name}": dataset.units[name] for name in model.inputs}
    declared |= {f"output {dataset.output!r} of {dataset.name}": problem.unit}
    needed_units = (*model.parameters.values(), *model.inputs.values(), model.output)
    for (place, unit), needed in zip(declared.items(), needed_units, strict=True):
        if unit != needed and needed and unit:
            raise ValueError(f"{place} has unit {unit!r}; model {model_name} needs {needed!r}")

    _check_output_size(problem)
    if isinstance(model, FunctionFormula):  # which was compared with its function
        _check_values(problem, model_name)
    elif not expensive and not any(
        isinstance(leaf, FunctionModel) and leaf.tried.expensive for leaf in expensive_leaves(model)
    ):
        theta = _usable(problem, model_name)
        if theta is not None:
            _check_shapes(problem, model_name, theta)
            _check_values(problem, model_name)
    _check_nominal(problem, model_name)


def _trials(space: Space) -> Iterator[Array]:
    """The first RAISING common initial configurations, (d,) each; few are drawn in most cases."""
    yield from space.decode(space.initial(TRIALS))
    yield from space.decode(space.initial(RAISING)[TRIALS:])


def _usable(problem: CurveFit, model_name: str) -> Array | None:
    """The first trial configuration (d,) without an exception; None for an expensive model.

    A model may raise on a part of the box. It is refused with its first error if it raises at all
    of RAISING configurations, and if it gives a wrong shape.
    """
    model, failures, fastest = problem.model, list[Exception](), math.inf
    for theta in _trials(problem.space):
        started = time.perf_counter()
        try:
            actual = model.predict(theta[None], *problem.inputs).shape
        except Exception as error:  # noqa: BLE001 -- whatever a model raises
            failures.append(error)
            fastest = min(fastest, time.perf_counter() - started)
            if len(failures) >= TRIALS and is_expensive(fastest):
                return None
            continue
        long = is_expensive(time.perf_counter() - started)
        kinds, expected = FunctionModel | ExternalModel, (1, len(problem.dataset))
        if not (long and any(isinstance(leaf, kinds) for leaf in expensive_leaves(model))):
            return theta
        if actual != expected:
            raise ValueError(f"{model_name}.predict gives shape {actual}; expected {expected}")
        return None
    raise failures[0]


def _check_shapes(problem: CurveFit, model_name: str, theta: Array) -> None:
    """Refuse a model whose methods give wrong shapes."""
    model, rows = problem.model, len(problem.dataset)
    shapes = {
        "predict": (model.predict(np.stack([theta, theta]), *problem.inputs).shape, (2, rows))
    }
    if not isinstance(model.whole, DifferencedModel | ExternalModel):  # else by differences
        J = model.jacobian(theta, *problem.inputs)
        shapes["jacobian"] = J.shape, (rows, len(problem.space))
    for method, (actual, expected) in shapes.items():
        if actual != expected:
            raise ValueError(f"{model_name}.{method} gives shape {actual}; expected {expected}")


def check_sigma(problem: CurveFit) -> None:
    """Raise ValueError for a sigma that is not a positive number or a column of such numbers."""
    sigma = problem.sigma
    if problem.prior is not None:
        _check_prior(problem)
    if sigma is None:
        return
    if not isinstance(sigma, str):
        if isinstance(sigma, bool) or not isinstance(sigma, int | float) or not 0 < sigma < np.inf:
            raise ValueError(f"sigma is {sigma!r}; expected a number above 0, or a column's name")
        if not SMALLEST < sigma < LARGEST:
            raise ValueError(f"sigma is {sigma!r}; expected {SMALLEST:g} to {LARGEST:g}")
        return
    column, dataset = problem.dataset[sigma], problem.dataset
    if sigma in problem.model.inputs or sigma == dataset.output:
        raise ValueError(
            f"sigma is {sigma!r}, an input or the output of the model; name a column of standard "
            "deviations"
        )
    if dataset.units[sigma] != problem.unit and dataset.units[sigma] and problem.unit:
        raise ValueError(
            f"sigma: column {sigma!r} has unit {dataset.units[sigma]!r}; expected "
            f"{problem.unit!r}, the unit of {dataset.output!r}"
        )
    wrong = np.flatnonzero(column <= 0)
    if wrong.size:
        raise ValueError(
            f"sigma: column {sigma!r} is {column[wrong[0]]:g} in row {wrong[0] + 1} of "
            f"{dataset.name}; expected numbers above 0"
        )
    beyond = np.flatnonzero((column < SMALLEST) | (column > LARGEST))
    if beyond.size:
        raise ValueError(
            f"sigma: column {sigma!r} is {column[beyond[0]]:g} in row {beyond[0] + 1} of "
            f"{dataset.name}; expected {SMALLEST:g} to {LARGEST:g}"
        )


def _check_prior(problem: CurveFit) -> None:
    """Refuse priors whose weight relative to the data is unknown."""
    name = problem.prior.parameters[0].name if problem.prior is not None else ""
    if problem.prior_scale is None and (problem.sigma is None or not problem.sigma_known):
        raise ValueError(
            f"space.{name}.prior: expected a known sigma, which sets the weight of the prior "
            "against the data; give sigma, a number or a column, or use miho.fit, which estimates "
            "it"
        )
    if not isinstance(problem.rho, Square):
        raise ValueError(
            f"space.{name}.prior: expected the loss Square, got {type(problem.rho).__name__}; "
            "remove the prior or change the loss"
        )


def examined(
    model: FunctionModel, dataset: Dataset, space: Space, expensive: bool = False
) -> Model:
    """The function as a formula, if both give the same values on the data at some configurations.

    Otherwise the function, after trials that find out how it can be called. A function from a file
    is traced only if its text is plain arithmetic. A function that is `expensive` is not called.
    """
    lacking = [name for name in model.inputs if name not in dataset.columns]
    if lacking:
        return model  # the check refuses it later
    if model.tried != UNTRIED:
        return model
    thetas = _trials_of(model, space)
    columns = [dataset[name] for name in model.inputs]
    if model.source is None or _is_arithmetic(model):
        formula = model.formula_at(thetas, *columns)
        if formula is not model:
            return formula
    return model if expensive else model.tried_at(thetas, *columns)


def _is_arithmetic(model: FunctionModel) -> bool:
    """Whether the text of a function is plain arithmetic."""
    from miho.models.plain_arithmetic import is_arithmetic

    return is_arithmetic(model.function)


def _trials_of(model: FunctionModel, space: Space) -> Array:
    """Parameter rows (TRIALS, d) of a model: in the box, and about 1 of what nothing is known."""
    names = list(model.parameters)
    u = _shares(len(names))
    thetas = 0.5 + u
    for parameter in space.parameters:
        if parameter.fixed is not None and parameter.name in names:
            thetas[:, names.index(parameter.name)] = parameter.fixed
    if any(parameter.free for parameter in space.parameters):
        box = space.free
        own = [k for k, name in enumerate(box.names) if name in names]
        places = [names.index(box.names[k]) for k in own]
        shares = np.full((TRIALS, len(box)), 0.5)
        shares[:, own] = u[:, places]
        low, high = box.bounds
        normal = np.array([parameter.std is not None for parameter in box.parameters])
        drawn = low + (high - low) * shares
        if normal.any():
            drawn = np.where(normal, box.quantiles(shares), drawn)
        thetas[:, places] = box.decode(drawn)[:, own]
    return thetas


@cache
def _shares(count: int) -> Array:
    """Random numbers (TRIALS, count), always the same."""
    return np.random.default_rng(0).random((count, TRIALS)).T


def with_defaults(space: Space, model: Model) -> Space:
    """The space with missing parameters fixed at the defaults of the model."""
    defaults = {name: at for name, at in model.defaults.items() if name not in space.names}
    if not defaults:
        return space
    fixed = [Parameter(name, model.parameters[name], fixed=at) for name, at in defaults.items()]
    return replace(space, parameters=(*space.parameters, *fixed)).in_order(model.parameters)


def space_mismatch(model_name: str, needed: Sequence[str], declared: Sequence[str]) -> str:
    """The message on a space without the parameters of the model in the order of the model."""
    lacking = [name for name in needed if name not in declared]
    surplus = [name for name in declared if name not in needed]
    differences = [f"lacks {', '.join(lacking)}"] * bool(lacking)
    differences += [f"also has {', '.join(surplus)}"] * bool(surplus)
    if not differences:
        differences = [f"has them in the order {', '.join(declared)}"]
    return (
        f"model {model_name} needs the parameters {', '.join(needed)}; the space "
        f"{' and '.join(differences)}; give it these parameters"
    )


def _check_output_size(problem: CurveFit) -> None:
    """Refuse an output whose squares overflow or underflow."""
    largest = float(np.abs(problem.dataset[problem.dataset.output]).max(initial=0.0))
    if largest and not SMALLEST < largest < LARGEST:
        raise ValueError(
            f"column {problem.dataset.output!r} of {problem.dataset.name} reaches {largest:.3g} "
            f"{problem.unit}, whose square is beyond double precision; choose a unit that gives a "
            f"largest value between {SMALLEST:g} and {LARGEST:g}"
        )


def _check_values(problem: CurveFit, model_name: str) -> None:
    """Refuse rows that are not finite at any trial configuration, and a wrong `linear`."""
    model = problem.model
    thetas = problem.space.decode(problem.space.initial(TRIALS))
    try:
        values = model.predict(thetas, *problem.inputs)
    except Exception:  # noqa: BLE001 -- it may fail on a part of the box; the run counts failures
        return
    never = np.flatnonzero(~np.isfinite(values).any(axis=0))
    if never.size and np.isfinite(values).any():
        at = ", ".join(
            f"{name} = {column[never[0]]:g}"
            for name, column in zip(model.inputs, problem.inputs, strict=True)
        )
        raise ValueError(
            f"{model_name} is not finite at {at} (row {never[0] + 1} of {problem.dataset.name}), "
            "whatever its parameters; remove the row or correct the model"
        )
    by_formula = isinstance(model, FunctionFormula) and not model.function.linear
    if model.linear and not by_formula:
        _check_linear(problem, model_name, thetas)


def _check_linear(problem: CurveFit, model_name: str, thetas: Array) -> None:
    """Refuse a model that is not linear in its `linear` parameters.

    These parameters move from the first of the configurations (n, d) to the second. Halfway, a
    linear model gives the mean of its values at both ends.
    """
    model, names = problem.model, problem.space.names
    moved = thetas[0].copy()
    for name in model.linear:
        moved[names.index(name)] = thetas[1, names.index(name)]
    rows = np.stack([thetas[0], moved, (thetas[0] + moved) / 2])
    try:
        first, last, middle = model.predict(rows, *problem.inputs)
    except Exception:  # noqa: BLE001 -- as above
        return
    finite = np.isfinite(first) & np.isfinite(last) & np.isfinite(middle)
    first, last, middle = first[finite], last[finite], middle[finite]
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.abs(first) + np.abs(last)
        bent = np.abs(first + last - 2 * middle) > LINEAR * (size + size.max(initial=0.0))
    if bent.any():
        raise ValueError(
            f"{model_name} is not linear in {', '.join(model.linear)} as it declares; correct "
            "`linear`"
        )


def _check_nominal(problem: CurveFit, model_name: str) -> None:
    """Warn if parameters refer to conditions far from the conditions of the data."""
    for name, (nominal, value) in problem.model.nominal.items():
        column = problem.dataset[name]
        low, high = float(column.min()), float(column.max())
        if not low / FAR <= value <= FAR * high:
            unit = problem.dataset.units[name]
            warnings.warn(
                f"{model_name}: {nominal} is {value:g} {unit}, but {name} is {low:g} to "
                f"{high:g} {unit} in {problem.dataset.name}: the coefficients refer to a condition "
                "that was not measured, and their usual ranges may not hold; choose "
                f"{nominal} near {float(np.median(column)):.4g}",
                UserWarning,
                stacklevel=3,
            )
