"""The loop of Gauss-Newton steps, for problems whose residuals are functions in memory.

A whole bracket is one call: of the machine of `miho.core`, which has the same loop in C, or where
the library was installed without it, of the functions here, which numba compiles. Derivatives are
folded into triangular factors chunk by chunk, so that memory does not grow with the number of rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import cast

from miho.compiled.addresses import write_residuals, write_slopes
from miho.compiled.gauss_newton import (
    after_evaluation,
    is_free,
    prepare,
    solve_linear,
    take_factor,
    to_units,
)
from miho.compiled.gauss_newton_bracket import candidates_at, next_phase, rules_of
from miho.compiled.gauss_newton_candidates import (
    ACTIVE,
    RECORD,
    SLOPES,
    STORED,
    UNUSABLE,
    GNBox,
    GNCandidates,
    GNRules,
    GNSettings,
    Minima,
)
from miho.compiled.kernel import Rows
from miho.compiled.triangular import compiled, entry, fold, square_sum
from miho.compiled.workspace import CHUNK, Work, clear, copy, work
from miho.core import machine
from miho.quantities import Array, Integers

FINISHED, PAUSED, REACHED = range(3)
"""How a block of steps ended: no candidate needs anything; the next evaluation would cost more rows
than were allowed; or the target is reached."""
SPENT, IMPROVEMENTS, NANS, INFINITIES, UNUSABLES = range(5)
"""What a block did, in the array `tally` (5,): rows spent, improvements, and what it rejected."""


def bracket_of(rows: Rows) -> Callable[..., int]:
    """`run_bracket` on these rows, by the machine where there is one."""
    if machine() is None:
        return partial(run_bracket, rows.calls, rows.X, rows.y)
    by_machine = partial(machine().run_bracket, rows.calls, rows.kept, rows.X, rows.y)
    return cast(Callable[..., int], by_machine)


def waits_for_numba() -> bool:
    """Whether `run_bracket` is to be compiled, and is not in numba's cache."""
    return machine() is None and not run_bracket.in_cache


@entry
def run_bracket(
    calls: Integers,
    X: Array,
    y: Array,
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

    `numbers` to `R` are the arrays of `GNCandidates`, `stored` (.,) holds their derivatives;
    `calls`, X and y are those of `Rows`. At most `most` rows are spent. Each improvement of
    `best` is listed: the rows spent up to and with it (`at`), its loss and its theta; one that
    reaches `target` ends the block. What was done is added to `tally` (5,); `room` is for `work`.
    """
    while True:
        c = candidates_at(numbers, counts, R, stored, place)
        rules = rules_of(place, level_rows, R.shape[1], settings)
        m = level_rows[rules.level]
        w = work(room, R.shape[1], m if place[STORED] else CHUNK, level_rows.size)
        # All starts that are left descend to the phase's end; then the best go on.
        for i in range(place[ACTIVE]):
            state = descend(
                calls, X, y, c, i, box, level_rows, minima, rules, settings.slope_cost, most,
                best, target, at, losses, thetas, tally, w,
            )  # fmt: skip
            if state != FINISHED:
                return state
            if tally[IMPROVEMENTS]:
                best = losses[tally[IMPROVEMENTS] - 1]
        if not next_phase(c, place, order, box, level_rows, minima, settings):
            return FINISHED


@compiled
def descend(
    calls: Integers,
    X: Array,
    y: Array,
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
            fill(calls, X, y, c, i, box, m, False, w)
            take_factor(c, i, box, w)
            tally[UNUSABLES] += c.stage[i] == UNUSABLE
            continue
        # Or a look at its trial, recorded if it is an improvement over all rows.
        to_units(c.x[i] if stage == RECORD else c.trial[i], box, w.theta)
        keep = c.derivatives.shape[2] > 0 and not project
        loss = look(calls, X, y, level_rows, m, keep, w) / m
        tally[NANS] += math.isnan(loss)
        tally[INFINITIES] += math.isinf(loss)
        if m == y.size and loss < best:
            best, k = loss, tally[IMPROVEMENTS]
            at[k], losses[k] = tally[SPENT] - cost + m, loss
            copy(w.theta, thetas[k])
            tally[IMPROVEMENTS] += 1
        # The linear parameters are solved for from there.
        if project and math.isfinite(loss):
            fill(calls, X, y, c, i, box, m, True, w)
            loss = solve_linear(c, i, box, m, w)
        after_evaluation(c, i, loss, box, m, rules, best, w)
        if best <= target:
            return REACHED
    return FINISHED


@compiled
def look(
    calls: Integers, X: Array, y: Array, level_rows: Integers, m: int, keep: bool, w: Work
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
            write_residuals(calls, w.theta, X, y, start, start + count, r)
            total += square_sum(r, count)
            start += count
        w.sums[level] = total
    return total


@compiled
def fill(
    calls: Integers,
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
        write_slopes(calls, w.theta, X, start, start + count, J)
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
            write_residuals(calls, w.theta, X, y, start, start + count, chunk[n, :count])
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
