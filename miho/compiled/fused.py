"""The mean square of a model written as an expression, compiled: one pass over the data.

The rows of the data go through the expression in blocks of 512, whose temporaries stay in the
first-level cache. The mean square is summed in a fixed order, so that a loss is the same bits
alone or in a batch, early stopping on or off, on every machine of one kind of CPU. Compilation is
cached by numba on disk, in `__pycache__` or NUMBA_CACHE_DIR; the first use of a new model takes
some seconds, off the clock.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Any, cast

import numpy as np
from numba import cfunc, njit, types
from numba.core.errors import NumbaError
from numba.extending import register_jitable
from numpy.typing import NDArray

import miho.compiled.polynomials  # noqa: F401 -- registers the elementary functions
from miho.compiled.arrays import (
    Callee,
    as_tuple,
    assign,
    cause,
    columns_getter,
    read_only,
    row_getter,
    store_columns,
    store_row,
    sum_of_squares,
)
from miho.compiled.climb import climb_on, compiled_climb, equal_parts
from miho.compiled.kernel import Climb, Formula, Formulas, Rows
from miho.compiled.panel_sums import Sign, panel_sums, panel_terms, scratch_for
from miho.compiled.panels import panels
from miho.compiled.signature import Signed, signed_formulas, signing
from miho.quantities import Array

BLOCK = 512
"""Rows at a time: temporaries of 4 KiB each."""
SHARE = 50_000
"""A batch of so many model values is worth a further thread."""
FIRST_BLOCK = 64
"""Rows before the first test whether a candidate is beaten; then twice as many each, up to BLOCK.
Where panels are tested first, an early test on rows gains nothing."""
WORTH_PANELS = 1000
"""From so many rows on, sums over panels show sooner than the rows that a candidate is beaten."""


@dataclass(frozen=True, eq=False)
class FusedLoss:
    """Mean square of model minus data, its residuals and their derivatives.

    X (p, N) holds the input columns, y (N,) the output, `order` (N,) the order in which the loss
    goes through them: one whose first part is like the whole (`row_order`). `losses` and `climb`
    use `threads` threads, and give the same however many. `climb` gives a mutant up as soon as sums
    over panels, if the model has a bound, or over a part of the rows show that it is not better.
    """

    model: Formulas
    X: Array
    y: Array
    order: NDArray[np.intp]
    threads: int = 1

    @cached_property
    def _compiled(self) -> _Compiled:
        shape, formulas = self._shape, (self.model.value, self.model.derivatives)
        return _compile(signed_formulas(formulas, shape), *shape)

    @cached_property
    def _steps(self) -> Callable[..., tuple[int, int, int, int]]:
        shape, formulas = self._shape, [self.model.value]
        if self._in_panels and self.model.bound is not None:
            formulas.append(self.model.bound)
        return _compile_steps(signed_formulas(tuple(formulas), shape), *shape)

    @property
    def _shape(self) -> tuple[int, int]:
        return len(self.X), len(self.model.parameters)

    @property
    def _in_panels(self) -> bool:
        return len(self.X) == 1 and self.y.size >= WORTH_PANELS and self.model.bound is not None

    @cached_property
    def _data(self) -> _Data:
        first_block = BLOCK if self._in_panels else FIRST_BLOCK
        return np.ascontiguousarray(self.X[:, self.order]), self.y[self.order], first_block

    @cached_property
    def rows(self) -> Rows:
        """Residuals and derivatives of some rows, in the order of the loss."""
        shape, formulas = self._shape, (self.model.value, self.model.derivatives)
        compiled = _compile_rows(signed_formulas(formulas, shape), *shape)
        X, y, _ = self._data
        return Rows(*compiled, read_only(X), read_only(y))

    @cached_property
    def _columns(self) -> tuple[Array, Array]:
        return read_only(self.X), read_only(self.y)

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(self.threads)

    @cached_property
    def climb(self) -> Climb:
        """Compiled mutation steps on this loss."""
        if not self._in_panels:
            return climb_on(self._steps, (self._data, ()), tuple, self.threads)
        size = float(np.sqrt(np.mean(self.y**2)))
        terms = panel_terms(panels(self.X[0], self.y), self.y.size, size)
        room = partial(scratch_for, terms)
        return climb_on(self._steps, (self._data, terms), room, self.threads)

    def losses(self, thetas: Array, rows: int | None = None) -> Array:
        """Losses (n,) of parameter rows (n, d), over the first rows of the order if not all."""
        thetas = read_only(thetas)
        losses = np.empty(len(thetas))
        X, y, first_block = self._data
        data = X, y[:rows], first_block
        parts = min(self.threads, len(thetas), len(thetas) * data[1].size // SHARE)
        if parts <= 1:
            try:
                self._compiled.losses(thetas, data, losses)
            except NumbaError as error:
                raise ValueError(self._explained(error)) from None
            return losses

        def part(rows: slice) -> None:
            self._compiled.losses(thetas[rows], data, losses[rows])

        list(self._pool.map(part, equal_parts(len(thetas), parts)))
        return losses

    def _explained(self, error: NumbaError) -> str:
        return (
            f"{type(self.model).__name__}: its value cannot be compiled: {cause(error)}; write it "
            "with arithmetic and NumPy's functions of numbers, or derive from Model"
        )

    def residuals(self, theta: Array) -> Array:
        """Model minus data, (N,)."""
        residuals = np.empty_like(self.y)
        self._compiled.residuals(read_only(theta), *self._columns, residuals)
        return residuals

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the residuals, (N, d)."""
        columns = np.empty((len(self.model.parameters), self.y.size))
        self._compiled.jacobian(read_only(theta), self._columns[0], columns)
        return columns.T


