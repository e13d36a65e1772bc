"""Small least-squares problems by orthogonal transformations."""

from __future__ import annotations

import math
import sys

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array, Integers

Mask = NDArray[np.bool_]
SINGULAR = 1e-14
"""A pivot below this share of the largest pivot, or of its column, counts as 0: its parameter
depends on the previous ones, and stays unchanged while the same others are free."""
SMALLEST = sys.float_info.min
"""The smallest normal number."""


def square_sum(r: Array, count: int) -> float:
    """Sum of the squares of the first residuals."""
    return float(r[:count] @ r[:count])


def between(low: Array | float, x: Array, high: Array | float) -> Array:
    """The numbers x, or their nearest bounds; faster than `numpy.clip` for few of them."""
    return np.asarray(np.minimum(np.maximum(x, low), high))


def in_order(values: Array) -> float:
    """Sum of values (n,) from the first to the last, as the machine adds them."""
    total = 0.0
    for value in values.tolist():
        total += value
    return total


def product(R: Array, s: Array) -> Array:
    """R s of a triangular R (n, n) and s (n,), with sums as by `in_order`."""
    values = np.zeros(s.size)
    for k in range(s.size):
        values[: k + 1] += R[: k + 1, k] * s[k]
    return values


def fold(T: Array, columns: Array, count: int, n: int) -> None:
    """Update T, the triangular factor of all previous rows, by `count` rows, given as n columns.

    By Householder reflections of T stacked on the rows (Golub and Van Loan, Matrix Computations,
    section 5.2), which gives the factor of any number of rows, chunk by chunk. Overwrites the
    columns.
    """
    rows = columns[:n, :count]
    for k in range(n):
        v, diagonal = rows[k], T[k, k]
        square = v @ v
        if square < SMALLEST:  # a column of zeros: 1 / square would overflow
            continue
        norm = -math.copysign(math.sqrt(diagonal * diagonal + square), diagonal)
        first = diagonal - norm
        T[k, k] = norm
        others = rows[k + 1 :]
        products = (first * T[k, k + 1 : n] + others @ v) * (2.0 / (first * first + square))
        T[k, k + 1 : n] -= products * first
        others -= products[:, None] * v


def solve_in_box(R: Array, q: Array, scale: Array, low: Array, high: Array, s: Array) -> None:
    """Minimise |R s + q|^2 + |scale s|^2 within low <= s <= high, into s (n,), by an active set.

    R is triangular in its first n rows and columns; the other arrays are (n,) or longer, low <= 0
    <= high. First, all parameters that the solution would take out of the box are fixed at its
    bounds at once, and the others are solved again. Then the fixed parameter with the steepest
    inward gradient is freed, and the step to the new solution ends at the first bound, so that each
    step decreases the sum of squares, until the Karush-Kuhn-Tucker conditions hold [1]_, or 3 n
    parameters were freed.

    References
    ----------
    .. [1] P. B. Stark, R. L. Parker, "Bounded-variable least-squares", Computational Statistics 10
       (1995) 129-141.
    """
    n = s.size
    R, q, scale, low, high = R[:n, :n], q[:n], scale[:n], low[:n], high[:n]
    s[:], fixed = 0.0, np.zeros(n, dtype=bool)
    while _minimise_free(R, q, scale, low, high, s, fixed, False):
        pass
    for _ in range(3 * n):
        slopes, residuals = scale * scale * s, product(R, s) + q
        for row in range(n):
            slopes[row:] += R[row, row:] * residuals[row]
        inward = fixed & np.where(s <= low, slopes < 0, slopes > 0)
        if not inward.any():
            return
        fixed[np.argmax(np.where(inward, np.abs(slopes), 0.0))] = False
        while _minimise_free(R, q, scale, low, high, s, fixed, True):
            pass


def norm(R: Array, q: Array, s: Array) -> float:
    """|R s + q|^2 of the first rows and columns of R, as many as s (n,) has."""
    values = product(R, s) + q[: s.size]
    return in_order(values * values)


def factor_of(is_free: Mask, R: Array, q: Array, scale: Array, s: Array) -> tuple[Integers, Array]:
    """Free parameters, and the triangular factor of them, with the others fixed at s."""
    free = is_free.nonzero()[0]
    n, count = s.size, free.size
    columns = np.zeros((count + 1, 2 * n))
    columns[:count, :n] = R[:, free].T
    columns[np.arange(count), n + free] = scale[free]
    right = columns[count, :n]
    right[:] = q
    for k in (~is_free).nonzero()[0]:
        right[: k + 1] += R[: k + 1, k] * s[k]
    T = np.zeros((count + 1, count + 1))
    fold(T, columns, 2 * n, count + 1)
    return free, T


def dependent(T: Array) -> Integers:
    """Columns of a factor, but for its last one, that depend on previous ones."""
    sizes = np.abs(T[:-1, :-1])
    pivots = sizes.diagonal()
    largest = np.fmax(np.fmax.reduce(sizes, axis=0, initial=0.0), np.fmax.reduce(pivots, initial=0))
    return np.asarray((pivots <= SINGULAR * largest).nonzero()[0])


def _minimise_free(
    R: Array, q: Array, scale: Array, low: Array, high: Array, s: Array, fixed: Mask, stop: bool
) -> bool:
    """Move the free parameters to their minimum, and parameters that leave the box to its bounds.

    With `stop` they move on the straight line to the minimum up to the first bound. Parameters that
    reach a bound are fixed there; returns whether any did.
    """
    # The factor of the free parameters. Without the first one that depends on others it must be
    # computed again: the column of that one has only rounding left, but uses a row of the factor.
    is_free = ~fixed
    free, T = factor_of(is_free, R, q, scale, s)
    while (out := dependent(T)).size:
        is_free[free[out[0]]] = False
        free, T = factor_of(is_free, R, q, scale, s)
    # Their minimum, by back substitution.
    to = np.empty(free.size)
    for j in range(free.size - 1, -1, -1):
        right = -T[j, -1]
        for k in range(j + 1, free.size):
            right -= T[j, k] * to[k]
        to[j] = right / T[j, j]
    # Make the step, up to the first bound with `stop`, and fix parameters that reach a bound.
    at, bounds = s[free], between(low[free], to, high[free])
    reaches, share = bounds != to, 1.0
    if stop:
        shares = np.where(reaches, (bounds - at) / np.where(reaches, to - at, 1.0), np.inf)
        share = float(np.fmin.reduce(shares, initial=share))
        reaches &= shares <= share
    if share < 1.0:
        to = between(low[free], at + share * (to - at), high[free])
    s[free] = np.where(reaches, bounds, to)
    fixed[free[reaches]] = True
    return bool(reaches.any())
