"""Small least-squares problems by orthogonal transformations."""

from __future__ import annotations

import math
import sys

from miho.compiled.workspace import SolverScratch
from miho.quantities import Array

SINGULAR = 1e-14
"""A pivot below this share of the largest pivot, or of its column, counts as 0: its parameter
depends on the previous ones, and stays unchanged while the same others are free."""
DEPENDENT = 0.5
"""Marks such a parameter; free parameters have 1, parameters at a bound 0."""
SMALLEST = sys.float_info.min
"""The smallest normal number."""


def square_sum(r: Array, count: int) -> float:
    """Sum of the squares of the first residuals."""
    return float(r[:count] @ r[:count])


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


def solve_in_box(
    R: Array,
    q: Array,
    scale: Array,
    low: Array,
    high: Array,
    n: int,
    s: Array,
    scratch: SolverScratch,
) -> None:
    """Minimise |R s + q|^2 + |scale s|^2 within low <= s <= high, into s, by an active set.

    R is triangular in its first n rows and columns; q, scale, low and high are (n,) or longer, low
    <= 0 <= high. First, all parameters that the solution would take out of the box are fixed at its
    bounds at once, and the others are solved again. Then the fixed parameter with the steepest
    inward gradient is freed, and the step to the new solution ends at the first bound, so that each
    step decreases the sum of squares, until the Karush-Kuhn-Tucker conditions hold [1]_, or 3 n
    parameters were freed.

    References
    ----------
    .. [1] P. B. Stark, R. L. Parker, "Bounded-variable least-squares", Computational Statistics 10
       (1995) 129-141.
    """
    free = scratch.free
    for k in range(n):
        s[k], free[k] = 0.0, 1.0
    while _minimise_free(R, q, scale, low, high, n, s, False, scratch):
        pass
    for _ in range(3 * n):
        steepest, candidate = 0.0, -1
        for k in range(n):
            if free[k]:
                continue
            slope = scale[k] * scale[k] * s[k]
            for row in range(k + 1):
                slope += R[row, k] * row_of(R, q, n, s, row)
            inward = slope < 0 if s[k] <= low[k] else slope > 0
            if inward and abs(slope) > steepest:
                steepest, candidate = abs(slope), k
        if candidate < 0:
            return
        free[candidate] = 1.0
        while _minimise_free(R, q, scale, low, high, n, s, True, scratch):
            pass


def row_of(R: Array, q: Array, n: int, s: Array, row: int) -> float:
    """One row of R s + q."""
    value = 0.0
    for k in range(row, n):
        value += R[row, k] * s[k]
    return value + float(q[row])


def norm(R: Array, q: Array, n: int, s: Array) -> float:
    """|R s + q|^2."""
    total = 0.0
    for row in range(n):
        value = row_of(R, q, n, s, row)
        total += value * value
    return total


def factor_of_free(
    R: Array, q: Array, scale: Array, n: int, s: Array, scratch: SolverScratch
) -> int:
    """Factor of the free parameters, the others fixed, into scratch.T; returns their number."""
    free, columns, T = scratch.free, scratch.columns, scratch.T
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


def independent(n: int, count: int, scratch: SolverScratch) -> bool:
    """Whether no free parameter depends on previous ones; marks the first that does.

    The factor must then be computed again without it: its column has only rounding left, but uses a
    row of the factor.
    """
    T, largest, j = scratch.T, 0.0, 0
    for k in range(count):
        largest = max(largest, abs(T[k, k]))
    for k in range(n):
        if scratch.free[k] == 1.0:
            norm = 0.0
            for row in range(j + 1):
                norm = max(norm, abs(T[row, j]))
            if abs(T[j, j]) <= SINGULAR * max(largest, norm):
                scratch.free[k] = DEPENDENT
                return False
            j += 1
    return True


def _minimise_free(
    R: Array,
    q: Array,
    scale: Array,
    low: Array,
    high: Array,
    n: int,
    s: Array,
    stop: bool,
    scratch: SolverScratch,
) -> bool:
    """Move the free parameters to their minimum, and parameters that leave the box to its bounds.

    With `stop` they move on the straight line to the minimum up to the first bound. Parameters that
    reach a bound are fixed there; returns whether any did.
    """
    free, solution, T = scratch.free, scratch.solution, scratch.T
    # The factor of the free parameters, without those that depend on others.
    for k in range(n):
        if free[k] == DEPENDENT:
            free[k] = 1.0
    count = factor_of_free(R, q, scale, n, s, scratch)
    while not independent(n, count, scratch):
        count = factor_of_free(R, q, scale, n, s, scratch)
    # Their minimum, by back substitution.
    for j in range(count - 1, -1, -1):
        right = -T[j, count]
        for other in range(j + 1, count):
            right -= T[j, other] * solution[other]
        solution[j] = right / T[j, j]
    # Share of the step up to the first bound.
    share, j = 1.0, 0
    for k in range(n):
        if free[k] == 1.0:
            bound = min(max(solution[j], low[k]), high[k])
            if stop and bound != solution[j]:
                share = min(share, (bound - s[k]) / (solution[j] - s[k]))
            j += 1
    # Make the step, and fix parameters that reach a bound.
    fixed, j = False, 0
    for k in range(n):
        if free[k] == 1.0:
            bound = min(max(solution[j], low[k]), high[k])
            if bound != solution[j] and (
                not stop or (bound - s[k]) / (solution[j] - s[k]) <= share
            ):
                s[k], free[k], fixed = bound, 0.0, True
            elif share < 1.0:
                s[k] = min(max(s[k] + share * (solution[j] - s[k]), low[k]), high[k])
            else:
                s[k] = solution[j]
            j += 1
    return fixed
