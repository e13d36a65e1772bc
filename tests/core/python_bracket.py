"""The loop of a bracket in Python, which the machine's is compared with.

Derivatives are folded into triangular factors chunk by chunk, so that memory does not grow with the
number of rows.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from miho.compiled.gauss_newton import (
    Work,
    after_evaluation,
    is_free,
    prepare,
    solve_linear,
    take_factor,
    to_units,
)
from miho.compiled.gauss_newton_bracket import GNRules, next_phase, rules_of
from miho.compiled.gauss_newton_candidates import (
    ACTIVE,
    RECORD,
    SIZE,
    SLOPES,
    STORED,
    UNUSABLE,
    GNBox,
    GNCandidates,
    GNSettings,
    Minima,
    views,
)
from miho.compiled.kernel import Rows
from miho.compiled.phases import CHUNK, FINISHED, PAUSED, REACHED
from miho.compiled.triangular import fold, square_sum
from miho.core import machine
from miho.quantities import Array, Integers

SPENT, IMPROVEMENTS, NANS, INFINITIES, UNUSABLES = range(5)
"""What a block did, in the array `tally` (5,): rows spent, improvements, and what it rejected."""


def residuals(rows: Rows, theta: Array, i: int, j: int) -> Array:
    """Of rows i to j, (j - i,)."""
    return evaluated(rows.tapes[0], theta, rows.X[:, i:j], 1)[0] - rows.y[i:j]


def slopes(rows: Rows, theta: Array, i: int, j: int) -> Array:
    """The derivatives of those, (d, j - i)."""
    return evaluated(rows.tapes[1], theta, rows.X[:, i:j], theta.size)


def evaluated(tape: Any, theta: Array, X: Array, results: int) -> Array:
    """The results of a tape, (results, N)."""
    out = np.empty((1, results, X.shape[1]))
    machine().evaluate(tape, theta[None].copy(), np.ascontiguousarray(X), out)
    return np.asarray(out[0])


def run_bracket(
    rows: Rows,
    numbers: Array,
    counts: Integers,
    R: Array,
    stored: Array,
    place: Integers,
    order: Integers,
    box: GNBox,
    level_rows: Integers,
    minima: Minima,
    settings: GNSettings,
    most: int,
    best: float,
    target: float,
    at: Integers,
    losses: Array,
    thetas: Array,
    tally: Integers,
    room: Array,
) -> int:
    """Take a bracket to its end; how it ended. Goes on where it was cut off.

    The arguments are those of `miho.compiled.phases.bracket_of`.
    """
    while True:
        n, m = R.shape[1] + 1, int(place[STORED])
        derivatives = stored[: place[SIZE] * n * m].reshape((place[SIZE], n, m))
        c = views(numbers, counts, R, derivatives)
        rules = rules_of(place, level_rows, R.shape[1], settings)
        m = level_rows[rules.level]
        w = Work.of(R.shape[1], m if place[STORED] else CHUNK, level_rows.size)
        # All starts that are left descend to the phase's end; then the best go on.
        for i in range(place[ACTIVE]):
            state = descend(
                rows, c, i, box, level_rows, minima, rules, settings.slope_cost, most,
                best, target, at, losses, thetas, tally, w,
            )  # fmt: skip
            if state != FINISHED:
                return state
            if tally[IMPROVEMENTS]:
                best = losses[tally[IMPROVEMENTS] - 1]
        if not next_phase(c, place, order, box, level_rows, minima, settings):
            return FINISHED


def descend(
    rows: Rows,
    c: GNCandidates,
    i: int,
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
    tally: Integers,
    w: Work,
) -> int:
    """Give a candidate its steps, one evaluation after the other, until it needs none."""
    m = level_rows[rules.level]
    while prepare(c, i, box, m, minima, rules, w):
        stage = c.stage[i]
        project = c.projects[i] and stage != RECORD
        cost = m * (box.linear.size + 1 if project else 1)
        if stage == SLOPES:
            cost = m * slope_cost
        if tally[SPENT] + cost > most:
            return PAUSED
        tally[SPENT] += cost
        c.spent[i] += cost
        # Derivatives, where it is.
        if stage == SLOPES:
            to_units(c.x[i], box, w.theta)
            fill(rows, c, i, box, m, False, w)
            take_factor(c, i, box, w)
            tally[UNUSABLES] += c.stage[i] == UNUSABLE
            continue
        # Or a look at its trial, recorded if it is an improvement over all rows.
        to_units(c.x[i] if stage == RECORD else c.trial[i], box, w.theta)
        keep = c.derivatives.shape[2] > 0 and not project
        loss = look(rows, level_rows, m, keep, w) / m
        tally[NANS] += math.isnan(loss)
        tally[INFINITIES] += math.isinf(loss)
        if m == rows.y.size and loss < best:
            best, k = loss, tally[IMPROVEMENTS]
            at[k], losses[k] = tally[SPENT] - cost + m, loss
            thetas[k] = w.theta
            tally[IMPROVEMENTS] += 1
        # The linear parameters are solved for from there.
        if project and math.isfinite(loss):
            fill(rows, c, i, box, m, True, w)
            loss = solve_linear(c, i, box, m, w)
        after_evaluation(c, i, loss, box, m, rules, best, w)
        if best <= target:
            return REACHED
    return FINISHED


def look(rows: Rows, level_rows: Integers, m: int, keep: bool, w: Work) -> float:
    """The sum of squares at w.theta over m rows, and in w.sums those over each level's rows.

    The residuals are left in w.residuals if they are to `keep`.
    """
    total, start = 0.0, 0
    for level in range(level_rows.size):
        end = min(level_rows[level], m)
        while start < end:
            count = min(CHUNK, end - start)
            r = w.residuals[start : start + count] if keep else w.residuals[:count]
            r[:] = residuals(rows, w.theta, start, start + count)
            total += square_sum(r, count)
            start += count
        w.sums[level] = total
    return total


def fill(
    rows: Rows,
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
    chunk = w.chunk
    w.T[:] = 0.0
    for start in range(0, m, CHUNK):
        count = min(CHUNK, m - start)
        J = slopes(rows, w.theta, start, start + count)
        n = 0
        if only_linear or c.projects[i]:
            for k in box.linear:
                if only_linear or is_free(c.x[i, k]):
                    chunk[n, :count] = J[k] * (box.high[k] - box.low[k])
                    n += 1
        if not only_linear:
            for k in range(d):
                if c.projects[i] and k in box.linear:
                    continue
                width = box.width[k] * (w.theta[k] if box.log[k] else 1.0)
                chunk[n, :count] = J[k] * width
                if keep:
                    c.derivatives[i, k, start : start + count] = chunk[n, :count]
                n += 1
        if keep:
            chunk[n, :count] = c.derivatives[i, d, start : start + count]
        else:
            chunk[n, :count] = residuals(rows, w.theta, start, start + count)
        fold(w.T, chunk, count, n + 1)
