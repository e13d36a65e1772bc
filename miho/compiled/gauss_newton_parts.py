"""Parts of Gauss-Newton steps, for problems whose residuals come from Python.

A bracket is divided at its evaluations: Python requests the next one, the problem computes it, and
the result is passed back.
"""

from __future__ import annotations

import numpy as np

from miho.compiled.gauss_newton import (
    after_evaluation,
    prepare,
    refold,
    solve_linear,
    take_factor,
    to_units,
)
from miho.compiled.gauss_newton_bracket import next_phase
from miho.compiled.gauss_newton_candidates import (
    ENTER,
    SIZE,
    STORED,
    TRIED,
    GNBox,
    GNCandidates,
    GNRules,
    GNSettings,
    Minima,
)
from miho.compiled.triangular import square_sum
from miho.compiled.workspace import Work, copy
from miho.quantities import Array, Integers


@np.errstate(all="ignore")  # like the machine
def next_to_evaluate(
    c: GNCandidates, i: int, active: int, box: GNBox,
    m: int, minima: Minima, rules: GNRules, w: Work,
) -> int:  # fmt: skip
    """First candidate from i on that needs an evaluation, `active` if there is none.

    The evaluation is at w.theta.
    """
    while i < active and not prepare(c, i, box, m, minima, rules, w):
        i += 1
    if i < active:
        trial = c.stage[i] == ENTER or c.stage[i] == TRIED
        to_units(c.trial[i] if trial else c.x[i], box, w.theta)
    return i


@np.errstate(all="ignore")
def entering(
    c: GNCandidates,
    active: int,
    box: GNBox,
    index: Integers,
    thetas: Array,
) -> int:
    """Number of the first `active` candidates that need a first evaluation without projection.

    Writes their positions to `index` (n,), and their configurations in units to `thetas` (n, d).
    """
    count = 0
    for i in range(active):
        if c.stage[i] == ENTER and not c.projects[i]:
            index[count] = i
            to_units(c.trial[i], box, thetas[count])
            count += 1
    return count


@np.errstate(all="ignore")
def after_evaluations(
    c: GNCandidates, index: Integers, r: Array,
    in_order: Array, box: GNBox, level_rows: Integers, rules: GNRules, best: float, w: Work,
) -> None:  # fmt: skip
    """`after_evaluation` for the residuals r (k, m) of the candidates `index` (k,).

    `in_order` (k, m) are the same residuals with the rows in the order of the levels.
    """
    m = r.shape[1]
    for k in range(index.size):
        copy(r[k], w.residuals)
        for level in range(level_rows.size):
            w.sums[level] = square_sum(in_order[k], min(level_rows[level], m))
        loss = square_sum(w.residuals, m) / m
        after_evaluation(c, index[k], loss, box, m, rules, best, w)


@np.errstate(all="ignore")
def after_one_evaluation(
    c: GNCandidates, i: int, loss: float, box: GNBox,
    m: int, rules: GNRules, best: float, w: Work,
) -> None:  # fmt: skip
    """`after_evaluation` of candidate i."""
    after_evaluation(c, i, loss, box, m, rules, best, w)


@np.errstate(all="ignore")
def factor_columns(
    c: GNCandidates, i: int, box: GNBox,
    columns: Array, count: int, w: Work,
) -> None:  # fmt: skip
    """`take_factor` of the first `count` of columns (d + 1, m) and of the last, the residuals."""
    refold(columns, count, columns[-1], columns.shape[1], w)
    take_factor(c, i, box, w)


@np.errstate(all="ignore")
def solve_columns(
    c: GNCandidates,
    i: int,
    box: GNBox,
    columns: Array,
    w: Work,
) -> float:
    """`solve_linear` from columns (p + 1, m): the p linear parameters and, last, the residuals."""
    p, m = box.linear.size, columns.shape[1]
    refold(columns, p, columns[p], m, w)
    return float(solve_linear(c, i, box, m, w))


@np.errstate(all="ignore")
def after_steps(
    c: GNCandidates, stored: Array, place: Integers, order: Integers, box: GNBox,
    level_rows: Integers, minima: Minima, settings: GNSettings,
) -> bool:  # fmt: skip
    """`next_phase`, with derivatives in `stored`."""
    c = c.with_derivatives(stored, int(place[SIZE]), int(place[STORED]))
    return next_phase(c, place, order, box, level_rows, minima, settings)
