"""The evaluations that Gauss-Newton steps need: compiled on rows of data, or from outside."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from miho.compiled import Block
from miho.compiled.advance import FINISHED, advance
from miho.compiled.from_outside import (
    entering_outside,
    evaluated_outside,
    factored_outside,
    looked_outside,
    next_outside,
    solved_outside,
)
from miho.compiled.gauss_newton import is_free
from miho.compiled.gauss_newton_state import (
    RECORD,
    SLOPES,
    UNUSABLE,
    Box,
    Candidates,
    Minima,
    Rules,
)
from miho.compiled.kernel import INFINITE, NAN
from miho.compiled.workspace import CHUNK, Work, room_for, work
from miho.optim.meter import BudgetExhausted, UnusableValueError
from miho.optim.oracle import Oracle
from miho.quantities import Array

Whole = NDArray[np.int64]

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
    kernel = oracle.kernel
    rows = None if kernel is None else kernel.rows
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
            NAN: nans,
            INFINITE: infinities,
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
