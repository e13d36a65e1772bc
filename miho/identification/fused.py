"""The loss of a model written as an expression, compiled: data in, one number out, one pass.

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
from numba import cfunc, njit, typeof, types
from numba.core.errors import NumbaError
from numba.extending import overload, register_jitable
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from miho.identification import panel_sums, panels
from miho.identification.panel_sums import Sign, panel_terms, scratch_for
from miho.models.expression import Expression, Formula
from miho.models.signature import Signed, signed, signed_formulas
from miho.optim import climb
from miho.optim.climb import Climb, climb_on, compiled_climb, equal_parts
from miho.optim.problem import CompiledRows

Array = NDArray[np.float64]

BLOCK = 512
"""Rows at a time: a handful of temporaries of 4 KiB."""
COMPILED_WITH = (climb.__file__, panels.__file__, panel_sums.__file__, __file__)
SHARE = 50_000
"""Model values that are worth a thread of their own."""
CAUSES = (
    "Untyped global name",
    "Use of unsupported",
    "Unknown attribute",
    "Cannot unify",
    "No impl",
)
FIRST_BLOCK = 64
"""Rows before the first look whether a candidate is beaten; doubles up to BLOCK. Where panels come
before rows, there is nothing to win by an early look."""
WORTH_PANELS = 1000
"""Rows from which sums over panels tell sooner than the rows that a candidate is beaten."""


@dataclass(frozen=True, eq=False)
class FusedLoss:
    """Mean square of model minus data, its residuals and their derivatives.

    X (p, N) holds the input columns, y (N,) the output, `order` (N,) the order in which the loss
    goes through them: one whose first part tells what the rest is like (`row_order`). `losses`
    and `climb` use `threads` threads, and give the same however many. `climb` gives a mutant up as
    soon as it is beaten by sums over panels, if the model has a bound, or by a part of the rows.
    """

    model: Expression
    X: Array
    y: Array
    order: NDArray[np.intp]
    threads: int = 1

    @cached_property
    def _compiled(self) -> _Compiled:
        shape, formulas = self._shape, (self.model.value, self.model.derivatives)
        return _compile(signed_formulas(formulas, shape, *COMPILED_WITH), *shape)

    @cached_property
    def _steps(self) -> Callable[..., tuple[int, int, int, int]]:
        shape, formulas = self._shape, [self.model.value]
        if self._in_panels and self.model.bound is not None:
            formulas.append(self.model.bound)
        return _compile_steps(signed_formulas(tuple(formulas), shape, *COMPILED_WITH), *shape)

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
    def compiled_rows(self) -> CompiledRows:
        """Residuals and derivatives of some rows, in the order of the loss."""
        shape, formulas = self._shape, (self.model.value, self.model.derivatives)
        compiled = _compile_rows(signed_formulas(formulas, shape, *COMPILED_WITH), *shape)
        X, y, _ = self._data
        return CompiledRows(*compiled, read_only(X), read_only(y))

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
        terms = panel_terms(panels.panels(self.X[0], self.y), self.y.size, size)
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
    columns = columns_of(p)
    own = signed(formulas.signature)
    value, derivatives = map(register_jitable, formulas.copies())
    loss = _mean_square(value, own, p, d)

    @njit(cache=True, nogil=True, error_model="numpy")
    @own
    def losses(thetas: Array, data: _Data, found: Array) -> None:
        for i in range(len(thetas)):
            found[i] = loss(thetas[i], np.inf, data)

    @njit(cache=True, nogil=True, error_model="numpy")
    @own
    def residuals(theta: Array, X: Array, y: Array, found: Array) -> None:
        parameters = as_tuple(theta, d)
        for start in range(0, y.size, BLOCK):
            end = min(start + BLOCK, y.size)
            _put(value(columns(X, start, end), parameters) - y[start:end], found[start:end])

    @njit(cache=True, nogil=True, error_model="numpy")
    @own
    def jacobian(theta: Array, X: Array, found: Array) -> None:
        parameters = as_tuple(theta, d)
        for start in range(0, X.shape[1], BLOCK):
            end = min(start + BLOCK, X.shape[1])
            _store(derivatives(columns(X, start, end), parameters), found[:, start:end])

    return _Compiled(losses, residuals, jacobian)


@cache
def _compile_rows(formulas: Signed, p: int, d: int) -> tuple[Any, Any]:
    """Residuals and derivatives of rows i to j, as compiled code calls them.

    Row by row, which the compiler turns into several at once: the temporaries of a block would cost
    more than a few rows do.
    """
    columns, inputs, store = columns_of(p), inputs_of(p), _store_row
    own = signed(formulas.signature)
    value, derivatives = map(register_jitable, formulas.copies())

    @cfunc(types.void(VECTOR, DATA, OUTPUT, types.int64, types.int64, VECTOR), **CALLED)
    @own
    def residuals(theta: Array, X: Array, y: Array, i: int, j: int, found: Array) -> None:
        parameters, parts, output = as_tuple(theta, d), columns(X, i, j), y[i:j]
        for row in range(found.size):
            found[row] = value(inputs(parts, row), parameters) - output[row]

    @cfunc(types.void(VECTOR, DATA, types.int64, types.int64, COLUMNS_OUT), **CALLED)
    @own
    def slopes(theta: Array, X: Array, i: int, j: int, found: Array) -> None:
        parameters, parts = as_tuple(theta, d), columns(X, i, j)
        for row in range(parts[0].size):
            store(derivatives(inputs(parts, row), parameters), found, row)

    return Callee(residuals), Callee(slopes)


class Callee:
    """A compiled function to be passed to compiled code, with its type worked out once.

    numba does so at each call, in 15 us: as long as a step on a hundred rows takes.
    """

    def __init__(self, function: Any) -> None:
        self._function = function  # whose code lives as long as it does
        self._numba_type_ = typeof(function)

    def __wrapper_address__(self) -> int:
        return int(self._function.address)


@cache
def _compile_steps(formulas: Signed, p: int, d: int) -> Callable[..., tuple[int, int, int, int]]:
    """Mutation steps on the value of a model, and with its bound on sums over panels first."""
    own = signed(formulas.signature)
    value, *bound = map(register_jitable, formulas.copies())
    loss = _mean_square(value, own, p, d)

    @register_jitable(error_model="numpy")
    @own
    def of_rows(theta: Array, limit: float, data: Any, scratch: Any) -> float:
        found: float = loss(theta, limit, data[0])
        return found

    if not bound:
        return compiled_climb(of_rows, formulas.signature)
    _, beaten = panel_sums.panel_sums(value, bound[0], own)

    @register_jitable(error_model="numpy")
    @own
    def panels_first(theta: Array, limit: float, data: Any, scratch: Any) -> float:
        if limit < np.inf and beaten(as_tuple(theta, d), limit, scratch, data[1])[0]:
            return limit
        found: float = of_rows(theta, limit, data, scratch)
        return found

    return compiled_climb(panels_first, formulas.signature)


def _mean_square(
    value: Formula, own: Sign, p: int, d: int
) -> Callable[[Array, float, _Data], float]:
    """The loss, which numba can compile: given up as soon as it is not below the limit."""
    columns = columns_of(p)

    @register_jitable(error_model="numpy")
    @own
    def loss(theta: Array, limit: float, data: _Data) -> float:
        X, y, size = data  # y may be the first part of X's rows
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


def cause(error: NumbaError) -> str:
    """The line of numba's message that says why something cannot be compiled."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return next((line for line in lines if line.startswith(CAUSES)), lines[0])


