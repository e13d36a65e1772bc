"""Gauss-Newton steps on residuals and derivatives that a problem gives one at a time: the parts
between two evaluations, compiled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from miho.compiled.gauss_newton import evaluated, factored, prepare, refold, solve_linear, to_units
from miho.compiled.gauss_newton_state import ENTER, TRIED, Box, Minima, Rules, views
from miho.compiled.triangular import entry, square_sum
from miho.compiled.workspace import Work, copy
from miho.quantities import Array

Whole = NDArray[np.int64]


@entry
def next_outside(
    numbers: Array, counts: Whole, R: Array, rows: Array, i: int, box: Box, m: int,
    minima: Minima, rules: Rules, w: Work,
) -> int:  # fmt: skip
    """The next configuration from i on that needs an evaluation, the place for it in w.theta.

    Their number where none does.
    """
    c = views(numbers, counts, R, rows)
    while i < c.stage.size and not prepare(c, i, box, m, minima, rules, w):
        i += 1
    if i < c.stage.size:
        trial = c.stage[i] == ENTER or c.stage[i] == TRIED
        to_units(c.trial[i] if trial else c.x[i], box, w.theta)
    return i


@entry
def entering_outside(
    numbers: Array, counts: Whole, R: Array, rows: Array, box: Box, which: Whole, thetas: Array
) -> int:
    """How many are to be looked at for the first time, without projection; which, and where."""
    c = views(numbers, counts, R, rows)
    count = 0
    for i in range(c.stage.size):
        if c.stage[i] == ENTER and not c.projects[i]:
            which[count] = i
            to_units(c.trial[i], box, thetas[count])
            count += 1
    return count


@entry
def looked_outside(
    numbers: Array, counts: Whole, R: Array, rows: Array, which: Whole, r: Array, in_order: Array,
    box: Box, ends: Whole, rules: Rules, best: float, w: Work,
) -> None:  # fmt: skip
    """As `evaluated`, of residuals (k, m); `in_order` are those in the order of the levels."""
    c = views(numbers, counts, R, rows)
    m = r.shape[1]
    for k in range(which.size):
        copy(r[k], w.residuals)
        for level in range(ends.size):
            w.sums[level] = square_sum(in_order[k], min(ends[level], m))
        loss = square_sum(w.residuals, m) / m
        evaluated(c, which[k], loss, box, m, rules, best, w)


@entry
def evaluated_outside(
    numbers: Array, counts: Whole, R: Array, rows: Array, i: int, loss: float, box: Box, m: int,
    rules: Rules, best: float, w: Work,
) -> None:  # fmt: skip
    """As `evaluated`."""
    evaluated(views(numbers, counts, R, rows), i, loss, box, m, rules, best, w)


@entry
def factored_outside(
    numbers: Array, counts: Whole, R: Array, rows: Array, i: int, box: Box, columns: Array,
    count: int, w: Work,
) -> None:  # fmt: skip
    """The factor of the first `count` of the columns (d + 1, m) and of the residuals, the last."""
    refold(columns, count, columns.shape[0] - 1, columns.shape[1], w)
    factored(views(numbers, counts, R, rows), i, box, w)


@entry
def solved_outside(
    numbers: Array, counts: Whole, R: Array, rows: Array, i: int, box: Box, columns: Array, w: Work
) -> float:
    """As `solve_linear`, with the columns of the linear parameters and of the residuals (., m)."""
    p, m = box.linear.size, columns.shape[1]
    refold(columns, p, p, m, w)
    return float(solve_linear(views(numbers, counts, R, rows), i, box, m, w))
