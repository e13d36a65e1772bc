"""The parametric model: named inputs and parameters, values and derivatives."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, final

import numpy as np

from miho.quantities import Array

if TYPE_CHECKING:
    from miho.models.derived import Derived
    from miho.models.tied import Ties

ROOT = float(np.cbrt(np.finfo(float).eps))
"""Relative step of central differences, with an error near 1e-10 for smooth functions."""
SMALLEST, VANISHED = 1e-12, 1e-140  # nearer to 0, steps in the scale of a parameter underflow
Predict = Callable[..., Array]
"""Outputs (n, N) of parameter rows (n, d) and input columns."""
VISIBLE = 1e-9
"""A change of the output by less than this fraction of it is mostly rounding."""
INHERITED = "inputs", "parameters", "output", "linear", "name", "source", "nominal"
"""Attributes that a model made of another one takes from it."""


class Model(ABC):
    """A pure function of input columns and a batch of parameters, in SI units and radians.

    Attributes
    ----------
    inputs : Mapping[str, str]
        Units of the input columns, by name, in the order of the arguments of `predict`.
    parameters : Mapping[str, str]
        Units of the parameters, by name, in the order of theta.
    output : str
        Unit of the output.
    linear : tuple of str
        Parameters in which the output is jointly linear if all others are fixed. Some methods
        solve for these parameters directly.
    name : str
        Name of the problems with this model; if empty, the class name in lower case.
    source : Path or None
        File of a model that is not part of this package. A change of the file changes the identity
        of stored runs.
    ordered : bool
        Whether the model needs every row of the data in order, because it has a memory.
    nominal : Mapping[str, tuple[str, float]]
        For some inputs, the label and the value of the reference point of the parameters. If this
        value is far outside the data, the parameters are extrapolations.
    defaults : Mapping[str, float]
        Fixed values of parameters that a space may leave out.
    jacobian_cost : int or None
        Cost of a Jacobian in rows of `predict`. None stands for the number of parameters, which is
        the cost of analytic derivatives.
    ties : Ties or None
        Expressions of the other parameters, if some are fixed or tied (`miho.models.tied`).
    derived : Mapping[str, tuple[str, Callable]]
        Reported quantities with intervals, by name: the unit, and a function that maps parameter
        rows (n, d) to values (n,).
    """

    if TYPE_CHECKING:  # read-only, so that a subclass may declare or compute them

        @property
        def inputs(self) -> Mapping[str, str]: ...
        @property
        def parameters(self) -> Mapping[str, str]: ...
        @property
        def output(self) -> str: ...
        @property
        def linear(self) -> tuple[str, ...]: ...
        @property
        def name(self) -> str: ...
        @property
        def source(self) -> Path | None: ...
        @property
        def ordered(self) -> bool: ...
        @property
        def nominal(self) -> Mapping[str, tuple[str, float]]: ...
        @property
        def defaults(self) -> Mapping[str, float]: ...
        @property
        def jacobian_cost(self) -> int | None: ...
        @property
        def ties(self) -> Ties | None: ...
        @property
        def derived(self) -> Mapping[str, tuple[str, Callable[[Array], Array]]]: ...
    else:
        linear, name, source, ordered, jacobian_cost = (), "", None, False, None
        ties = None
        nominal = defaults = derived = MappingProxyType({})

    @property
    def whole(self) -> Model:
        """The model of all parameters, which is another one if some are fixed or tied."""
        return self

    def with_numbers(self) -> Model:
        """Return this model with functions called with numbers; itself if nothing changes."""
        return self

    def with_leaves(self, wrap: Callable[[Model], Model]) -> Model:
        """Return this model with `wrap` applied to each component that may be expensive."""
        return wrap(self)

    @abstractmethod
    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the outputs of parameter rows at input columns.

        Parameters
        ----------
        thetas : ndarray of shape (n, d)
            Parameter rows.
        *inputs : ndarray of shape (N,)
            Input columns, in the order of `inputs`.

        Returns
        -------
        ndarray of shape (n, N)
            Outputs, in a new array that the caller may overwrite. The outputs of a parameter row
            must not depend on the other rows of the batch.
        """

    @abstractmethod
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives of the outputs with respect to the parameters.

        Parameters
        ----------
        theta : ndarray of shape (d,)
            Parameters.
        *inputs : ndarray of shape (N,)
            Input columns.

        Returns
        -------
        ndarray of shape (N, d)
            Derivatives.
        """

    def derived_quantities(self, columns: Mapping[str, Array]) -> tuple[Derived, ...]:
        """Return the reported quantities, which may depend on the data.

        Parameters
        ----------
        columns : mapping of str to ndarray of shape (N,)
            Columns of the data, by name.

        Returns
        -------
        tuple of Derived
            Quantities; by default the quantities in `derived`.
        """
        from miho.models.derived import Derived

        declared = self.derived.items()
        return tuple(Derived(name, unit, values) for name, (unit, values) in declared)

    def remarks(self, theta: Array, noise: float | Array, *inputs: Array) -> list[str]:
        """Return sentences for the report about numerical errors of the model at an optimum.

        Parameters
        ----------
        theta : ndarray of shape (d,)
            Optimum.
        noise : float or ndarray of shape (N,)
            Standard deviation of the residuals at the optimum, of all rows or of each.
        *inputs : ndarray of shape (N,)
            Input columns.

        Returns
        -------
        list of str
            Sentences; by default there are none.
        """
        return []


class Wrapper(Model):
    """Base class of a model made of another one, `model`, whose attributes in INHERITED it has.

    A subclass declares the attributes that differ.
    """

    model: Model
    if not TYPE_CHECKING:
        inputs, parameters, output, linear, name, source, nominal = (
            property(attrgetter(f"model.{attribute}")) for attribute in INHERITED
        )

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the fields; older pickles call the model `function` or `joint`."""
        for former in ("function", "joint"):
            if former in state:
                state = {"model": state[former], **state}
        vars(self).update(state)


