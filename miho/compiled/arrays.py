"""What compiled code needs of arrays: tuples of rows and columns, copies, a sum of squares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import typeof, types
from numba.core.errors import NumbaError
from numba.extending import overload, register_jitable
from numba.np.unsafe.ndarray import to_fixed_tuple

from miho.quantities import Array

CAUSES = (
    "Untyped global name",
    "Use of unsupported",
    "Unknown attribute",
    "Cannot unify",
    "No impl",
)


class Callee:
    """A compiled function to be passed to compiled code, with its type worked out once.

    numba does so at each call, in 15 us: as long as a step on a hundred rows takes.
    """

    def __init__(self, function: Any) -> None:
        self._function = function  # whose code lives as long as it does
        self._numba_type_ = typeof(function)

    def __wrapper_address__(self) -> int:
        return int(self._function.address)


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


def store_columns(values: Any, out: Any) -> None:
    """Put columns, or numbers for a whole column, into the first ones of `out` (d, .)."""
    for k, value in enumerate(values):
        put(value, out[k])


@overload(store_columns)
def _unrolled_columns(values: Any, out: Any) -> Callable[..., None]:
    last = len(values) - 1

    def store(values: Any, out: Any) -> None:
        store_columns(values[:last], out)
        put(values[last], out[last])

    def nothing(values: Any, out: Any) -> None:
        pass

    return nothing if last < 0 else store


def put(values: Any, to: Any) -> None:
    """Copy values (n,), or the same one n times."""
    to[:] = values


@overload(put)
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


def store_row(values: Any, out: Array, row: int) -> None:
    """Put the values into a row of columns (d, .)."""
    for k, value in enumerate(values):
        out[k, row] = value


@overload(store_row)
def _unrolled(values: Any, out: Array, row: int) -> Callable[..., None]:
    """One value after the other, known to the compiler, so that it can do many rows at once."""
    last = len(values) - 1

    def store(values: Any, out: Array, row: int) -> None:
        out[last, row] = values[last]
        store_row(values[:last], out, row)

    def nothing(values: Any, out: Array, row: int) -> None:
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
