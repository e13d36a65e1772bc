"""The evaluations that Gauss-Newton steps need: compiled on rows of data, or from outside.

Compiled, all configurations of a rung make their steps without Python in between, and derivatives
are folded into triangular factors as they come, so that any number of rows takes no room.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.optim.gauss_newton import (
    CHUNK,
    ENTER,
    RECORD,
    SLOPES,
    TRIED,
    UNUSABLE,
    Box,
    Candidates,
    Minima,
    Rules,
    Work,
    clear,
    evaluated,
    factored,
    is_free,
    prepare,
    refold,
    room_for,
    solve_linear,
    to_units,
    views,
    work,
)
from miho.optim.oracle import NOT_FINITE, Block, BudgetExhausted, Oracle, UnusableValueError
from miho.optim.triangular import compiled, entry, fold, square_sum

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

FINISHED, PAUSED = range(2)
"""Whether a block of steps was done to its end, or the next evaluation is beyond its allowance."""
EVENTS = 4096
"""Looks at all rows in one block, each of which may improve."""


def give_steps(
    oracle: Oracle,
    c: Candidates,
    box: Box,
    ends: Whole,
    minima: Minima,
    rules: Rules,
) -> None:
    """Give each configuration its steps, compiled where the problem is.

    Goes on where it was cut off. Raises as the oracle does at the end of the budget.
    """
    rows = oracle.compiled_rows
    m = int(ends[rules.level])
    if rows is None:
        d = c.x.shape[1]
        w = work(np.empty(room_for(d, m, ends.size)), d, m, ends.size)
        _from_outside(oracle, c, box, ends, minima, rules, w)
        return
    N, d, slope_cost = rows.y.size, c.x.shape[1], oracle.jacobian_cost
    least = float(max(box.linear.size + 1, slope_cost))
    most = EVENTS if rules.last else 0
    at, losses, thetas = np.empty(most, np.int64), np.empty(most), np.empty((most, d))
    room = np.empty(room_for(d, m if c.rows.shape[2] else CHUNK, ends.size))

    def block(most: float, best: float, target: float) -> Block:
        limit = round(min(most, EVENTS) * N)  # most is of whole rows but for its rounding
        state, spent, found, nans, infinities, unusable = advance(
            rows.residuals, rows.slopes, rows.X, rows.y, *c[:4], box, ends, minima, rules,
            slope_cost, limit, best, target, at, losses, thetas, room,
        )  # fmt: skip
        counts = {
            f"{NOT_FINITE} nan": nans,
            f"{NOT_FINITE} inf": infinities,
            "derivative is not finite": unusable,
        }
        return Block(
            spent / N,
            at[:found] / N,
            losses[:found],
            thetas[:found],
            counts,
            state == FINISHED,
        )

    oracle.spend(block, least)


def _from_outside(
    oracle: Oracle, c: Candidates, box: Box, ends: Whole, minima: Minima, rules: Rules, w: Work
) -> None:
    """The same steps on residuals and derivatives that a problem gives one at a time."""
    p, m = box.linear.size, int(ends[rules.level])
    fidelity = 1.0 if rules.last else m / int(ends[-1])
    share = 1.0 if rules.last else oracle.cost(fidelity)
    for i in range(c.x.shape[0]):
        while prepare_outside(*c[:4], i, box, m, minima, rules, w):
            stage = c.stage[i]
            project = bool(c.projects[i]) and stage != RECORD
            if stage == SLOPES:
                cost = oracle.jacobian_cost + (not c.rows.shape[2])
                if cost * share > oracle.remaining:
                    raise BudgetExhausted
                try:
                    _slopes_outside(oracle, fidelity, c, i, box, m, w)
                except UnusableValueError:
                    c.stage[i] = UNUSABLE
            else:
                cost = p + 1 if project else 1
                if not oracle.affords(cost * share):
                    raise BudgetExhausted
                try:
                    loss = _look_outside(oracle, fidelity, c, i, box, ends, project, w)
                except UnusableValueError:
                    loss = math.inf
                evaluated_outside(*c[:4], i, loss, box, m, rules, oracle.best, w)
            c.spent[i] += m * cost


def _slopes_outside(
    oracle: Oracle, fidelity: float, c: Candidates, i: int, box: Box, m: int, w: Work
) -> None:
    """Take the derivatives where a configuration is, as `fill` does.

    Without room for rows its residuals are asked for again, and nothing is kept.
    """
    d, theta = c.x.shape[1], w.theta.copy()
    width = box.width * np.where(box.log, theta, 1.0)
    columns = oracle.jacobian(theta, fidelity).T * width[:, None]
    order = np.arange(d)
    if c.projects[i]:
        order = np.array([*(k for k in box.linear if is_free(c.x[i, k])), *box.nonlinear])
    rows = c.rows[i]
    if not rows.shape[1]:
        rows = np.empty((d + 1, m))
        rows[d] = oracle.residuals(theta, fidelity, goes_on=True)
    rows[: order.size] = columns[order]
    factored_outside(*c[:4], i, box, rows, order.size, w)


def _look_outside(
    oracle: Oracle,
    fidelity: float,
    c: Candidates,
    i: int,
    box: Box,
    ends: Whole,
    project: bool,
    w: Work,
) -> float:
    """The loss at w.theta, or at the best linear parameters there; infinite if unusable.

    The residuals there are left in w.residuals.
    """
    theta = w.theta.copy()
    r = w.residuals
    r[:] = oracle.residuals(theta, fidelity)
    order = oracle.order if fidelity == 1.0 else None
    in_order = r if order is None else r[order]
    loss = sums_outside(r, in_order, ends, w.sums) / r.size
    if not (project and math.isfinite(loss)):
        return loss
    p = box.linear.size
    rows = np.empty((p + 1, r.size))
    for column, k in enumerate(box.linear):
        # as far away as the box allows: the wider a difference, the more exact
        moved, up = theta.copy(), box.high[k] - theta[k] >= theta[k] - box.low[k]
        moved[k] = box.high[k] if up else box.low[k]
        scale = (box.high[k] - box.low[k]) / (moved[k] - theta[k])
        rows[column] = (oracle.residuals(moved, fidelity, goes_on=True) - r) * scale
    rows[p] = r
    loss = solved_outside(*c[:4], i, box, rows, w)
    r += w.step[:p] @ rows[:p]
    return loss


@entry
def prepare_outside(
    numbers: Array, counts: Whole, R: Array, rows: Array, i: int, box: Box, m: int,
    minima: Minima, rules: Rules, w: Work,
) -> bool:  # fmt: skip
    """As `prepare`, and where the next evaluation is, into w.theta."""
    c = views(numbers, counts, R, rows)
    if not prepare(c, i, box, m, minima, rules, w):
        return False
    trial = c.stage[i] == ENTER or c.stage[i] == TRIED
    to_units(c.trial[i] if trial else c.x[i], box, w.theta)
    return True


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


@entry
def sums_outside(r: Array, in_order: Array, ends: Whole, sums: Array) -> float:
    """The sum of squares of residuals, and in `sums` those of the rows of each level."""
    for level in range(ends.size):
        sums[level] = square_sum(in_order, min(ends[level], r.size))
    return square_sum(r, r.size)


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
