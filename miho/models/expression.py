"""Models given by one expression, which NumPy and the virtual machine evaluate."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import final
from weakref import WeakKeyDictionary

import numpy as np

from miho.compiled.kernel import Formula
from miho.core import Tape
from miho.models.formula_tape import traced_tapes
from miho.models.model import Model
from miho.quantities import Array

Tapes = tuple[Tape, Tape] | None
TAPES: WeakKeyDictionary[Formula, tuple[Formula, Tapes]] = WeakKeyDictionary()
"""Derivatives and tapes of formulas, cached per process for many fits of one function."""


class Expression(Model):
    """A model whose output at a row is one expression of that row and theta.

    `value` and `derivatives` are plain functions of two tuples, the inputs and the parameters in
    order. They use arithmetic and NumPy's elementwise functions without branches, so the same code
    runs with numbers, arrays and the symbols of a tape. Further numbers are in their closures. An
    expression with other functions cannot run in the machine of `miho.core` and runs in NumPy.
    """

    @final
    def with_leaves(self, wrap: Callable[[Model], Model]) -> Model:
        """Return this model, because arithmetic is never expensive."""
        return self

    @property
    @abstractmethod
    def value(self) -> Formula:
        """Function that computes the output."""

    @property
    @abstractmethod
    def derivatives(self) -> Formula:
        """Function that computes the derivatives, one array per parameter."""

    @final
    @property
    def tapes(self) -> Tapes:
        """Tapes of the output and its derivatives for the machine of `miho.core`.

        None if the formulas cannot be traced, or are too long for the machine.
        """
        value, derivatives = self.value, self.derivatives
        known, tapes = TAPES.get(value, (None, None))
        if known is not derivatives:
            tapes = traced_tapes(value, derivatives, len(self.inputs), len(self.parameters))
            TAPES[value] = derivatives, tapes
        return tapes

    @final
    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the outputs (n, N) of parameter rows (n, d) at input columns (N,)."""
        with np.errstate(all="ignore"):  # NaN or infinite without a value, as in the machine
            rows = np.asarray(self.value(inputs, tuple(thetas.T[:, :, None])))
        shape = len(thetas), inputs[0].size
        own = rows.shape == shape and rows.base is None
        return rows if own else np.broadcast_to(rows, shape).copy()

    @final
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Return the derivatives of the outputs: (N, d) at theta (d,), (n, N, d) at rows (n, d)."""
        with np.errstate(all="ignore"):
            columns = self.derivatives(inputs, tuple(theta.T[..., None]))
        jacobian = np.empty((*theta.shape[:-1], inputs[0].size, len(columns)))
        for k, column in enumerate(columns):
            jacobian[..., k] = column
        return jacobian
