"""Brackets of Gauss-Newton descents, evaluation by evaluation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from miho.compiled.gauss_newton import is_free
from miho.compiled.gauss_newton_bracket import rules_of
from miho.compiled.gauss_newton_candidates import (
    ACTIVE,
    RECORD,
    SIZE,
    SLOPES,
    STORED,
    UNUSABLE,
    GNBox,
    GNCandidates,
    GNRules,
)
from miho.compiled.gauss_newton_parts import (
    after_evaluations,
    after_one_evaluation,
    after_steps,
    entering,
    factor_columns,
    next_to_evaluate,
    solve_columns,
)
from miho.compiled.workspace import Work, room_for, work
from miho.optim.meter import BudgetExhausted, UnusableValueError
from miho.optim.miho_gn_state import MIHOGNState
from miho.optim.oracle import Oracle
from miho.quantities import Array, Integers

if TYPE_CHECKING:
    from miho.parallel.pending import Ahead


class Round(NamedTuple):
    """Independent evaluations, about this number, which workers start `ahead`."""

    evaluations: int
    ahead: Ahead


def rounds(oracle: Oracle, state: MIHOGNState) -> Iterator[Round]:
    """Run a bracket to its end round by round, with evaluations by the problem.

    Yields a round when it has started; the request for the next one makes it. If this raises, new
    rounds continue from the state that is left.
    """
    c, place, level_rows = state.candidates, state.place, state.level_rows
    yield from _rounds_of_phase(oracle, state)
    while after_steps(
        c, state.stored, place, state.order, state.box, level_rows, state.minima, state.settings
    ):
        yield from _rounds_of_phase(oracle, state)


def _rounds_of_phase(oracle: Oracle, state: MIHOGNState) -> Iterator[Round]:
    """Give each candidate its steps; a round has one evaluation of each that needs one."""
    box, level_rows, active = state.box, state.level_rows, int(state.place[ACTIVE])
    rules = rules_of(state.place, level_rows, state.d, state.settings)
    d, m = state.d, state.rows
    w = work(np.empty(room_for(d, m, level_rows.size)), d, m, level_rows.size)
    size, with_derivatives = int(state.place[SIZE]), int(state.place[STORED])
    c = state.candidates.with_derivatives(state.stored, size, with_derivatives)
    fidelity = 1.0 if rules.last else m / int(level_rows[-1])
    # Candidates that enter a level form one batch, which is faster for models on arrays.
    if not (rules.last and rules.steps):
        index, thetas = np.empty(active, np.int64), np.empty((active, d))
        count = entering(c, active, box, index, thetas)
        if count:
            yield Round(count, oracle.workers.ahead(thetas[:count], fidelity, "residuals"))
            entrants = index[:count], thetas[:count]
            _evaluate_entering(oracle, fidelity, c, *entrants, box, level_rows, rules, w)
    while True:
        needs, i = [], state.turn
        while (i := next_to_evaluate(c, i, active, box, m, state.minima, rules, w)) < active:
            needs.append((i, w.theta.copy()))
            i += 1
        if not needs and state.turn == 0:
            return
        if needs:
            yield _begin_ahead(oracle, fidelity, c, needs, box)
        for state.turn, theta in needs:
            w.theta[:] = theta
            _evaluate(oracle, state, fidelity, c, state.turn, rules, w)
        state.turn = 0


def _begin_ahead(
    oracle: Oracle,
    fidelity: float,
    c: GNCandidates,
    needs: Sequence[tuple[int, Array]],
    box: GNBox,
) -> Round:
    """Start evaluations on workers that candidates, by position, need at configurations."""
    looks: list[Array] = []
    slopes: list[Array] = []
    for i, theta in needs:
        if c.stage[i] == SLOPES:
            slopes.append(theta)
            looks += [theta] * (not c.derivatives.shape[2])
        else:
            looks.append(theta)
            if c.projects[i] and c.stage[i] != RECORD:
                looks += [_probe(theta, k, box) for k in box.linear]
    begun = oracle.workers.ahead(np.array(slopes), fidelity, "jacobian")
    begun += oracle.workers.ahead(np.array(looks), fidelity, "residuals")
    return Round(len(slopes) * oracle.jacobian_cost + len(looks), begun)


def _evaluate(
    oracle: Oracle,
    state: MIHOGNState,
    fidelity: float,
    c: GNCandidates,
    i: int,
    rules: GNRules,
    w: Work,
) -> None:
    """Make the next evaluation of candidate i, at w.theta, and advance it."""
    box, m, stage = state.box, state.rows, c.stage[i]
    project = bool(c.projects[i]) and stage != RECORD
    cost = box.linear.size + 1 if project else 1
    if stage == SLOPES:
        cost = oracle.jacobian_cost + (not c.derivatives.shape[2])
    if not oracle.affords(cost * (1.0 if rules.last else oracle.cost(fidelity))):
        raise BudgetExhausted
    try:
        if stage == SLOPES:
            _evaluate_slopes(oracle, fidelity, c, i, box, m, w)
        elif project:
            loss = _evaluate_projected(oracle, fidelity, c, i, box, state.level_rows, w)
            after_one_evaluation(c, i, loss, box, m, rules, oracle.best, w)
        else:
            r = oracle.residuals(w.theta.copy(), fidelity)
            index = np.array([i])
            _hand_over(oracle, fidelity, c, index, r[None], box, state.level_rows, rules, w)
    except UnusableValueError:
        if stage == SLOPES:
            c.stage[i] = UNUSABLE
        else:
            after_one_evaluation(c, i, math.inf, box, m, rules, oracle.best, w)
    c.spent[i] += m * cost


def _evaluate_entering(
    oracle: Oracle,
    fidelity: float,
    c: GNCandidates,
    index: Integers,
    thetas: Array,
    box: GNBox,
    level_rows: Integers,
    rules: GNRules,
    w: Work,
) -> None:
    """Evaluate the candidates `index` (k,) that enter a level at thetas (k, d)."""
    m = int(level_rows[rules.level])
    while index.size:
        r = oracle.residual_rows(thetas, fidelity)
        k = len(r)
        if r.shape[1] != m:  # all of them raised
            r = np.full((k, m), math.nan)
        _hand_over(oracle, fidelity, c, index[:k], r, box, level_rows, rules, w)
        c.spent[index[:k]] += m
        index, thetas = index[k:], thetas[k:]


def _hand_over(
    oracle: Oracle,
    fidelity: float,
    c: GNCandidates,
    index: Integers,
    r: Array,
    box: GNBox,
    level_rows: Integers,
    rules: GNRules,
    w: Work,
) -> None:
    """Pass the residuals r (k, m) of the candidates `index` (k,) to the steps."""
    r = np.array(r, dtype=float, order="C")
    in_order = r if fidelity < 1.0 or oracle.order is None else np.take(r, oracle.order, axis=1)
    after_evaluations(c, index, r, in_order, box, level_rows, rules, oracle.best, w)


def _evaluate_slopes(
    oracle: Oracle, fidelity: float, c: GNCandidates, i: int, box: GNBox, m: int, w: Work
) -> None:
    """Evaluate the derivatives at candidate i, in the column order of `take_factor`.

    Without room for them the residuals are evaluated again, and nothing is stored.
    """
    d, theta = c.x.shape[1], w.theta.copy()
    width = box.width * np.where(box.log, theta, 1.0)
    columns = oracle.jacobian(theta, fidelity).T * width[:, None]
    order = np.arange(d)
    if c.projects[i]:
        order = np.array([*(k for k in box.linear if is_free(c.x[i, k])), *box.nonlinear])
    stored = c.derivatives[i]
    if not stored.shape[1]:
        stored = np.empty((d + 1, m))
        stored[d] = oracle.residuals(theta, fidelity, goes_on=True)
    stored[: order.size] = columns[order]
    factor_columns(c, i, box, stored, order.size, w)


def _evaluate_projected(
    oracle: Oracle,
    fidelity: float,
    c: GNCandidates,
    i: int,
    box: GNBox,
    level_rows: Integers,
    w: Work,
) -> float:
    """Loss at the best linear parameters for w.theta, infinite if unusable.

    Leaves the residuals of that solution in w.residuals. Costs p + 1 evaluations.
    """
    theta, r = w.theta.copy(), w.residuals
    r[:] = oracle.residuals(theta, fidelity)
    if not np.isfinite(r).all():
        return math.inf
    p = box.linear.size
    columns = np.empty((p + 1, r.size))
    for column, k in enumerate(box.linear):
        probe = _probe(theta, k, box)
        scale = (box.high[k] - box.low[k]) / (probe[k] - theta[k])
        columns[column] = (oracle.residuals(probe, fidelity, goes_on=True) - r) * scale
    columns[p] = r
    loss = solve_columns(c, i, box, columns, w)
    r += w.step[:p] @ columns[:p]
    return loss


def _probe(theta: Array, k: int, box: GNBox) -> Array:
    """Configuration that determines the effect of the linear parameter k.

    It is as far away as the bounds allow: a wide difference is more accurate.
    """
    probe, up = theta.copy(), box.high[k] - theta[k] >= theta[k] - box.low[k]
    probe[k] = box.high[k] if up else box.low[k]
    return probe
