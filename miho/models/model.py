"""The parametric model: named inputs and parameters, values and derivatives."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import final

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

SMALLEST = 1e-12
Predict = Callable[..., Array]
"""Outputs (n, N) of parameter rows (n, d) and input columns."""
VISIBLE = 1e-9
"""A change of the output by less than this fraction of it is mostly rounding."""


class Model(ABC):
    """A pure function of input columns and a batch of parameters, in SI units and radians.

    `inputs` and `parameters` map the names of what it reads to their units, in order; `output` is
    the unit of what it gives. `linear` names parameters in which the output is jointly linear when
    all others are held; methods that know how solve for them directly. `name` is what its problems
    are called, the class in small letters if empty; `source` is the file of a model that does not
    belong to this package, so that a change of it is noticed; an `ordered` model needs every row
    of the data in order, as one with a memory does. `nominal` gives of some inputs the value that
    the parameters refer to, as (what it is called, value): far outside of the data, their values
    are extrapolations. `defaults` gives numbers at which parameters are fixed that a space leaves
    out. `jacobian_cost` is how many rows of `predict` a Jacobian takes the time of:
    None for the number of parameters, as which derivatives of a model's own count. `derived` gives
    quantities that are reported with their intervals, by name: the unit, and a function of
    parameter rows (n, d) with values (n,).
    """

    inputs: Mapping[str, str]
    parameters: Mapping[str, str]
    output: str
    linear: tuple[str, ...] = ()
    name: str = ""
    source: Path | None = None
    ordered: bool = False
    nominal: Mapping[str, tuple[str, float]] = MappingProxyType({})
    defaults: Mapping[str, float] = MappingProxyType({})
    jacobian_cost: int | None = None
    derived: Mapping[str, tuple[str, Callable[[Array], Array]]] = MappingProxyType({})

    def with_leaves(self, wrap: Callable[[Model], Model]) -> Model:
        """This model, where each model that it is made of and that may be dear is a wrapped one."""
        return wrap(self)

    @abstractmethod
    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,).

        A new array, which the caller may overwrite; a row is the same in any batch.
        """

    @abstractmethod
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the outputs, (N, d), at one configuration (d,)."""

    def remarks(self, theta: Array, noise: float, *inputs: Array) -> list[str]:
        """Sentences for the report on what the model itself gets wrong at an optimum (d,).

        `noise` is the standard deviation of the errors there.
        """
        return []


class DifferencedModel(Model):
    """A model without derivatives of its own: they are `central_differences`, 2 d values a row."""

    @final
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the outputs, (N, d), to some 1e-10 of their size in smooth models."""
        return self.differences(self.predict, theta, *inputs)

    @final
    def differences(self, predict: Predict, theta: Array, *inputs: Array) -> Array:
        """The derivatives by what `predict` gives: the outputs, wherever they come from."""
        return central_differences(predict, theta, *inputs)

    @property
    def jacobian_cost(self) -> int:  # type: ignore[override]
        """Two values for each parameter; a few more near 0, or where values are not finite."""
        return 2 * len(self.parameters)


class ExternalModel(Model):
    """A simulation that is not ours, known to some digits: differences over a wide `step`.

    It is relative to the parameter, or for 0 to its size in `typical`. The simulation's digits over
    it are lost: with a thousandth, six digits leave derivatives to some thousandths.
    """

    step: float
    ordered = True

    @property
    def typical(self) -> Array:
        """Sizes of the parameters (d,), for those that are 0."""
        return np.ones(len(self.parameters))

    @final
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives (N, d) by central differences, beside a failure by one-sided ones."""
        return self.differences(self.predict, theta, *inputs)

    @final
    def differences(self, predict: Predict, theta: Array, *inputs: Array) -> Array:
        """The derivatives by what `predict` gives: the outputs, wherever they come from."""
        h = self.step * np.where(theta == 0, self.typical, np.abs(theta))
        moves = np.diag(h)
        high, low = np.split(
            rows_of(predict, np.vstack([theta + moves, theta - moves]), *inputs), 2
        )
        width = 2 * h
        beside = np.flatnonzero(~(np.isfinite(high) & np.isfinite(low)).all(axis=1))
        if beside.size:
            centre = predict(theta[None], *inputs)[0]
            high, low, width = _one_sided(centre, high, low, width, beside)
        return np.asarray(((high - low) / width[:, None]).T)

    @property
    def jacobian_cost(self) -> int:  # type: ignore[override]
        """Two simulations for each parameter, and one more beside a failure."""
        return 2 * len(self.parameters)


def central_differences(predict: Predict, theta: Array, *inputs: Array) -> Array:
    """Derivatives (N, d) of what is predicted, from 2 d rows of one batch or a few more.

    The step is the cube root of the machine epsilon times the parameter, which leaves a relative
    error near 1e-10 in smooth models; beside a value that is not finite the difference is taken on
    the other side, at an error near 1e-5. A parameter near 0 does not tell its own size: its step
    grows from there until the output changes by more than rounding does.
    """
    root = float(np.cbrt(np.finfo(float).eps))
    step = root * np.maximum(np.abs(theta), SMALLEST)
    derivatives = np.zeros((inputs[0].size, theta.size))
    todo = np.arange(theta.size)
    while todo.size:
        moves = np.zeros((todo.size, theta.size))
        moves[np.arange(todo.size), todo] = step[todo]
        rows = np.vstack([theta + moves, theta - moves])
        high, low = np.split(rows_of(predict, rows, *inputs), 2)
        width = (
            rows[: todo.size][np.arange(todo.size), todo]
            - rows[todo.size :][np.arange(todo.size), todo]
        )
        beside = np.flatnonzero(~(np.isfinite(high) & np.isfinite(low)).all(axis=1))
        if beside.size:
            centre = predict(theta[None], *inputs)[0]
            high, low, width = _one_sided(centre, high, low, width, beside)
        change = high - low
        derivatives[:, todo] = (change / width[:, None]).T
        size = np.abs(high).max(axis=1)
        lost = (np.abs(change).max(axis=1) < VISIBLE * size) & (step[todo] < root)
        todo = todo[lost]
        step[todo] *= 100
    return derivatives


def rows_of(predict: Predict, thetas: Array, *inputs: Array) -> Array:
    """Outputs (n, N) of parameter rows (n, d), NaN for a row at which the model raises."""
    try:
        return predict(thetas, *inputs)
    except Exception:  # noqa: BLE001 -- whatever a model raises
        values = np.full((len(thetas), inputs[0].size), np.nan)
        for k, theta in enumerate(thetas):
            with contextlib.suppress(Exception):
                values[k] = predict(theta[None], *inputs)[0]
        return values


def _one_sided(
    centre: Array, high: Array, low: Array, width: Array, beside: NDArray[np.intp]
) -> tuple[Array, Array, Array]:
    """Differences to the point itself, for the parameters `beside` values that are not finite."""
    high, low, width = high.copy(), low.copy(), width.copy()
    for k in beside:
        if np.isfinite(low[k]).all():
            high[k] = centre
        elif np.isfinite(high[k]).all():
            low[k] = centre
        else:
            continue
        width[k] /= 2
    return high, low, width
