"""Levenberg-Marquardt steps of many configurations side by side, compiled.

A step is what follows from the evaluation that a configuration needs at its stage. So one set of
rules serves a model that is compiled, whose steps are made without Python in between (`advance`),
and any other, whose residuals and derivatives come from outside (`from_outside`); and whatever is
cut off between two evaluations goes on as if it had not been.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from miho.compiled.gauss_newton_state import (
    COPY,
    COPY_LOSS,
    DONE,
    ENTER,
    KNOWN,
    READY,
    RECORD,
    SLOPES,
    TRIED,
    UNUSABLE,
    Box,
    Candidates,
    Minima,
    Rules,
    views,
)
from miho.compiled.triangular import compiled, entry, fold, norm, solve_in_box
from miho.compiled.workspace import CHUNK, Work, clear, copy
from miho.quantities import Array

Whole = NDArray[np.int64]

ACCEPTED, GOOD, POOR = 1e-4, 0.75, 0.25
"""Gain over predicted gain: above the first a trial is taken; above the second the damping falls,
below the third it grows (Marquardt, 1963; Moré, 1978)."""
LESS, MORE = 0.1, 2.0
"""Factors of the damping after a good and after a poor step; after failures Nielsen's (1999), which
double each time."""
SMALLEST_DAMPING, LARGEST_DAMPING = 1e-12, 1e12
FADING = 0.3
"""A scale D_j falls by no more than this factor from one step to the next."""
SECANT = 0.7
"""Where the gain is more than this share of the predicted one the next derivatives are Broyden's,
a few times running: they cost nothing."""
DONE_DAMPING, DONE_LESS = 1e-3, 1e-3
"""A step that promises too little is the last one if it is hardly damped, or promises so little of
the tolerance; else the damping may be why, and falls."""
TRIES = 12
"""Steps with less and less damping before one is tried that promises too little."""
RESTART_DAMPING = 1e-6
"""What a failed step grows from, at least."""
SMALLEST_SCALE = 1e-10
"""Of the largest scale: a parameter that derivatives do not see is held by so much."""
INSIDE = 1e-12
"""A share of a width: nearer, a linear parameter is at its bound."""

compiled(views)


@compiled
def to_units(x: Array, box: Box, theta: Array) -> None:
    """The configuration in units at unit coordinates (d,)."""
    for k in range(x.size):
        value = box.origin[k] + box.width[k] * x[k]
        if box.log[k]:
            value = math.exp(value)
        theta[k] = min(max(value, box.low[k]), box.high[k])


@compiled
def factored(c: Candidates, i: int, box: Box, w: Work) -> None:
    """Take the factor of the derivatives and residuals where a configuration is, from w.T.

    Its columns are the parameters and the residuals, or, where the linear ones are projected out,
    first those of them that are free: what is left of the others is Kaufman's (1975) Jacobian.
    """
    d = c.x.shape[1]
    n, first = d, 0
    if c.projects[i]:
        n = box.nonlinear.size
        for k in box.linear:
            first += is_free(c.x[i, k])
    R, q, D = c.R[i], c.q[i], c.D[i]
    fine, largest = True, 0.0
    for k in range(n):
        square = 0.0
        for j in range(n):
            R[j, k] = w.T[first + j, first + k] if j <= k else 0.0
            square += R[j, k] * R[j, k]
        q[k] = w.T[first + k, first + n]
        D[k] = max(math.sqrt(square), FADING * D[k])
        largest = max(largest, D[k])
        fine = fine and math.isfinite(D[k]) and math.isfinite(q[k])
    for k in range(n):
        D[k] = max(D[k], SMALLEST_SCALE * largest)
    c.stage[i] = READY if fine else UNUSABLE
    if fine and n and largest == 0:
        c.stage[i] = DONE


@compiled
def is_free(x: float) -> bool:
    """Whether a coordinate is off the bounds."""
    return INSIDE < x < 1 - INSIDE


@compiled
def looked(c: Candidates, i: int, loss: float, box: Box, m: int, rules: Rules, w: Work) -> None:
    """What follows from the loss of a configuration's trial, whose residuals are in w."""
    d = c.x.shape[1]
    if c.stage[i] == ENTER:
        copy(c.trial[i], c.x[i])
        c.loss[i] = loss
        c.stage[i] = SLOPES if math.isfinite(loss) else UNUSABLE
        c.marked[i], c.mark[i] = loss, c.spent[i]
        keep_residuals(c, i, m, w)
        return
    c.steps[i] += 1
    actual = (c.loss[i] - loss) * m
    rho = actual / c.gain[i] if c.gain[i] > 0 and math.isfinite(loss) else -1.0
    if rho > ACCEPTED:
        secant = (
            rho > SECANT
            and c.secants[i] < rules.secants
            and c.rows.shape[2] > 0
            and not c.projects[i]
        )
        if secant:
            broyden(c, i, m, w)
        else:
            keep_residuals(c, i, m, w)
        copy(c.trial[i], c.x[i])
        c.loss[i] = loss
        if rho > GOOD:
            c.damping[i] = max(LESS * c.damping[i], SMALLEST_DAMPING)
        elif rho < POOR:
            c.damping[i] *= MORE
        c.growth[i] = 2.0
        c.stage[i] = SLOPES
        if secant:
            c.secants[i] += 1
            refold(c.rows[i], d, d, m, w)
            factored(c, i, box, w)
            if c.stage[i] == UNUSABLE:
                c.stage[i], c.secants[i] = SLOPES, 0
        if loss <= rules.nothing:
            c.stage[i] = DONE
    elif c.secants[i]:
        c.stage[i], c.secants[i] = SLOPES, 0
    else:
        c.damping[i] = max(c.damping[i] * c.growth[i], RESTART_DAMPING)
        c.growth[i] *= 2.0
        c.stage[i] = DONE if c.damping[i] > LARGEST_DAMPING else READY


