"""Arrays in compiled code: tuples of rows and columns, copies, a sum of squares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
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
        assign(value, out[k])


@overload(store_columns)
def _unrolled_columns(values: Any, out: Any) -> Callable[..., None]:
    last = len(values) - 1

    def store(values: Any, out: Any) -> None:
        store_columns(values[:last], out)
        assign(values[last], out[last])

    def nothing(values: Any, out: Any) -> None:
        pass

    return nothing if last < 0 else store


def assign(values: Any, out: Any) -> None:
    """Copy values (n,) or (1,), or one number, into out (n,)."""
    out[:] = values


@overload(assign)
def _assign_compiled(values: Any, out: Any) -> Callable[..., None]:
    """Element by element: numba's own copy takes seconds to compile, for its checks of shapes."""

    def from_array(values: Any, out: Any) -> None:
        if values.size != out.size and values.size != 1:
            raise ValueError("as many values are needed as there are rows")
        for i in range(out.size):
            out[i] = values[i if values.size > 1 else 0]

    def from_number(values: Any, out: Any) -> None:
        for i in range(out.size):
            out[i] = values

    return from_array if isinstance(values, types.Array) else from_number


def store_row(values: Any, out: Array, row: int) -> None:
    """Put the values into a row of columns (d, .)."""
    for k, value in enumerate(values):
        out[k, row] = value


@overload(store_row)
def _unrolled(values: Any, out: Array, row: int) -> Callable[..., None]:
    """Unrolled, value by value: the compiler can then work on many rows at once."""
    last = len(values) - 1

    def store(values: Any, out: Array, row: int) -> None:
        out[last, row] = values[last]
        store_row(values[:last], out, row)

    def nothing(values: Any, out: Array, row: int) -> None:
        pass

    return nothing if last < 0 else store


@register_jitable
def _add(total: Array, terms: Array) -> None:
    for i in range(terms.size):
        total[i] += terms[i]


@register_jitable
def sum_of_squares(r: Array) -> float:
    """The sum of r^2: the second half is added to the first until few are left. Overwrites r.

    The processor adds the halves side by side, and the order of the sum does not depend on it.
    """
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


def columns_getter(p: int) -> Any:
    """(X, i, j) -> rows i to j of columns (p, N) as a tuple: compiled code needs its length."""
    k = p - 1
    if not k:
        return register_jitable(lambda X, i, j: (X[k, i:j],))
    first_columns = columns_getter(k)
    return register_jitable(lambda X, i, j: (*first_columns(X, i, j), X[k, i:j]))


def row_getter(p: int) -> Any:
    """(columns, row) -> one row of p columns as a tuple."""
    k = p - 1
    if not k:
        return register_jitable(lambda columns, row: (columns[k][row],))
    first_inputs = row_getter(k)
    return register_jitable(lambda columns, row: (*first_inputs(columns, row), columns[k][row]))
