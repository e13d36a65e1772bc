"""Gauss-Newton steps on compiled rows of data, without Python in between.

All configurations of a rung make their steps in one call, and derivatives are folded into
triangular factors as they come, so that any number of rows takes no room.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.compiled.gauss_newton import evaluated, factored, is_free, prepare, solve_linear, to_units
from miho.compiled.gauss_newton_state import (
    RECORD,
    SLOPES,
    UNUSABLE,
    Box,
    Candidates,
    Minima,
    Rules,
    views,
)
from miho.compiled.triangular import compiled, entry, fold, square_sum
from miho.compiled.workspace import CHUNK, Work, clear, work
from miho.quantities import Array

Whole = NDArray[np.int64]

FINISHED, PAUSED = range(2)
"""Whether a block of steps was done to its end, or the next evaluation is beyond its allowance."""


@entry
def advance(
    residuals: Any,
    slopes: Any,
    X: Array,
    y: Array,
    numbers: Array,
    counts: Whole,
    R: Array,
    rows: Array,
    box: Box,
    ends: Whole,
    minima: Minima,
    rules: Rules,
    slope_cost: int,
    most: int,
    best: float,
    target: float,
    at: Whole,
    losses: Array,
    thetas: Array,
    room: Array,
) -> tuple[int, int, int, int, int, int]:
    """Give each configuration its steps: (state, rows spent, improvements, NaN, inf, unusable).

    `residuals(theta, X, y, i, j, r)` and `slopes(theta, X, i, j, J)` are compiled and give those of
    rows i to j. No more than `most` rows are spent; improvements of `best` are listed with the rows
    up to and with them, and end the block where they reach `target`. `room` is for `work`.
    """
    c = views(numbers, counts, R, rows)
    w = work(room, R.shape[1], ends[rules.level] if rows.shape[2] else CHUNK, ends.size)
    m = ends[rules.level]
    spent = found = nans = infinities = unusable = 0
    for i in range(c.x.shape[0]):
        while prepare(c, i, box, m, minima, rules, w):
            stage = c.stage[i]
            project = c.projects[i] and stage != RECORD
            cost = m * (box.linear.size + 1 if project else 1)
            if stage == SLOPES:
                cost = m * slope_cost
            if spent + cost > most:
                return PAUSED, spent, found, nans, infinities, unusable
            spent += cost
            c.spent[i] += cost
            if stage == SLOPES:
                to_units(c.x[i], box, w.theta)
                fill(residuals, slopes, X, y, c, i, box, m, False, w)
                factored(c, i, box, w)
                unusable += c.stage[i] == UNUSABLE
                continue
            to_units(c.x[i] if stage == RECORD else c.trial[i], box, w.theta)
            loss = look(residuals, X, y, ends, m, c.rows.shape[2] > 0 and not project, w) / m
            nans += math.isnan(loss)
            infinities += math.isinf(loss)
            if m == y.size and loss < best:
                best = loss
                at[found], losses[found] = spent - cost + m, loss
                for k in range(w.theta.size):
                    thetas[found, k] = w.theta[k]
                found += 1
            if project and math.isfinite(loss):
                fill(residuals, slopes, X, y, c, i, box, m, True, w)
                loss = solve_linear(c, i, box, m, w)
            evaluated(c, i, loss, box, m, rules, best, w)
            if best <= target:
                return FINISHED, spent, found, nans, infinities, unusable
    return FINISHED, spent, found, nans, infinities, unusable


@compiled
def look(residuals: Any, X: Array, y: Array, ends: Whole, m: int, keep: bool, w: Work) -> float:
    """The sum of squares at w.theta over m rows, and in w.sums over those of each level."""
    total, start = 0.0, 0
    for level in range(ends.size):
        end = min(ends[level], m)
        while start < end:
            count = min(CHUNK, end - start)
            r = w.residuals[start : start + count] if keep else w.residuals[:count]
            residuals(w.theta, X, y, start, start + count, r)
            total += square_sum(r, count)
            start += count
        w.sums[level] = total
    return total


@compiled
def fill(
    residuals: Any,
    slopes: Any,
    X: Array,
    y: Array,
    c: Candidates,
    i: int,
    box: Box,
    m: int,
    only_linear: bool,
    w: Work,
) -> None:
    """The factor of derivatives and residuals at w.theta, into w.T, one chunk after the other.

    Of the linear parameters alone, in box widths; or of all in unit coordinates, as `factored`
    takes them.
    """
    d = w.theta.size
    keep = c.rows.shape[2] > 0 and not c.projects[i]
    J, chunk = w.slopes, w.chunk
    clear(w.T)
    for start in range(0, m, CHUNK):
        count = min(CHUNK, m - start)
        slopes(w.theta, X, start, start + count, J)
        n = 0
        if only_linear or c.projects[i]:
            for k in box.linear:
                if only_linear or is_free(c.x[i, k]):
                    column(J[k], box.high[k] - box.low[k], count, chunk[n])
                    n += 1
        if not only_linear:
            for k in range(d):
                if c.projects[i] and is_linear(k, box):
                    continue
                width = box.width[k] * (w.theta[k] if box.log[k] else 1.0)
                column(J[k], width, count, chunk[n])
                if keep:
                    for row in range(count):
                        c.rows[i, k, start + row] = chunk[n, row]
                n += 1
        if keep:
            for row in range(count):
                chunk[n, row] = c.rows[i, d, start + row]
        else:
            residuals(w.theta, X, y, start, start + count, chunk[n, :count])
        fold(w.T, chunk, count, n + 1)


@compiled
def column(slopes: Array, width: float, count: int, into: Array) -> None:
    """Derivatives in coordinates of this width."""
    for row in range(count):
        into[row] = slopes[row] * width


@compiled
def is_linear(k: int, box: Box) -> bool:
    """Whether a parameter is one of the linear ones."""
    for j in box.linear:  # noqa: SIM110 -- as numba compiles it
        if j == k:
            return True
    return False
