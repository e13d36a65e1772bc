"""Small least-squares problems by orthogonal transformations, compiled."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

from numba import njit
from numba.extending import register_jitable

from miho.compiled.signature import signature_of, signed
from miho.quantities import Array

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
"""No array is made here: without the counting of references to them, which costs more than a step
of a few rows does."""
Function = TypeVar("Function", bound=Callable[..., Any])

_signed = signed(signature_of())


def entry(function: Function) -> Function:
    """Compiled and cached, to be called from Python.

    Each one costs seconds to compile, since it is translated with all that it calls: they are few,
    and take arrays whose type is always the same (a view of one row is another type than of two).
    """
    return cast(Function, njit(cache=True, **OPTIONS)(_signed(function)))


def in_cache(function: Any) -> bool:
    """Whether numba has compiled an entry before; then it need not now."""
    name = function.py_func.__qualname__
    return any(Path(function.stats.cache_path).glob(f"*.{name}-*.nbi"))


def _part(**options: Any) -> Callable[[Function], Function]:
    """Compiled as a part of those that call it, without an entry and a place in the cache.

    Called from Python it is the Python function, and slow.
    """

    def register(function: Function) -> Function:
        return cast(Function, register_jitable(**OPTIONS, **options)(_signed(function)))

    return register


compiled = _part()
summing = _part(fastmath={"reassoc", "contract", "nsz"})
"""Parts; the second for sums over rows in any order, so that the processor adds side by side."""

SINGULAR = 1e-14
"""A pivot below this share of the largest one, or of its column, is 0: its parameter is left where
it is, as long as the same others are free."""
LEFT = 0.5
"""Marks such a parameter, among those that are free (1) and those at a bound (0)."""


@summing
def square_sum(r: Array, count: int) -> float:
    """The sum of the squares of the first residuals."""
    total = 0.0
    for i in range(count):
        total += r[i] * r[i]
    return total


@summing
def fold(T: Array, columns: Array, count: int, n: int) -> None:
    """Take `count` rows, given as n columns, into the triangular factor T of all rows before.

    Householder reflections of T stacked on the rows (Golub and Van Loan, Matrix Computations,
    section 5.2): the factor of any number of rows, chunk by chunk. The columns are used up.
    """
    for k in range(n):
        v = columns[k]
        square = 0.0
        for i in range(count):
            square += v[i] * v[i]
        if square == 0.0:
            continue
        diagonal = T[k, k]
        norm = -math.copysign(math.sqrt(diagonal * diagonal + square), diagonal)
        first = diagonal - norm
        T[k, k] = norm
        factor = 2.0 / (first * first + square)
        for j in range(k + 1, n):
            other = columns[j]
            product = first * T[k, j]
            for i in range(count):
                product += v[i] * other[i]
            product *= factor
            T[k, j] -= product * first
            for i in range(count):
                other[i] -= product * v[i]


class Room(NamedTuple):
    """Where a solution of at most d parameters is made: what it holds is of no account after."""

    free: Array
    found: Array
    columns: Array
    T: Array


@compiled
def solve_in_box(
    R: Array, q: Array, scale: Array, low: Array, high: Array, n: int, s: Array, room: Room
) -> None:
    """Minimise |R s + q|^2 + |scale s|^2 within low <= s <= high, into s, by an active set.

    R is triangular in its first n rows and columns; q, scale, low and high are (n,) or longer, low
    <= 0 <= high. Parameters that a solution would take out of the box are held at its bounds, all
    at once as long as none was let go again. Then the one with the steepest gradient inwards is let
    go, and the way to the solution ends at the first bound, so that each makes the sum of squares
    less, until Karush's, Kuhn's and Tucker's conditions hold (Stark and Parker, Computational
    Statistics 10, 1995), or n have been let go three times.
    """
    free = room.free
    for k in range(n):
        s[k], free[k] = 0.0, 1.0
    while _minimise_free(R, q, scale, low, high, n, s, False, room):
        pass
    for _ in range(3 * n):
        steepest, which = 0.0, -1
        for k in range(n):
            if free[k]:
                continue
            slope = scale[k] * scale[k] * s[k]
            for row in range(k + 1):
                slope += R[row, k] * row_of(R, q, n, s, row)
            inward = slope < 0 if s[k] <= low[k] else slope > 0
            if inward and abs(slope) > steepest:
                steepest, which = abs(slope), k
        if which < 0:
            return
        free[which] = 1.0
        while _minimise_free(R, q, scale, low, high, n, s, True, room):
            pass


@compiled
def row_of(R: Array, q: Array, n: int, s: Array, row: int) -> float:
    """A row of R s + q."""
    value = 0.0
    for k in range(row, n):
        value += R[row, k] * s[k]
    return value + float(q[row])


@compiled
def norm(R: Array, q: Array, n: int, s: Array) -> float:
    """|R s + q|^2."""
    total = 0.0
    for row in range(n):
        total += row_of(R, q, n, s, row) ** 2
    return total


@compiled
def factor_of_free(R: Array, q: Array, scale: Array, n: int, s: Array, room: Room) -> int:
    """The factor of the free parameters with the others held, into room.T; how many are free."""
    free, columns, T = room.free, room.columns, room.T
    count = 0
    for k in range(n):
        if free[k] == 1.0:
            for row in range(n):
                columns[count, row] = R[row, k] if row <= k else 0.0
                columns[count, n + row] = scale[k] if row == k else 0.0
            count += 1
    for row in range(n):
        right = q[row]
        for k in range(row, n):
            if free[k] != 1.0:
                right += R[row, k] * s[k]
        columns[count, row], columns[count, n + row] = right, 0.0
    for j in range(count + 1):
        for k in range(count + 1):
            T[j, k] = 0.0
    fold(T, columns, 2 * n, count + 1)
    return count


@compiled
def independent(n: int, count: int, room: Room) -> bool:
    """Whether no free parameter depends on those before it; the first that does is free no more.

    Its column cannot just be skipped: what is left of it is rounding, but takes a row of the
    factor.
    """
    T, largest, j = room.T, 0.0, 0
    for k in range(count):
        largest = max(largest, abs(T[k, k]))
    for k in range(n):
        if room.free[k] == 1.0:
            norm = 0.0
            for row in range(j + 1):
                norm = max(norm, abs(T[row, j]))
            if abs(T[j, j]) <= SINGULAR * max(largest, norm):
                room.free[k] = LEFT
                return False
            j += 1
    return True


@compiled
def _minimise_free(
    R: Array,
    q: Array,
    scale: Array,
    low: Array,
    high: Array,
    n: int,
    s: Array,
    stop: bool,
    room: Room,
) -> bool:
    """Move the free parameters to their minimum, those that leave the box to its bounds.

    Or, where they are to `stop`, on the straight way to it as far as the first bound. Gives whether
    any came to a bound, and is free no longer.
    """
    free, found, T = room.free, room.found, room.T
    for k in range(n):
        if free[k] == LEFT:
            free[k] = 1.0
    count = factor_of_free(R, q, scale, n, s, room)
    while not independent(n, count, room):
        count = factor_of_free(R, q, scale, n, s, room)
    for j in range(count - 1, -1, -1):
        right = -T[j, count]
        for other in range(j + 1, count):
            right -= T[j, other] * found[other]
        found[j] = right / T[j, j]
    share, j = 1.0, 0
    for k in range(n):
        if free[k] == 1.0:
            bound = min(max(found[j], low[k]), high[k])
            if stop and bound != found[j]:
                share = min(share, (bound - s[k]) / (found[j] - s[k]))
            j += 1
    left, j = False, 0
    for k in range(n):
        if free[k] == 1.0:
            bound = min(max(found[j], low[k]), high[k])
            if bound != found[j] and (not stop or (bound - s[k]) / (found[j] - s[k]) <= share):
                s[k], free[k], left = bound, 0.0, True
            elif share < 1.0:
                s[k] = min(max(s[k] + share * (found[j] - s[k]), low[k]), high[k])
            else:
                s[k] = found[j]
            j += 1
    return left