VECTOR = types.Array(types.float64, 1, "C")
COLUMNS_OUT = types.Array(types.float64, 2, "C")
DATA = types.Array(types.float64, 2, "C", readonly=True)
OUTPUT = types.Array(types.float64, 1, "C", readonly=True)
CALLED: dict[str, Any] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract", "nsz"},
    "_nrt": False,
}
"""How compiled code calls a model: the types of its arguments, and how it is compiled."""

_Data = tuple[Array, Array, int]
"""X in the order of the loss, the outputs of its first rows or of all, and the first block."""


@dataclass(frozen=True)
class _Compiled:
    losses: Callable[[Array, _Data, Array], None]
    residuals: Callable[[Array, Array, Array, Array], None]
    jacobian: Callable[[Array, Array, Array], None]


@cache
def _compile(formulas: Signed, p: int, d: int) -> _Compiled:
    columns = columns_getter(p)
    sign = signing(formulas.signature)
    value, derivatives = map(register_jitable, formulas.copies())
    loss = _mean_square(value, sign, p, d)

    @njit(cache=True, nogil=True, error_model="numpy")
    @sign
    def losses(thetas: Array, data: _Data, out: Array) -> None:
        for i in range(len(thetas)):
            out[i] = loss(thetas[i], np.inf, data)

    @njit(cache=True, nogil=True, error_model="numpy")
    @sign
    def residuals(theta: Array, X: Array, y: Array, out: Array) -> None:
        parameters = as_tuple(theta, d)
        for start in range(0, y.size, BLOCK):
            end = min(start + BLOCK, y.size)
            assign(value(columns(X, start, end), parameters) - y[start:end], out[start:end])

    @njit(cache=True, nogil=True, error_model="numpy")
    @sign
    def jacobian(theta: Array, X: Array, out: Array) -> None:
        parameters = as_tuple(theta, d)
        for start in range(0, X.shape[1], BLOCK):
            end = min(start + BLOCK, X.shape[1])
            store_columns(derivatives(columns(X, start, end), parameters), out[:, start:end])

    return _Compiled(losses, residuals, jacobian)


@cache
def _compile_rows(formulas: Signed, p: int, d: int) -> tuple[Any, Any]:
    """Residuals and derivatives of rows i to j, to be called from compiled code (see `Rows`).

    Row by row, from which the compiler makes several at once: for a few rows, the temporaries of a
    block would cost more than the rows do.
    """
    columns, inputs = columns_getter(p), row_getter(p)
    sign = signing(formulas.signature)
    value, derivatives = map(register_jitable, formulas.copies())

    @cfunc(types.void(VECTOR, DATA, OUTPUT, types.int64, types.int64, VECTOR), **CALLED)
    @sign
    def residuals(theta: Array, X: Array, y: Array, i: int, j: int, out: Array) -> None:
        parameters, parts, output = as_tuple(theta, d), columns(X, i, j), y[i:j]
        for row in range(out.size):
            out[row] = value(inputs(parts, row), parameters) - output[row]

    @cfunc(types.void(VECTOR, DATA, types.int64, types.int64, COLUMNS_OUT), **CALLED)
    @sign
    def slopes(theta: Array, X: Array, i: int, j: int, out: Array) -> None:
        parameters, parts = as_tuple(theta, d), columns(X, i, j)
        for row in range(parts[0].size):
            store_row(derivatives(inputs(parts, row), parameters), out, row)

    return Callee(residuals), Callee(slopes)


@cache
def _compile_steps(formulas: Signed, p: int, d: int) -> Callable[..., tuple[int, int, int, int]]:
    """Mutation steps on the value of a model, and with its bound on sums over panels first."""
    sign = signing(formulas.signature)
    value, *bound = map(register_jitable, formulas.copies())
    loss = _mean_square(value, sign, p, d)

    @register_jitable(error_model="numpy")
    @sign
    def of_rows(theta: Array, limit: float, data: Any, scratch: Any) -> float:
        total: float = loss(theta, limit, data[0])
        return total

    if not bound:
        return compiled_climb(of_rows, formulas.signature)
    _, beaten = panel_sums(value, bound[0], sign)

    @register_jitable(error_model="numpy")
    @sign
    def panels_first(theta: Array, limit: float, data: Any, scratch: Any) -> float:
        if limit < np.inf and beaten(as_tuple(theta, d), limit, scratch, data[1])[0]:
            return limit
        total: float = of_rows(theta, limit, data, scratch)
        return total

    return compiled_climb(panels_first, formulas.signature)


def _mean_square(
    value: Formula, sign: Sign, p: int, d: int
) -> Callable[[Array, float, _Data], float]:
    """The mean square, as a function to compile: it ends early once it is not below its limit."""
    columns = columns_getter(p)

    @register_jitable(error_model="numpy")
    @sign
    def loss(theta: Array, limit: float, data: _Data) -> float:
        X, y, size = data  # y may hold the first of X's rows only
        parameters = as_tuple(theta, d)
        total = 0.0
        start = 0
        while start < y.size:
            end = min(start + size, y.size)
            residuals = value(columns(X, start, end), parameters) - y[start:end]
            total += sum_of_squares(residuals)
            if total / y.size >= limit:
                break
            start, size = end, min(2 * size, BLOCK)
        return total / y.size

    return cast(Callable[[Array, float, _Data], float], loss)
