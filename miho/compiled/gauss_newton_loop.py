"""The compiled loop of Gauss-Newton steps, for problems whose residuals are compiled.

All candidates of a rung make their steps in one call. Derivatives are folded into triangular
factors chunk by chunk, so that memory does not grow with the number of rows.
"""

from __future__ import annotations

import math
from typing import Any

from miho.compiled.gauss_newton import (
    after_evaluation,
    is_free,
    prepare,
    solve_linear,
    take_factor,
    to_units,
)
from miho.compiled.gauss_newton_candidates import (
    RECORD,
    SLOPES,
    UNUSABLE,
    GNBox,
    GNCandidates,
    GNRules,
    Minima,
    views,
)
from miho.compiled.triangular import compiled, entry, fold, square_sum
from miho.compiled.workspace import CHUNK, Work, clear, work
from miho.quantities import Array, Integers

FINISHED, PAUSED = range(2)
"""How a block of steps ended: no candidate needs anything, or the next evaluation would cost more
rows than were allowed."""


@entry
def advance(
    residuals: Any,
    slopes: Any,
    X: Array,
    y: Array,
    numbers: Array,
    counts: Integers,
    R: Array,
    derivatives: Array,
    box: GNBox,
    level_rows: Integers,
    minima: Minima,
    rules: GNRules,
    slope_cost: int,
    most: int,
    best: float,
    target: float,
    at: Integers,
    losses: Array,
    thetas: Array,
    room: Array,
) -> tuple[int, int, int, int, int, int]:
    """Give each candidate its steps: (state, rows spent, improvements, NaN, inf, unusable).

    `numbers` to `derivatives` are the arrays of `GNCandidates`; `residuals` and `slopes` are those
    of `Rows`. At most `most` rows are spent. Each improvement of `best` is listed: the rows spent
    up to and with it (`at`), its loss and its theta; one that reaches `target` ends the block.
    `room` is for `work`.
    """
    c = views(numbers, counts, R, derivatives)
    m = level_rows[rules.level]
    w = work(room, R.shape[1], m if derivatives.shape[2] else CHUNK, level_rows.size)
    spent = improvements = nans = infinities = unusable = 0
    for i in range(c.x.shape[0]):
        # One evaluation after the other, until this candidate needs none.
        while prepare(c, i, box, m, minima, rules, w):
            stage = c.stage[i]
            project = c.projects[i] and stage != RECORD
            cost = m * (box.linear.size + 1 if project else 1)
            if stage == SLOPES:
                cost = m * slope_cost
            if spent + cost > most:
                return PAUSED, spent, improvements, nans, infinities, unusable
            spent += cost
            c.spent[i] += cost
            # Derivatives, where it is.
            if stage == SLOPES:
                to_units(c.x[i], box, w.theta)
                fill(residuals, slopes, X, y, c, i, box, m, False, w)
                take_factor(c, i, box, w)
                unusable += c.stage[i] == UNUSABLE
                continue
            # Or a look at its trial, recorded if it is an improvement over all rows.
            to_units(c.x[i] if stage == RECORD else c.trial[i], box, w.theta)
            keep = c.derivatives.shape[2] > 0 and not project
            loss = look(residuals, X, y, level_rows, m, keep, w) / m
            nans += math.isnan(loss)
            infinities += math.isinf(loss)
            if m == y.size and loss < best:
                best = loss
                at[improvements], losses[improvements] = spent - cost + m, loss
                for k in range(w.theta.size):
                    thetas[improvements, k] = w.theta[k]
                improvements += 1
            # The linear parameters are solved for from there.
            if project and math.isfinite(loss):
                fill(residuals, slopes, X, y, c, i, box, m, True, w)
                loss = solve_linear(c, i, box, m, w)
            after_evaluation(c, i, loss, box, m, rules, best, w)
            if best <= target:
                return FINISHED, spent, improvements, nans, infinities, unusable
    return FINISHED, spent, improvements, nans, infinities, unusable


@compiled
def look(
    residuals: Any, X: Array, y: Array, level_rows: Integers, m: int, keep: bool, w: Work
) -> float:
    """The sum of squares at w.theta over m rows, and in w.sums those over each level's rows.

    The residuals are left in w.residuals if they are to `keep`.
    """
    total, start = 0.0, 0
    for level in range(level_rows.size):
        end = min(level_rows[level], m)
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
    c: GNCandidates,
    i: int,
    box: GNBox,
    m: int,
    only_linear: bool,
    w: Work,
) -> None:
    """Write the triangular factor of derivatives and residuals at w.theta to w.T, chunk by chunk.

    With `only_linear` the columns are those of the linear parameters, in box widths; else those
    that `take_factor` expects, in unit coordinates.
    """
    d = w.theta.size
    keep = c.derivatives.shape[2] > 0 and not c.projects[i]
    J, chunk = w.slopes, w.chunk
    clear(w.T)
    for start in range(0, m, CHUNK):
        count = min(CHUNK, m - start)
        slopes(w.theta, X, start, start + count, J)
        n = 0
        if only_linear or c.projects[i]:
            for k in box.linear:
                if only_linear or is_free(c.x[i, k]):
                    scale_column(J[k], box.high[k] - box.low[k], count, chunk[n])
                    n += 1
        if not only_linear:
            for k in range(d):
                if c.projects[i] and is_linear(k, box):
                    continue
                width = box.width[k] * (w.theta[k] if box.log[k] else 1.0)
                scale_column(J[k], width, count, chunk[n])
                if keep:
                    for row in range(count):
                        c.derivatives[i, k, start + row] = chunk[n, row]
                n += 1
        if keep:
            for row in range(count):
                chunk[n, row] = c.derivatives[i, d, start + row]
        else:
            residuals(w.theta, X, y, start, start + count, chunk[n, :count])
        fold(w.T, chunk, count, n + 1)


@compiled
def scale_column(slopes: Array, width: float, count: int, scaled: Array) -> None:
    """Write derivatives in units as those in a coordinate of which 1 is this width."""
    for row in range(count):
        scaled[row] = slopes[row] * width


@compiled
def is_linear(k: int, box: GNBox) -> bool:
    """Whether a parameter is one of the linear ones."""
    for j in box.linear:  # noqa: SIM110 -- as numba compiles it
        if j == k:
            return True
    return False
