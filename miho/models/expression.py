"""Models written once as an expression, which NumPy and the machine of formulas evaluate."""

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
"""Derivatives and tapes of formulas of this process: thousands of fits of a function need them
once."""


class Expression(Model):
    """A model whose output at a row depends on that row and theta alone, as one expression.

    `value` and `derivatives` are plain functions of two tuples, the inputs and the parameters in
    their order. They use arithmetic and NumPy's functions of numbers, without branches, so that
    numbers, arrays and the symbols of a tape go through the same lines. What they need besides is
    in their closure, as plain numbers. One that the machine of `miho.core` cannot run, as it calls
    other functions, runs in NumPy.
    """

    @final
    def with_leaves(self, wrap: Callable[[Model], Model]) -> Model:
        """Itself: arithmetic is never dear."""
        return self

    @property
    @abstractmethod
    def value(self) -> Formula:
        """The output at the inputs."""

    @property
    @abstractmethod
    def derivatives(self) -> Formula:
        """A tuple of derivatives of the output, one for each parameter, as wide as the inputs."""

    @final
    @property
    def tapes(self) -> Tapes:
        """The output and its derivatives for the machine of `miho.core`.

        None where the formulas cannot be traced, or are too long for it.
        """
        value, derivatives = self.value, self.derivatives
        known, tapes = TAPES.get(value, (None, None))
        if known is not derivatives:
            tapes = traced_tapes(value, derivatives, len(self.inputs), len(self.parameters))
            TAPES[value] = derivatives, tapes
        return tapes

    @final
    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,)."""
        with np.errstate(all="ignore"):  # without a value it is NaN or infinite, as on the machine
            rows = np.asarray(self.value(inputs, tuple(thetas.T[:, :, None])))
        shape = len(thetas), inputs[0].size
        own = rows.shape == shape and rows.base is None
        return rows if own else np.broadcast_to(rows, shape).copy()

    @final
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the outputs, (N, d), at one configuration (d,); rows (n, d): (n, N, d)."""
        with np.errstate(all="ignore"):
            columns = self.derivatives(inputs, tuple(theta.T[..., None]))
        jacobian = np.empty((*theta.shape[:-1], inputs[0].size, len(columns)))
        for k, column in enumerate(columns):
            jacobian[..., k] = column
        return jacobian
