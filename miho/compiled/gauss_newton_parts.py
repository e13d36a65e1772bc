"""The parts of Gauss-Newton steps, for problems whose residuals come from Python.

The one call of `gauss_newton_loop` is cut here at its evaluations: Python asks for the next one,
has the problem compute it, and hands the result back. Nothing is compiled: loops over rows are
NumPy's. `numbers` to `derivatives` are the arrays of `GNCandidates`.
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
from miho.compiled.gauss_newton_bracket import candidates_at, next_phase
from miho.compiled.gauss_newton_candidates import (
    ENTER,
    TRIED,
    GNBox,
    GNRules,
    GNSettings,
    Minima,
    views,
)
from miho.compiled.triangular import square_sum
from miho.compiled.workspace import Work, copy
from miho.quantities import Array, Integers


@np.errstate(all="ignore")  # as compiled code has it
def next_to_evaluate(
    numbers: Array, counts: Integers, R: Array, derivatives: Array, i: int, active: int, box: GNBox,
    m: int, minima: Minima, rules: GNRules, w: Work,
) -> int:  # fmt: skip
    """The first candidate from i on that needs an evaluation, `active` if none before that does.

    What it needs is to be evaluated at w.theta.
    """
    c = views(numbers, counts, R, derivatives)
    while i < active and not prepare(c, i, box, m, minima, rules, w):
        i += 1
    if i < active:
        trial = c.stage[i] == ENTER or c.stage[i] == TRIED
        to_units(c.trial[i] if trial else c.x[i], box, w.theta)
    return i


@np.errstate(all="ignore")
def entering(
    numbers: Array,
    counts: Integers,
    R: Array,
    derivatives: Array,
    active: int,
    box: GNBox,
    index: Integers,
    thetas: Array,
) -> int:
    """How many of the first `active` are to be looked at for the first time, without projection.

    Writes their positions to `index` (n,), and where they are, in units, to `thetas` (n, d).
    """
    c = views(numbers, counts, R, derivatives)
    count = 0
    for i in range(active):
        if c.stage[i] == ENTER and not c.projects[i]:
            index[count] = i
            to_units(c.trial[i], box, thetas[count])
            count += 1
    return count


@np.errstate(all="ignore")
def after_evaluations(
    numbers: Array, counts: Integers, R: Array, derivatives: Array, index: Integers, r: Array,
    in_order: Array, box: GNBox, level_rows: Integers, rules: GNRules, best: float, w: Work,
) -> None:  # fmt: skip
    """`after_evaluation` for the residuals r (k, m) of the candidates `index` (k,).

    `in_order` (k, m) are the same residuals with the rows in the order of the levels.
    """
    c = views(numbers, counts, R, derivatives)
    m = r.shape[1]
    for k in range(index.size):
        copy(r[k], w.residuals)
        for level in range(level_rows.size):
            w.sums[level] = square_sum(in_order[k], min(level_rows[level], m))
        loss = square_sum(w.residuals, m) / m
        after_evaluation(c, index[k], loss, box, m, rules, best, w)


@np.errstate(all="ignore")
def after_one_evaluation(
    numbers: Array, counts: Integers, R: Array, derivatives: Array, i: int, loss: float, box: GNBox,
    m: int, rules: GNRules, best: float, w: Work,
) -> None:  # fmt: skip
    """`after_evaluation` of candidate i."""
    after_evaluation(views(numbers, counts, R, derivatives), i, loss, box, m, rules, best, w)


@np.errstate(all="ignore")
def factor_columns(
    numbers: Array, counts: Integers, R: Array, derivatives: Array, i: int, box: GNBox,
    columns: Array, count: int, w: Work,
) -> None:  # fmt: skip
    """`take_factor` of the first `count` of columns (d + 1, m) and of the last, the residuals."""
    refold(columns, count, columns.shape[0] - 1, columns.shape[1], w)
    take_factor(views(numbers, counts, R, derivatives), i, box, w)


@np.errstate(all="ignore")
def solve_columns(
    numbers: Array,
    counts: Integers,
    R: Array,
    derivatives: Array,
    i: int,
    box: GNBox,
    columns: Array,
    w: Work,
) -> float:
    """`solve_linear` from columns (p + 1, m): the p linear parameters' and, last, the residuals."""
    p, m = box.linear.size, columns.shape[1]
    refold(columns, p, p, m, w)
    return float(solve_linear(views(numbers, counts, R, derivatives), i, box, m, w))


@np.errstate(all="ignore")
def after_steps(
    numbers: Array, counts: Integers, R: Array, stored: Array, place: Integers, order: Integers,
    box: GNBox, level_rows: Integers, minima: Minima, settings: GNSettings,
) -> bool:  # fmt: skip
    """`next_phase`."""
    c = candidates_at(numbers, counts, R, stored, place)
    return bool(next_phase(c, place, order, box, level_rows, minima, settings))
