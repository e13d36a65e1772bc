"""Levenberg-Marquardt steps of many candidates side by side.

These functions are the steps between two evaluations: each advances a candidate from one stage to
the next. The machine of `miho.core` has the same steps in C (`steps.c`) for models that it runs.
The Python functions serve all other models (`miho.optim.gauss_newton_steps`), and tests compare the
C with them. A run that stops between two evaluations resumes without a difference.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from miho.compiled import triangular
from miho.compiled.gauss_newton_bracket import GNRules, square_distance
from miho.compiled.gauss_newton_candidates import (
    AT_KNOWN,
    DONE,
    ENTER,
    INSIDE,
    READY,
    RECORD,
    SLOPES,
    TRIED,
    UNUSABLE,
    GNBox,
    GNCandidates,
    Minima,
)
from miho.compiled.phases import CHUNK
from miho.compiled.triangular import between, in_order, norm
from miho.core import machine
from miho.quantities import Array

ACCEPTED, GOOD, POOR = 1e-4, 0.75, 0.25
"""Ratios of gain to predicted gain: above the first a trial is accepted, above the second the
damping decreases, below the third it increases (Marquardt, 1963; Moré, 1978)."""
LESS, MORE = 0.1, 2.0
"""Factors of the damping after a good and a poor step; after failures Nielsen's (1999) factors,
which double each time."""
SMALLEST_DAMPING, LARGEST_DAMPING = 1e-12, 1e12
SECANT = 0.7
"""If the gain exceeds this share of the predicted one, the next derivatives are Broyden updates, a
few times in a row: they cost nothing."""
BEND = 0.75
"""A rejected trial is corrected for curvature if this turns its step by at most this share, in the
metric of the scales (Transtrum and Sethna, 2012)."""
CORRECTED = -1
"""Value of `secants` that marks a corrected trial."""
DONE_DAMPING, DONE_LESS = 1e-3, 1e-3
"""If the predicted gain is below the tolerance, a candidate is done if the damping is at most the
first value, or the gain at most the second share of the tolerance; otherwise the damping may be the
reason, and decreases."""
TRIES = 12
"""Largest number of decreases of the damping, before the last step is tried in spite of its small
predicted gain."""
RESTART_DAMPING = 1e-6
"""Smallest damping after a failed step."""
SMALLEST_SCALE = 1e-10
"""Smallest scale relative to the largest, for parameters without effect on the residuals."""


class Work(NamedTuple):
    """Work arrays for the steps of one candidate with d parameters, m rows and some levels.

    theta, step (d,): the configuration in units, and a step. sums (levels,): sums of squares.
    T (d + 1, d + 1): a triangular factor. chunk (d + 1, CHUNK): columns to fold into T.
    residuals (m,): values from the problem.
    """

    theta: Array
    step: Array
    sums: Array
    T: Array
    chunk: Array
    residuals: Array

    @classmethod
    def of(cls, d: int, m: int, levels: int) -> Work:
        """New work arrays."""
        n, zeros = d + 1, np.zeros
        return cls(zeros(d), zeros(d), zeros(levels), zeros((n, n)), zeros((n, CHUNK)), zeros(m))


def to_units(x: Array, box: GNBox, theta: Array) -> None:
    """Write the configuration at unit coordinates x (d,) into theta (d,), in units."""
    theta[:] = box.origin + box.width * x
    for k in box.log.nonzero()[0]:
        theta[k] = math.exp(theta[k])
    theta[:] = between(box.low, theta, box.high)


def take_factor(c: GNCandidates, i: int, box: GNBox, w: Work) -> None:
    """Set R, q and D of a candidate from w.T, the triangular factor of derivatives and residuals.

    The columns of w.T are the d parameters and the residuals; with projection, first the free
    linear parameters, then the nonlinear ones and the residuals. The rows below the first ones are
    then Kaufman's (1975) Jacobian of the reduced problem.
    """
    # Skip the projected columns, which come first, and as many rows.
    d = c.x.shape[1]
    n, first = d, 0
    if c.projects[i]:
        n, first = box.nonlinear.size, sum(is_free(c.x[i, k]) for k in box.linear)
    # Copy the triangle; a scale is the norm of its column, and decreases slowly.
    R = c.R[i, :n, :n] = w.T[first : first + n, first : first + n]
    q = c.q[i, :n] = w.T[first : first + n, first + n]
    squares = np.zeros(n)
    for row in R:
        squares += row * row
    D, faded = np.sqrt(squares), c.fading[i] * c.D[i, :n]
    D = np.where(faded > D, faded, D)
    largest = np.fmax.reduce(D, initial=0.0)
    finite = bool((np.isfinite(D) & np.isfinite(q)).all())
    c.D[i, :n] = np.maximum(D, SMALLEST_SCALE * largest)
    c.stage[i] = READY if finite else UNUSABLE
    if finite and n and largest == 0:
        c.stage[i] = DONE


def is_free(x: float) -> bool:
    """Whether a coordinate is off the bounds."""
    return INSIDE < x < 1 - INSIDE


def judge_trial(
    c: GNCandidates, i: int, loss: float, box: GNBox, m: int, rules: GNRules, w: Work
) -> None:
    """Accept or reject the trial of a candidate by its loss; its residuals are in w."""
    d = c.x.shape[1]
    # The first evaluation gives the loss with which trials are compared.
    if c.stage[i] == ENTER:
        c.x[i] = c.trial[i]
        c.loss[i] = loss
        c.stage[i] = SLOPES if math.isfinite(loss) else UNUSABLE
        c.loss_at_mark[i], c.spent_at_mark[i] = loss, c.spent[i]
        keep_residuals(c, i, m, w)
        return
    # rho is the gain over the predicted gain.
    c.trials[i] += 1
    actual, predicted = (c.loss[i] - loss) * m, c.predicted_gain[i]
    rho = actual / predicted if predicted > 0 and math.isfinite(loss) else -1.0
    if rho > ACCEPTED:
        c.secants[i] = max(c.secants[i], 0)
        # Broyden update if the linear model holds well.
        secant = (
            rho > SECANT
            and c.secants[i] < rules.secants
            and c.derivatives.shape[2] > 0
            and not c.projects[i]
        )
        if secant:
            broyden(c, i, m, w)
        else:
            keep_residuals(c, i, m, w)
        # Move to the trial, and adapt the damping.
        c.x[i] = c.trial[i]
        c.loss[i] = loss
        if rho > GOOD:
            c.damping[i] = max(LESS * c.damping[i], SMALLEST_DAMPING)
        elif rho < POOR:
            c.damping[i] *= MORE
        c.growth[i] = 2.0
        c.stage[i] = SLOPES
        if secant:
            c.secants[i] += 1
            refold(c.derivatives[i], d, c.derivatives[i, d], m, w)
            take_factor(c, i, box, w)
            if c.stage[i] == UNUSABLE:
                c.stage[i], c.secants[i] = SLOPES, 0
        if loss <= rules.rounding:
            c.stage[i] = DONE
    elif c.secants[i] > 0:
        # Rejected: evaluate the derivatives, in case the update was wrong.
        c.stage[i], c.secants[i] = SLOPES, 0
    elif math.isfinite(loss) and correct_trial(c, i, m, rules, w):
        c.secants[i] = CORRECTED
    else:
        # Otherwise damp more.
        c.secants[i] = 0
        c.damping[i] = max(c.damping[i] * c.growth[i], RESTART_DAMPING)
        c.growth[i] *= 2.0
        c.stage[i] = DONE if c.damping[i] > LARGEST_DAMPING else READY


def correct_trial(c: GNCandidates, i: int, m: int, rules: GNRules, w: Work) -> bool:
    """Correct a rejected trial for the curvature that its residuals, in w, show.

    Along the step v the residuals are r + J v + b, with bend b. The corrected step minimises |J s +
    r + b|^2 with the same damping: to second order it is v plus half the geodesic acceleration
    (Transtrum and Sethna, 2012), without further derivatives. Returns false if derivatives are not
    stored, or are updated ones, if the trial was corrected already, or if it would turn too far.
    """
    d = c.x.shape[1]
    if c.derivatives.shape[2] == 0 or c.projects[i] or c.secants[i]:
        return False
    # Q' (r + b) from the residuals of the trial.
    x, trial, D = c.x[i], c.trial[i], c.D[i]
    refold(c.derivatives[i], d, w.residuals, m, w)
    q = w.T[:d, d]
    for k in range(d):
        q[: k + 1] -= c.R[i, : k + 1, k] * (trial[k] - x[k])
    if not np.isfinite(q).all():
        return False
    low, high = limits(x, rules)
    solve_in_box(c.R[i], q, damping_of(c, i, d, rules.last), low, high, w.step)
    before = D * (trial - x)
    change = D * w.step - before
    if in_order(change * change) > BEND * BEND * in_order(before * before):
        return False
    trial[:] = between(0.0, x + w.step, 1.0)
    return True


def limits(x: Array, rules: GNRules) -> tuple[Array, Array]:
    """Bounds of a step from coordinates (n,), in the box and within reach."""
    return np.maximum(-x, -rules.reach), np.minimum(1 - x, rules.reach)


def damping_of(c: GNCandidates, i: int, n: int, alike: bool) -> Array:
    """Damping of the first n coordinates as square roots, (n,).

    The stronger the damping, the more equally coordinates count. A scale is the size of a
    parameter's derivatives at the candidate; long steps along parameters without effect there would
    be rejected. Without `alike` the scales alone count: on fewer than all rows, where there are
    many candidates and steps are cheap, and to decide whether a descent is done.
    """
    D, least = c.D[i, :n], 0.0
    if alike:
        largest = np.fmax.reduce(D, initial=0.0)
        least = min(c.damping[i], 1.0) * largest * largest
    return np.asarray(math.sqrt(c.damping[i]) * np.sqrt(D * D + least))


def keep_residuals(c: GNCandidates, i: int, m: int, w: Work) -> None:
    """Store the residuals of a candidate with its derivatives, if there is room for them."""
    if c.derivatives.shape[2]:
        c.derivatives[i, c.x.shape[1]] = w.residuals[:m]


def broyden(c: GNCandidates, i: int, m: int, w: Work) -> None:
    """Broyden update of the derivatives after a trial, in the metric of the scales D."""
    w.step[:] = c.trial[i] - c.x[i]
    scaled = c.D[i] * w.step
    update_columns(c.derivatives[i], c.D[i], in_order(scaled * scaled), m, w)


def update_columns(columns: Array, D: Array, total: float, m: int, w: Work) -> None:
    """Broyden update of the columns (d + 1, m) after the step w.step of squared length `total`."""
    d, step = D.size, w.step
    missing = w.residuals[:m] - columns[d, :m]
    for k in range(d):
        missing -= columns[k, :m] * step[k]
    missing /= total
    for k in range(d):
        columns[k, :m] += missing * D[k] * D[k] * step[k]
    columns[d, :m] = w.residuals[:m]


def refold(columns: Array, count: int, last: Array, m: int, w: Work) -> None:
    """Triangular factor of the first `count` columns (., m) and of `last`, into w.T."""
    w.T[:] = 0.0
    for start in range(0, m, CHUNK):
        size = min(CHUNK, m - start)
        for k in range(count + 1):
            column = columns[k] if k < count else last
            w.chunk[k, :size] = column[start : start + size]
        fold(w.T, w.chunk, size, count + 1)


def propose_trial(c: GNCandidates, i: int, box: GNBox, m: int, rules: GNRules, w: Work) -> None:
    """Set the next trial of a candidate with known derivatives, or mark it as done."""
    moved = box.nonlinear if c.projects[i] else np.arange(c.x.shape[1])
    n, at = moved.size, c.x[i, moved]
    if n == 0:
        c.stage[i], c.predicted_gain[i] = DONE, 0.0
        return
    # Decrease the damping until the predicted gain is large enough.
    (low, high), step, q = limits(at, rules), w.step[:n], c.q[i, :n]
    total, square = c.loss[i] * m, in_order(q * q)
    for _ in range(TRIES):
        predicted = 0.0
        for alike in range(int(rules.last), -1, -1):
            solve_in_box(c.R[i], q, damping_of(c, i, n, alike > 0), low, high, step)
            c.predicted_gain[i] = square - norm(c.R[i], q, step)
            predicted = c.predicted_gain[i] / total if total > 0 else 0.0
            if predicted > rules.tolerance:
                break
        if predicted > rules.tolerance:
            break
        if c.damping[i] <= DONE_DAMPING or predicted <= DONE_LESS * rules.tolerance:
            c.stage[i] = DONE
            if c.secants[i] and rules.last:  # by updated derivatives: evaluate them first
                c.stage[i], c.secants[i] = SLOPES, 0
            return
        c.damping[i] *= LESS
    # A step that rounding removes ends the descent.
    c.trial[i] = c.x[i]
    c.trial[i, moved] = between(0.0, at + step, 1.0)
    c.stage[i] = TRIED if (c.trial[i] != c.x[i]).any() else DONE


def nears_known_minimum(
    c: GNCandidates, i: int, box: GNBox, m: int, minima: Minima, rules: GNRules
) -> bool:
    """Whether a candidate is on its way to a known minimum, and no better."""
    near = rules.near * c.loss[i] * m
    for k in range(minima.loss.size if rules.ending else 0):
        loss = minima.sums[k, rules.level] / m
        worse = minima.determined[k] and c.loss[i] >= loss * (1 - rules.better)
        if worse and square_distance(c, i, minima.x[k], box) <= near:
            return True
    return False


def prepare(
    c: GNCandidates, i: int, box: GNBox, m: int, minima: Minima, rules: GNRules, w: Work
) -> bool:
    """Bring a candidate to its next evaluation; false if it needs none in this block."""
    while c.stage[i] == SLOPES or c.stage[i] == READY:
        if c.stage[i] == READY and nears_known_minimum(c, i, box, m, minima, rules):
            c.stage[i] = AT_KNOWN
        elif c.trials[i] >= rules.steps or crawls(c, i, rules):
            return False
        elif c.stage[i] == SLOPES:
            return True
        else:
            propose_trial(c, i, box, m, rules, w)
    return bool(c.stage[i] < DONE)


def crawls(c: GNCandidates, i: int, rules: GNRules) -> bool:
    """Whether a candidate gains too little for its rows, and has used its allowance."""
    if rules.patience == 0 or c.spent[i] - c.spent_at_mark[i] < rules.patience:
        return False
    if c.loss[i] > (1 - rules.progress) * c.loss_at_mark[i]:
        return bool(c.spent[i] >= rules.allowance)
    c.spent_at_mark[i], c.loss_at_mark[i] = c.spent[i], c.loss[i]
    return False


def solve_linear(c: GNCandidates, i: int, box: GNBox, m: int, w: Work) -> float:
    """Move a trial to its best linear parameters, and return the loss there, by algebra.

    w.T is the triangular factor of their columns, in box widths, and of the residuals at w.theta.
    The loss is infinite if it is not finite.
    """
    linear, p = box.linear, box.linear.size
    if not np.isfinite(w.T[: p + 1, : p + 1]).all():
        return math.inf
    low, high, theta = box.low[linear], box.high[linear], w.theta[linear]
    width, step, q = high - low, w.step[:p], w.T[:p, p]
    solve_in_box(w.T, q, np.zeros(p), (low - theta) / width, (high - theta) / width, step)
    square = w.T[p, p] * w.T[p, p] + norm(w.T, q, step)
    values = between(low, theta + width * step, high)
    for j in box.log[linear].nonzero()[0]:
        values[j] = math.log(values[j])
    values = (values - box.origin[linear]) / box.width[linear]
    c.trial[i, linear] = between(0.0, values, 1.0)
    return float(square / m)


def after_evaluation(
    c: GNCandidates, i: int, loss: float, box: GNBox, m: int, rules: GNRules, best: float, w: Work
) -> None:
    """Advance a candidate after an evaluation, with the loss from residuals or from algebra.

    The loss at solved linear parameters is known by algebra only. On all rows an improvement is
    evaluated once more (RECORD), so that every recorded loss was evaluated.
    """
    if c.stage[i] == RECORD:
        c.stage[i] = c.stage_after_record[i]
        c.sums[i] = w.sums
        return
    previous = c.loss[i]
    judge_trial(c, i, loss, box, m, rules, w)
    if c.projects[i]:
        if rules.last and c.loss[i] < previous and c.loss[i] < best:
            c.stage_after_record[i] = c.stage[i]
            c.stage[i] = RECORD
    elif c.loss[i] < previous:
        c.sums[i] = w.sums


def fold(T: Array, columns: Array, count: int, n: int) -> None:
    """As `miho.compiled.triangular.fold`."""
    (machine() or triangular).fold(T, columns, count, n)


def solve_in_box(R: Array, q: Array, scale: Array, low: Array, high: Array, s: Array) -> None:
    """As `miho.compiled.triangular.solve_in_box`."""
    (machine() or triangular).solve_in_box(R, np.ascontiguousarray(q), scale, low, high, s)
