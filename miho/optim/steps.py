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
    copy,
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
    if not (rules.last and rules.steps):
        _enter_outside(oracle, fidelity, c, box, ends, rules, w)
    i = 0
    while (i := next_outside(*c[:4], i, box, m, minima, rules, w)) < c.stage.size:
        stage = c.stage[i]
        project = bool(c.projects[i]) and stage != RECORD
        cost = p + 1 if project else 1
        if stage == SLOPES:
            cost = oracle.jacobian_cost + (not c.rows.shape[2])
        if not oracle.affords(cost * share):
            raise BudgetExhausted
        try:
            if stage == SLOPES:
                _slopes_outside(oracle, fidelity, c, i, box, m, w)
            elif project:
                loss = _project_outside(oracle, fidelity, c, i, box, ends, w)
                evaluated_outside(*c[:4], i, loss, box, m, rules, oracle.best, w)
            else:
                r = oracle.residuals(w.theta.copy(), fidelity)
                _looked_outside(oracle, fidelity, c, np.array([i]), r[None], box, ends, rules, w)
        except UnusableValueError:
            if stage == SLOPES:
                c.stage[i] = UNUSABLE
            else:
                evaluated_outside(*c[:4], i, math.inf, box, m, rules, oracle.best, w)
        c.spent[i] += m * cost


def _enter_outside(
    oracle: Oracle, fidelity: float, c: Candidates, box: Box, ends: Whole, rules: Rules, w: Work
) -> None:
    """Look at those that enter a level side by side: a model of arrays is the quicker for it."""
    m = int(ends[rules.level])
    which, thetas = np.empty(c.stage.size, np.int64), np.empty(c.x.shape)
    count = entering_outside(*c[:4], box, which, thetas)
    which, thetas = which[:count], thetas[:count]
    while which.size:
        r = oracle.residual_rows(thetas, fidelity)
        k = len(r)
        if r.shape[1] != m:  # all of them raised
            r = np.full((k, m), math.nan)
        _looked_outside(oracle, fidelity, c, which[:k], r, box, ends, rules, w)
        c.spent[which[:k]] += m
        which, thetas = which[k:], thetas[k:]


def _looked_outside(
    oracle: Oracle,
    fidelity: float,
    c: Candidates,
    which: Whole,
    r: Array,
    box: Box,
    ends: Whole,
    rules: Rules,
    w: Work,
) -> None:
    """What follows from residuals (k, m) of some configurations."""
    r = np.array(r, dtype=float, order="C")  # as compiled code is made for
    in_order = r if fidelity < 1.0 or oracle.order is None else np.take(r, oracle.order, axis=1)
    looked_outside(*c[:4], which, r, in_order, box, ends, rules, oracle.best, w)


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


def _project_outside(
    oracle: Oracle, fidelity: float, c: Candidates, i: int, box: Box, ends: Whole, w: Work
) -> float:
    """The loss at the best linear parameters for w.theta; infinite if unusable.

    The residuals there are left in w.residuals.
    """
    theta, r = w.theta.copy(), w.residuals
    r[:] = oracle.residuals(theta, fidelity)
    if not np.isfinite(r).all():
        return math.inf
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