@compiled
def keep_residuals(c: Candidates, i: int, m: int, w: Work) -> None:
    """Keep the residuals where a configuration is, if there is room."""
    if c.rows.shape[2]:
        d = c.x.shape[1]
        for row in range(m):
            c.rows[i, d, row] = w.residuals[row]


@compiled
def broyden(c: Candidates, i: int, m: int, w: Work) -> None:
    """Broyden's update of the derivatives, in the metric of the scales, for the accepted trial."""
    d = c.x.shape[1]
    rows, x, trial, D = c.rows[i], c.x[i], c.trial[i], c.D[i]
    total = 0.0
    for k in range(d):
        w.step[k] = trial[k] - x[k]
        total += (D[k] * w.step[k]) ** 2
    for row in range(m):
        missing = w.residuals[row] - rows[d, row]
        for k in range(d):
            missing -= rows[k, row] * w.step[k]
        missing /= total
        for k in range(d):
            rows[k, row] += missing * D[k] * D[k] * w.step[k]
        rows[d, row] = w.residuals[row]


@compiled
def refold(rows: Array, count: int, last: int, m: int, w: Work) -> None:
    """The factor of the first columns of rows (., m) and of the last one, into w.T."""
    clear(w.T)
    for start in range(0, m, CHUNK):
        size = min(CHUNK, m - start)
        for k in range(count + 1):
            column = rows[k if k < count else last]
            for row in range(size):
                w.chunk[k, row] = column[start + row]
        fold(w.T, w.chunk, size, count + 1)


@compiled
def step(c: Candidates, i: int, box: Box, m: int, rules: Rules, w: Work) -> None:
    """The next trial of a configuration whose derivatives are known; or it is done."""
    d = c.x.shape[1]
    n = box.nonlinear.size if c.projects[i] else d
    x, trial = c.x[i], c.trial[i]
    if n == 0:
        c.stage[i], c.gain[i] = DONE, 0.0
        return
    low, high, scale = w.low, w.high, w.scale
    for k in range(n):
        at = x[box.nonlinear[k]] if c.projects[i] else x[k]
        low[k], high[k] = max(-at, -rules.reach), min(1 - at, rules.reach)
    total = c.loss[i] * m
    before = 0.0
    for k in range(n):
        before += c.q[i, k] * c.q[i, k]
    for _ in range(TRIES):
        root = math.sqrt(c.damping[i])
        for k in range(n):
            scale[k] = root * c.D[i, k]
        solve_in_box(c.R[i], c.q[i], scale, low, high, n, w.step, w.room)
        c.gain[i] = before - norm(c.R[i], c.q[i], n, w.step)
        predicted = c.gain[i] / total if total > 0 else 0.0
        if predicted > rules.tolerance:
            break
        if c.damping[i] <= DONE_DAMPING or predicted <= DONE_LESS * rules.tolerance:
            c.stage[i] = DONE
            if c.secants[i] and rules.last:  # true derivatives have the last word
                c.stage[i], c.secants[i] = SLOPES, 0
            return
        c.damping[i] *= LESS
    for k in range(d):
        trial[k] = x[k]
    moved = False
    for k in range(n):
        at = box.nonlinear[k] if c.projects[i] else k
        trial[at] = min(max(x[at] + w.step[k], 0.0), 1.0)
        moved = moved or trial[at] != x[at]
    c.stage[i] = TRIED if moved else DONE


@compiled
def square_distance(c: Candidates, i: int, x: Array, box: Box) -> float:
    """|R (x_i - x)|^2: what the linear model at a configuration says of the way to x (d,)."""
    n, total = box.nonlinear.size if c.projects[i] else x.size, 0.0
    for row in range(n):
        value = 0.0
        for k in range(row, n):
            at = box.nonlinear[k] if c.projects[i] else k
            value += c.R[i, row, k] * (c.x[i, at] - x[at])
        total += value * value
    return total


