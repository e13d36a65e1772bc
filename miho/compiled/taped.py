"""Values of a formula, and mutation steps on its loss, on the machine of `miho.core`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from miho.compiled.kernel import INFINITE, NAN, Block, Climb, Rows, Steps
from miho.core import Tape, machine
from miho.quantities import Array

FIRST_BLOCK = 64
"""Rows before the first test whether a candidate is worse than its parent; each next block is twice
as long."""


@dataclass(frozen=True, eq=False)
class TapedLoss:
    """Residuals of a formula, their derivatives and their mean square, from its two tapes.

    X (p, N) has the input columns, y (N,) the output. `order` (N,), or a function that returns it,
    is the order from which a number of first rows is taken. A mean square is summed in blocks and
    has the same bits alone and in a batch.
    """

    value: Tape
    slopes: Tape
    X: Array
    y: Array
    order: NDArray[np.intp] | Callable[[], NDArray[np.intp]]
    _parts: dict[int, tuple[Array, Array]] = field(default_factory=dict, init=False, repr=False)

    def losses(self, thetas: Array, rows: int | None = None) -> Array:
        """Mean squares (n,) of parameter rows (n, d), over all or the first rows of the order."""
        X, y = self.ordered
        return self.value.mean_squares(thetas, X, y[:rows], FIRST_BLOCK)

    def residuals(self, thetas: Array, rows: int | None = None) -> Array:
        """Model minus data (n, N), or over the first rows of the order (n, rows)."""
        X, y = self._first(rows)
        values = self.value.evaluate(thetas, X)[:, 0]
        values -= y
        return values

    def jacobian(self, theta: Array, rows: int | None = None) -> Array:
        """Derivatives of the residuals at theta (d,), (N, d) or (rows, d)."""
        return np.asarray(self.slopes.evaluate(theta[None], self._first(rows)[0])[0].T)

    @cached_property
    def climb(self) -> Climb:
        """Mutation steps on the loss, many per call."""
        tape, (X, y) = self.value, self.ordered

        def climb(steps: Steps, best: float, target: float) -> Block:
            n, d = steps.P.shape
            most = (len(steps.noise) + 1) * n
            at, losses, thetas = np.empty(most, np.int64), np.empty(most), np.empty((most, d))
            count, improvements, nans, infinities = machine().climb(
                tape.in_machine, X, y, FIRST_BLOCK, steps, best, target, at, losses, thetas
            )
            return Block(
                count * n,
                at[:improvements].astype(float),
                losses[:improvements],
                thetas[:improvements],
                {NAN: nans, INFINITE: infinities},
            )

        return climb

    @cached_property
    def rows(self) -> Rows:
        """Residuals and derivatives of some rows, in the order of the loss."""
        return self.rows_of(*self.ordered)

    def rows_of(self, X: Array, y: Array) -> Rows:
        """Residuals and derivatives of these rows."""
        tapes = [tape.in_machine for tape in (self.value, self.slopes)]
        functions = machine().functions()[:2]
        calls = np.array([*functions, *map(machine().address, tapes)], dtype=np.int64)
        return Rows(calls, X, y, tapes)

    @cached_property
    def ordered(self) -> tuple[Array, Array]:
        """Inputs and output in the order."""
        order = self.order() if callable(self.order) else self.order
        X, y = self.X[:, order], self.y[order]
        return np.ascontiguousarray(X, dtype=float), np.ascontiguousarray(y, dtype=float)

    def _first(self, rows: int | None) -> tuple[Array, Array]:
        """Inputs and output of the first rows of the order, or of all rows, unordered."""
        if rows is None:
            return self.X, self.y
        if rows not in self._parts:
            X, y = self.ordered
            self._parts[rows] = np.ascontiguousarray(X[:, :rows]), y[:rows]
        return self._parts[rows]
