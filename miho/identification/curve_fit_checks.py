"""Checks that model, data and space fit together, and that the model is as it declares."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np

from miho.data.dataset import Dataset
from miho.models.function_calls import UNTRIED
from miho.models.function_model import FunctionFormula, FunctionModel
from miho.models.model import Model, expensive_leaves
from miho.optim.space import Parameter, Space
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.curve_fit import CurveFit

TRIALS = 5
"""Number of trial configurations of a new problem."""
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
        from miho.identification.ties import space_mismatch

        raise ValueError(space_mismatch(model, problem.space.names))
    if model.ordered and dataset.held_out is not None and not expensive:  # may be unknown yet
        raise ValueError(f"{model_name} needs every row in order; expected no held-out rows")
    _ = problem.inputs  # raises for a column that the data lack

    # Units of space, data and model agree.
    declared = {f"parameter {p.name!r} of the space": p.unit for p in problem.space.parameters}
    declared |= {f"column {name!r} of {dataset.name}": dataset.units[name] for name in model.inputs}
    declared |= {f"output {dataset.output!r} of {dataset.name}": problem.unit}
    needed_units = (*model.parameters.values(), *model.inputs.values(), model.output)
    for (place, unit), needed in zip(declared.items(), needed_units, strict=True):
        if unit == needed or not (unit and needed):
            continue
        from miho.units import UNITS, differ

        if differ(unit, needed):
            raise ValueError(
                f"{place} has unit {unit!r}; model {model_name} needs {needed!r}"
                + f"; write the model for {unit!r}, since files are read in SI units"
                * (unit == UNITS.get(needed, (None,))[0])
            )

    _check_output_size(problem)
    if isinstance(model, FunctionFormula):  # which was compared with its function
        _check_values(problem, model_name)
    elif not expensive and not any(
        isinstance(leaf, FunctionModel) and leaf.tried.expensive for leaf in expensive_leaves(model)
    ):
        from miho.identification.trial_calls import check_shapes, usable

        theta = usable(problem, model_name)
        if theta is not None:
            check_shapes(problem, model_name, theta)
            _check_values(problem, model_name)
    _check_nominal(problem, model_name)


def model_of(model: object) -> Model:
    """Return a model unchanged, and a function as a model."""
    if callable(model) and not isinstance(model, type | Model):
        model = FunctionModel(model)
    if isinstance(model, Model):
        return model
    raise ValueError(
        f"the model is {model!r}; expected an instance of a model class, for example Pacejka(), or "
        'a function, for example: def decay(t: "s", *, a: "V", b: "1/s") -> "V"'
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
    traced = model.source is None
    if not traced:
        from miho.models.plain_arithmetic import is_arithmetic

        traced = is_arithmetic(model.function)
    if traced:
        formula = model.formula_at(thetas, *columns)
        if formula is not model:
            return formula
    return model if expensive else model.tried_at(thetas, *columns)


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
        normal = [parameter.std is not None for parameter in box.parameters]
        drawn = low + (high - low) * shares
        if any(normal):
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


def _check_output_size(problem: CurveFit) -> None:
    """Refuse an output whose squares overflow or underflow."""
    largest = float(np.abs(problem.dataset[problem.dataset.output]).max(initial=0.0))
    if largest and not SMALLEST < largest < LARGEST:
        value = f"{largest:.3g} {problem.unit}".rstrip()
        raise ValueError(
            f"column {problem.dataset.output!r} of {problem.dataset.name} reaches {value}, whose "
            "square is beyond double precision; choose a unit that gives a largest value between "
            f"{SMALLEST:g} and {LARGEST:g}"
        )


def _check_values(problem: CurveFit, model_name: str) -> None:
    """Refuse rows that are not finite at any trial configuration, and a wrong `linear`."""
    model = problem.model
    thetas = problem.space.decode(problem.space.initial(TRIALS))
    check = partial(_is_finite, problem, model_name, thetas)
    if isinstance(model, FunctionFormula):
        evaluated = model.passed("finite", check, thetas, *problem.inputs)
    else:
        evaluated = check()
    by_formula = isinstance(model, FunctionFormula) and not model.model.linear
    if evaluated and model.linear and not by_formula:
        from miho.identification.trial_calls import check_linear

        check_linear(problem, model_name, thetas)


def _is_finite(problem: CurveFit, model_name: str, thetas: Array) -> bool:
    """Whether the model has values at these configurations (n, d); refuses rows without any."""
    model = problem.model
    try:
        values = model.predict(thetas, *problem.inputs)
    except Exception:  # noqa: BLE001 -- it may fail on a part of the box; the run counts failures
        return False
    never = np.flatnonzero(~np.isfinite(values).any(axis=0))
    if never.size and np.isfinite(values).any():
        from miho.identification.trial_calls import check_rows

        check_rows(problem, model_name, never)
    return True


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
