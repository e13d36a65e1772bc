"""Values of a formula on the machine of `miho.core`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from miho.compiled.kernel import Climb, Rows
from miho.core import Tape, machine
from miho.quantities import Array

FIRST_BLOCK = 64
"""Rows before the first test whether a candidate is worse than its parent; each next block is twice
as long."""
SHARE = 50_000
"""Model values of a batch that justify another thread."""


@dataclass(frozen=True, eq=False)
class TapedLoss:
    """Residuals of a formula, their derivatives and their mean square, from its two tapes.

    X (p, N) has the input columns, y (N,) the output. `order` (N,), or a function that returns it,
    is the order from which a number of first rows is taken. A mean square is summed in blocks and
    has the same bits alone, in a batch, and on any number of `threads`.
    """

    value: Tape
    slopes: Tape
    X: Array
    y: Array
    order: NDArray[np.intp] | Callable[[], NDArray[np.intp]]
    threads: int = 1
    _parts: dict[int, tuple[Array, Array]] = field(default_factory=dict, init=False, repr=False)

    def losses(self, thetas: Array, rows: int | None = None) -> Array:
        """Mean squares (n,) of parameter rows (n, d), over all or the first rows of the order."""
        X, y = self.ordered
        y = y[:rows]
        parts = min(self.threads, len(thetas), len(thetas) * y.size // SHARE)
        if parts <= 1:
            return self.value.mean_squares(thetas, X, y, FIRST_BLOCK)

        def part(rows: slice) -> Array:
            return self.value.mean_squares(thetas[rows], X, y, FIRST_BLOCK)

        from miho.compiled.threads import threads_of

        shares = equal_parts(len(thetas), parts)
        return np.concatenate(list(threads_of(self.threads).map(part, shares)))

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
        """Mutation steps on the loss."""
        from miho.compiled.climb import climb_on

        return climb_on(self.value, *self.ordered, self.threads)

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


def equal_parts(n: int, count: int) -> list[slice]:
    """Rows 0 to n in `count` parts, whose sizes differ by at most one row."""
    return [slice(i, j) for i, j in pairwise(np.linspace(0, n, count + 1).astype(int).tolist())]