@compiled
def known(c: Candidates, i: int, box: Box, m: int, minima: Minima, rules: Rules) -> bool:
    """Whether a configuration is on its way to a minimum that is known, and no better."""
    near = rules.near * c.loss[i] * m
    for k in range(minima.loss.size):
        worse = c.loss[i] >= minima.loss[k] * (1 - rules.better)
        if worse and square_distance(c, i, minima.x[k], box) <= near:
            return True
    return False


@compiled
def prepare(c: Candidates, i: int, box: Box, m: int, minima: Minima, rules: Rules, w: Work) -> bool:
    """Bring a configuration to its next evaluation; false where it needs none in this block."""
    while c.stage[i] == SLOPES or c.stage[i] == READY:
        if c.stage[i] == READY and known(c, i, box, m, minima, rules):
            c.stage[i] = KNOWN
        elif c.steps[i] >= rules.steps or crawls(c, i, rules):
            return False
        elif c.stage[i] == SLOPES:
            return True
        else:
            step(c, i, box, m, rules, w)
    return bool(c.stage[i] < DONE)


@compiled
def crawls(c: Candidates, i: int, rules: Rules) -> bool:
    """Whether a configuration gains little for what it costs, and has had its share."""
    if rules.patience == 0 or c.spent[i] - c.mark[i] < rules.patience:
        return False
    if c.loss[i] > (1 - rules.progress) * c.marked[i]:
        return bool(c.spent[i] >= rules.share)
    c.mark[i], c.marked[i] = c.spent[i], c.loss[i]
    return False


@compiled
def solve_linear(c: Candidates, i: int, box: Box, m: int, w: Work) -> float:
    """Move a trial to its best linear parameters; the loss there, by algebra.

    w.T is the factor of their columns, in box widths, and of the residuals at w.theta.
    """
    p = box.linear.size
    for j in range(p + 1):
        for k in range(j, p + 1):
            if not math.isfinite(w.T[j, k]):
                return math.inf
    q = w.T[:, p]
    for j in range(p):
        k = box.linear[j]
        width = box.high[k] - box.low[k]
        w.scale[j] = 0.0
        w.low[j] = (box.low[k] - w.theta[k]) / width
        w.high[j] = (box.high[k] - w.theta[k]) / width
    solve_in_box(w.T, q, w.scale, w.low, w.high, p, w.step, w.room)
    rest = w.T[p, p] * w.T[p, p] + norm(w.T, q, p, w.step)
    for j in range(p):
        k = box.linear[j]
        value = w.theta[k] + (box.high[k] - box.low[k]) * w.step[j]
        value = min(max(value, box.low[k]), box.high[k])
        if box.log[k]:
            value = math.log(value)
        c.trial[i, k] = min(max((value - box.origin[k]) / box.width[k], 0.0), 1.0)
    return float(rest / m)


@compiled
def evaluated(
    c: Candidates, i: int, loss: float, box: Box, m: int, rules: Rules, best: float, w: Work
) -> None:
    """What follows from the residuals of a trial, with the loss that they or algebra gave.

    A solution for the linear parameters on all rows is known by algebra only: an improvement is
    looked at once more, and so recorded.
    """
    if c.stage[i] == RECORD:
        c.stage[i] = c.after[i]
        copy(w.sums, c.sums[i])
        return
    before = c.loss[i]
    looked(c, i, loss, box, m, rules, w)
    if c.projects[i]:
        if rules.last and c.loss[i] < before and c.loss[i] < best:
            c.after[i] = c.stage[i]
            c.stage[i] = RECORD
    elif c.loss[i] < before:
        copy(w.sums, c.sums[i])


@compiled
def same(c: Candidates, i: int, j: int, box: Box) -> bool:
    """Whether two configurations are one, as far as the rows can tell; j is the worse one."""
    modelled = c.stage[i] == READY or c.stage[i] == DONE
    close = c.loss[j] - c.loss[i] <= COPY_LOSS * c.loss[i]
    if not (modelled and close):
        return False
    return bool(square_distance(c, i, c.x[j], box) <= COPY * c.x.shape[1] * c.loss[i])


def distinct(c: Candidates, box: Box) -> NDArray[np.intp]:
    """Which of configurations, in ascending order of their losses, are no copies of better ones."""
    kept = np.empty(c.loss.size, np.intp)
    return kept[: _distinct(*c[:4], box, kept)]


@entry
def _distinct(
    numbers: Array, counts: Whole, R: Array, rows: Array, box: Box, kept: NDArray[np.intp]
) -> int:
    c, count = views(numbers, counts, R, rows), 0
    for j in range(c.loss.size):
        new = True
        for i in kept[:count]:
            new = new and not same(c, i, j, box)
        if new:
            kept[count] = j
            count += 1
    return count