def read_only(array: Array) -> Array:
    """The numbers in their order in memory, for compiled code that only reads them.

    Numba compiles anew for arrays that may be written and for those that may not.
    """
    view = np.ascontiguousarray(array, dtype=float).view()
    view.flags.writeable = False
    return view


@register_jitable
def as_tuple(theta: Array, d: int) -> tuple[float, ...]:
    """Parameters (d,) as the tuple that a formula takes; compiled code needs its length."""
    parameters: tuple[float, ...] = to_fixed_tuple(theta, d)
    return parameters


def _store(values: Any, found: Any) -> None:
    """Put columns, or numbers for a whole column, into the first ones of `found` (d, .)."""
    for k, value in enumerate(values):
        _put(value, found[k])


@overload(_store)
def _unrolled_columns(values: Any, found: Any) -> Callable[..., None]:
    last = len(values) - 1

    def store(values: Any, found: Any) -> None:
        _store(values[:last], found)
        _put(values[last], found[last])

    def nothing(values: Any, found: Any) -> None:
        pass

    return nothing if last < 0 else store


def _put(values: Any, to: Any) -> None:
    """Copy values (n,), or the same one n times."""
    to[:] = values


@overload(_put)
def _put_compiled(values: Any, to: Any) -> Callable[..., None]:
    """Element by element: numba's own copy takes seconds to compile, for what it says of shapes."""

    def each(values: Any, to: Any) -> None:
        if values.size != to.size and values.size != 1:
            raise ValueError("as many values are needed as there are rows")
        for i in range(to.size):
            to[i] = values[i if values.size > 1 else 0]

    def same(values: Any, to: Any) -> None:
        for i in range(to.size):
            to[i] = values

    return each if isinstance(values, types.Array) else same


def _store_row(values: Any, found: Array, row: int) -> None:
    """Put the values into a row of columns (d, .)."""
    for k, value in enumerate(values):
        found[k, row] = value


@overload(_store_row)
def _unrolled(values: Any, found: Array, row: int) -> Callable[..., None]:
    """One value after the other, known to the compiler, so that it can do many rows at once."""
    last = len(values) - 1

    def store(values: Any, found: Array, row: int) -> None:
        found[last, row] = values[last]
        _store_row(values[:last], found, row)

    def nothing(values: Any, found: Array, row: int) -> None:
        pass

    return nothing if last < 0 else store


@register_jitable
def _add(to: Array, what: Array) -> None:
    for i in range(what.size):
        to[i] += what[i]


@register_jitable
def sum_of_squares(r: Array) -> float:
    """The sum of r^2, in pairs from both halves, which the processor adds side by side."""
    r *= r
    n = r.size
    while n > 8:
        half = (n + 1) // 2
        _add(r[: n - half], r[half:n])
        n = half
    total = 0.0
    for i in range(n):
        total += r[i]
    return total


def columns_of(p: int) -> Any:
    """(X, i, j) -> rows i to j of columns (p, N) as a tuple: compiled code needs its length."""
    k = p - 1
    if not k:
        return register_jitable(lambda X, i, j: (X[k, i:j],))
    before = columns_of(k)
    return register_jitable(lambda X, i, j: (*before(X, i, j), X[k, i:j]))


def inputs_of(p: int) -> Any:
    """(columns, row) -> one row of p columns as a tuple, likewise."""
    k = p - 1
    if not k:
        return register_jitable(lambda columns, row: (columns[k][row],))
    before = inputs_of(k)
    return register_jitable(lambda columns, row: (*before(columns, row), columns[k][row]))
