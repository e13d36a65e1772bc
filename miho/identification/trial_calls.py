"""Trial calls that show whether a model is as it declares."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from miho.identification.curve_fit import CurveFit
from miho.identification.curve_fit_checks import TRIALS
from miho.models.function_model import FunctionModel
from miho.models.model import DifferencedModel, ExternalModel, expensive_leaves
from miho.optim.space import Space
from miho.parallel.worth import is_expensive
from miho.quantities import Array

RAISING = 1000
"""A model is refused if it raises at this number of configurations."""
PATIENCE = 1.0
"""Seconds for trials to find a value of every row."""
LINEAR = 1e-9
"""Relative tolerance for the value of a linear model halfway: the mean of both ends."""


def _trials(space: Space) -> Iterator[Array]:
    """The first RAISING common initial configurations, (d,) each; few are drawn in most cases."""
    yield from space.decode(space.initial(TRIALS))
    yield from space.decode(space.initial(RAISING)[TRIALS:])


def usable(problem: CurveFit, model_name: str) -> Array | None:
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


def check_rows(problem: CurveFit, model_name: str, rows: NDArray[np.intp]) -> None:
    """Refuse the model if one of the `rows` (k,) has no value at as many trials as end in time."""
    model, inputs, started = problem.model, problem.inputs, time.perf_counter()
    for theta in _trials(problem.space):
        with contextlib.suppress(Exception):  # a model may raise on a part of the box
            rows = rows[~np.isfinite(model.predict(theta[None], *inputs)[0, rows])]
        if not rows.size:
            return
        if time.perf_counter() - started > PATIENCE:
            break
    at = ", ".join(
        f"{name} = {column[rows[0]]:g}" for name, column in zip(model.inputs, inputs, strict=True)
    )
    remedy = "take shorter steps" if model.ordered else "remove the row"
    raise ValueError(
        f"{model_name} is not finite at {at} (row {rows[0] + 1} of {problem.dataset.name}) in any "
        f"trial of the space; change the bounds or the start, {remedy} or correct the model"
    )


def check_shapes(problem: CurveFit, model_name: str, theta: Array) -> None:
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


def check_linear(problem: CurveFit, model_name: str, thetas: Array) -> None:
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
