"""The mean square of a model written as an expression, fast: one pass over the data.

The rows of the data go through the expression in blocks, whose temporaries stay in the first-level
cache: those of a formula that can be traced through the machine of `miho.core`, which needs no
compiling. Any other expression, or where the library was built without the machine, is compiled by
numba, which takes seconds for each, off the clock, and is cached on disk, in `__pycache__` or
NUMBA_CACHE_DIR. So is the bound of an expression, of which sums over panels are made.

The mean square is summed in a fixed order, so that a loss is the same bits alone or in a batch,
early stopping on or off, and by the machine on every processor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, cast

import numpy as np
from numba import carray, cfunc, njit, types
from numba.core.errors import NumbaError
from numba.extending import register_jitable
from numpy.typing import NDArray

import miho.compiled.polynomials  # noqa: F401 -- registers the elementary functions
from miho.compiled.addresses import COLUMNS, RESIDUALS
from miho.compiled.arrays import (
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
from miho.compiled.calls import pointer
from miho.compiled.kernel import Formula, Formulas, Rows
from miho.compiled.panel_sums import Sign
from miho.compiled.signature import Signed, signed_formulas, signing
from miho.compiled.taped import FIRST_BLOCK, SHARE, TapedLoss, equal_parts
from miho.compiled.threads import threads_of
from miho.core import machine
from miho.quantities import Array


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
    def taped(self) -> TapedLoss | None:
        """The same by the machine; None where numba compiles the formulas."""
        tapes = None if machine() is None else self.model.tapes
        if tapes is None:
            return None
        return TapedLoss(*tapes, self._columns[0], self.y, self.order, self.threads)

    @cached_property
    def _compiled(self) -> _Compiled:
        shape, formulas = self._shape, (self.model.value, self.model.derivatives)
        return _compile(signed_formulas(formulas, shape), *shape)

    @property
    def _shape(self) -> tuple[int, int]:
        return len(self.X), len(self.model.parameters)

    @cached_property
    def _ordered(self) -> tuple[Array, Array]:
        if self.taped is not None:
            return self.taped.ordered
        return np.ascontiguousarray(self.X[:, self.order]), self.y[self.order]

    @property
    def _data(self) -> tuple[Any, ...]:
        """What `_mean_square` takes."""
        return *self._ordered, FIRST_BLOCK

    @cached_property
    def rows(self) -> Rows:
        """Residuals and derivatives of some rows, in the order of the loss."""
        if self.taped is not None:
            return self.taped.rows
        X, y = map(read_only, self._ordered)
        shape, formulas = self._shape, (self.model.value, self.model.derivatives)
        residuals, slopes = _compile_rows(signed_formulas(formulas, shape), *shape)
        calls = np.zeros(4, dtype=np.int64)
        calls[RESIDUALS], calls[COLUMNS] = residuals.address, slopes.address
        return Rows(calls, X, y, (residuals, slopes))

    @cached_property
    def _columns(self) -> tuple[Array, Array]:
        return read_only(self.X), read_only(self.y)

    def losses(self, thetas: Array, rows: int | None = None) -> Array:
        """Losses (n,) of parameter rows (n, d), over the first rows of the order if not all."""
        if self.taped is not None:
            return self.taped.losses(thetas, rows)
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

        list(threads_of(self.threads).map(part, equal_parts(len(thetas), parts)))
        return losses

    def _explained(self, error: NumbaError) -> str:
        return (
            f"{type(self.model).__name__}: its value cannot be compiled: {cause(error)}; write it "
            "with arithmetic and NumPy's functions of numbers, or derive from Model"
        )

    def residuals(self, theta: Array) -> Array:
        """Model minus data, (N,)."""
        if self.taped is not None:
            return np.asarray(self.taped.residuals(theta[None])[0])
        residuals = np.empty_like(self.y)
        self._compiled.residuals(read_only(theta), *self._columns, residuals)
        return residuals

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the residuals, (N, d)."""
        if self.taped is not None:
            return self.taped.jacobian(theta)
        columns = np.empty((len(self.model.parameters), self.y.size))
        self._compiled.jacobian(read_only(theta), self._columns[0], columns)
        return columns.T


BLOCK = 512
"""Rows at a time: temporaries of 4 KiB each."""
CALL = types.void(*[types.int64] * 8)
CALLED: dict[str, Any] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract", "nsz"},
}
"""How compiled code calls a model: by eight whole numbers, and how that is compiled."""

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
    """Compile the residuals and derivatives of rows i to j, with the arguments that `tape.h` has.

    Row by row, from which the compiler makes several at once: for a few rows, the temporaries of a
    block would cost more than the rows do.
    """
    columns, inputs = columns_getter(p), row_getter(p)
    sign = signing(formulas.signature)
    value, derivatives = map(register_jitable, formulas.copies())

    @cfunc(CALL, **CALLED)
    @sign
    def residuals(tape: int, theta: int, X: int, N: int, y: int, i: int, j: int, out: int) -> None:
        parameters = as_tuple(carray(pointer(theta), (d,)), d)
        parts = columns(carray(pointer(X), (p, N)), i, j)
        output, r = carray(pointer(y), (N,))[i:j], carray(pointer(out), (j - i,))
        for row in range(r.size):
            r[row] = value(inputs(parts, row), parameters) - output[row]

    @cfunc(CALL, **CALLED)
    @sign
    def slopes(
        tape: int, theta: int, X: int, N: int, i: int, j: int, out: int, stride: int
    ) -> None:
        parameters = as_tuple(carray(pointer(theta), (d,)), d)
        parts, J = columns(carray(pointer(X), (p, N)), i, j), carray(pointer(out), (d, stride))
        for row in range(parts[0].size):
            store_row(derivatives(inputs(parts, row), parameters), J, row)

    return residuals, slopes


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