class DifferencedModel(Model):
    """A model with derivatives by `central_differences`, which need 2 d evaluations."""

    @final
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives of the outputs (N, d), by `differences`."""
        return self.differences(self.predict, theta, *inputs)

    def differences(self, predict: Predict, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives from outputs that `predict` computes or looks up.

        Their error is about 1e-10 in smooth models.
        """
        return central_differences(predict, theta, *inputs)

    @property
    def jacobian_cost(self) -> int:
        """Two evaluations per parameter; a few more near 0 and near values that are not finite."""
        return 2 * len(self.parameters)


class ExternalModel(DifferencedModel):
    """An external simulation with few exact digits: differences use a wide relative `step`.

    The step is relative to the parameter, or to its entry of `typical` if the parameter is 0. A
    relative error e of the simulation gives derivatives with a relative error of about e / step:
    six digits and a step of 1e-3 leave an error of about 1e-3. Next to a failed simulation,
    differences are one-sided and need a simulation at the point itself.
    """

    step: float
    ordered = True

    @property
    def typical(self) -> Array:
        """Typical sizes of the parameters (d,), which scale the step of parameters that are 0."""
        return np.ones(len(self.parameters))

    @final
    def differences(self, predict: Predict, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives from outputs that `predict` computes or looks up."""
        h = self.step * np.where(theta == 0, self.typical, np.abs(theta))
        high, low, sides = _two_sided(predict, theta, np.diag(h), *inputs)
        return np.asarray(((high - low) / (sides * h)[:, None]).T)


def central_differences(predict: Predict, theta: Array, *inputs: Array) -> Array:
    """Return the derivatives (N, d) of the predictions, from 2 d parameter rows or a few more.

    The step is the cube root of the machine epsilon times the parameter, which leaves a relative
    error near 1e-10 in smooth models. If the value on one side is not finite, the difference uses
    the other side only, with an error near 1e-5. A parameter near 0 gives no scale for its step;
    the step grows until the output changes by more than rounding errors.
    """
    step = ROOT * np.where(np.abs(theta) < VANISHED, SMALLEST, np.abs(theta))
    derivatives = np.zeros((inputs[0].size, theta.size))
    todo = np.arange(theta.size)
    while todo.size:
        high, low, sides = _two_sided(predict, theta, np.diag(step)[todo], *inputs)
        at, h = theta[todo], step[todo]
        width = ((at + h) - (at - h)) * (sides / 2)
        change = high - low
        derivatives[:, todo] = (change / width[:, None]).T
        size = np.abs(high).max(axis=1)
        lost = (np.abs(change).max(axis=1) < VISIBLE * size) & (step[todo] < ROOT)
        todo = todo[lost]
        step[todo] *= 100
    return derivatives


def rows_of(predict: Predict, thetas: Array, *inputs: Array) -> Array:
    """Return the outputs (n, N) of parameter rows (n, d), NaN if the model raises for a row."""
    try:
        return predict(thetas, *inputs)
    except Exception:  # noqa: BLE001 -- whatever a model raises
        values = np.full((len(thetas), inputs[0].size), np.nan)
        for k, theta in enumerate(thetas if len(thetas) > 1 else ()):
            with contextlib.suppress(Exception):
                values[k] = predict(theta[None], *inputs)[0]
        return values


def _two_sided(
    predict: Predict, theta: Array, moves: Array, *inputs: Array
) -> tuple[Array, Array, Array]:
    """Return the outputs (k, N) at theta + moves and theta - moves (k, d), and the sides (k,).

    Next to a value that is not finite, the output at theta replaces it, and there is one side.
    """
    rows = np.vstack([theta + moves, theta - moves])
    high, low = np.split(rows_of(predict, rows, *inputs), 2)
    above, below = (np.asarray(np.isfinite(side).all(axis=1)) for side in (high, low))
    if not (above & below).all():
        centre = predict(theta[None], *inputs)
        high = np.where((below & ~above)[:, None], centre, high)
        low = np.where((above & ~below)[:, None], centre, low)
    return high, low, np.where(above == below, 2.0, 1.0)


def expensive_leaves(model: Model) -> list[Model]:
    """Return the components of a model that may be expensive, in their order."""
    leaves = list[Model]()

    def note(leaf: Model) -> Model:
        leaves.append(leaf)
        return leaf

    model.with_leaves(note)
    return leaves
