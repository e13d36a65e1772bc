"""Functions in memory, called by their addresses: from Python, and from compiled code alike.

Compiled code that is given an address serves all functions that are called alike, such as the
residuals of any formula, and numba can keep it on disk. All arguments are whole numbers, addresses
of arrays among them, as `miho/core/tape.h` declares them. Importing this imports no numba; the
compiled forms are those of `miho.compiled.calls`.
"""

from __future__ import annotations

import ctypes

from miho.compiled.triangular import compiled
from miho.quantities import Array, Integers

RESIDUALS, COLUMNS, VALUE, SLOPES = range(4)
"""In `Rows.calls`: addresses of two functions, and of the tape that each is given."""


def call(function: int, a: int, b: int, c: int, d: int, e: int, f: int, g: int, h: int) -> None:
    """Call the function of eight whole numbers at an address."""
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 8)
    kind(int(function))(*map(int, (a, b, c, d, e, f, g, h)))


@compiled
def write_residuals(
    calls: Integers, theta: Array, X: Array, y: Array, i: int, j: int, r: Array
) -> None:
    """Write the residuals of rows i to j to r (j - i,); `Rows` describes `calls`, X and y."""
    call(
        calls[RESIDUALS], calls[VALUE], theta.ctypes.data, X.ctypes.data, X.shape[1],
        y.ctypes.data, i, j, r.ctypes.data,
    )  # fmt: skip


@compiled
def write_slopes(calls: Integers, theta: Array, X: Array, i: int, j: int, J: Array) -> None:
    """Write their derivatives to the first columns of J (d, j - i or more)."""
    call(
        calls[COLUMNS], calls[SLOPES], theta.ctypes.data, X.ctypes.data, X.shape[1], i, j,
        J.ctypes.data, J.shape[1],
    )  # fmt: skip
