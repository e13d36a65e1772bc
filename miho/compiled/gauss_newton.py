"""Levenberg-Marquardt steps of many candidates side by side.

These functions are the steps between two evaluations: each advances a candidate from one stage to
the next. The machine of `miho.core` has the same steps in C (`steps.c`) for models that it runs.
The Python functions serve all other models (`miho.optim.gauss_newton_steps`), and tests compare the
C with them. A run that stops between two evaluations resumes without a difference.
"""

from __future__ import annotations

import math

from miho.compiled.factors import fold, solve_in_box
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
from miho.compiled.triangular import norm
from miho.compiled.workspace import Work
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


def to_units(x: Array, box: GNBox, theta: Array) -> None:
    """Write the configuration at unit coordinates x (d,) into theta (d,), in units."""
    for k in range(x.size):
        value = box.origin[k] + box.width[k] * x[k]
        if box.log[k]:
            value = math.exp(value)
        theta[k] = min(max(value, box.low[k]), box.high[k])


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
        n = box.nonlinear.size
        for k in box.linear:
            first += is_free(c.x[i, k])
    # Copy the triangle; a scale is the norm of its column, and decreases slowly.
    R, q, D = c.R[i], c.q[i], c.D[i]
    finite, largest = True, 0.0
    for k in range(n):
        square = 0.0
        for j in range(n):
            R[j, k] = w.T[first + j, first + k] if j <= k else 0.0
            square += R[j, k] * R[j, k]
        q[k] = w.T[first + k, first + n]
        D[k] = max(math.sqrt(square), c.fading[i] * D[k])
        largest = max(largest, D[k])
        finite = finite and math.isfinite(D[k]) and math.isfinite(q[k])
    for k in range(n):
        D[k] = max(D[k], SMALLEST_SCALE * largest)
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
    x, trial, q = c.x[i], c.trial[i], w.T[:, d]
    refold(c.derivatives[i], d, w.residuals, m, w)
    for k in range(d):
        for j in range(k, d):
            q[k] -= c.R[i, k, j] * (trial[j] - x[j])
        if not math.isfinite(q[k]):
            return False
        w.low[k], w.high[k] = max(-x[k], -rules.reach), min(1 - x[k], rules.reach)
    set_damping(c, i, d, rules.last, w.scale)
    solve_in_box(c.R[i], q, w.scale, w.low, w.high, d, w.step, w.solver)
    turn, length = 0.0, 0.0
    for k in range(d):
        before = c.D[i, k] * (trial[k] - x[k])
        change = c.D[i, k] * w.step[k] - before
        turn += change * change
        length += before * before
    if turn > BEND * BEND * length:
        return False
    for k in range(d):
        trial[k] = min(max(x[k] + w.step[k], 0.0), 1.0)
    return True


def set_damping(c: GNCandidates, i: int, n: int, alike: bool, scale: Array) -> None:
    """Write the damping of the first n coordinates as square roots.

    The stronger the damping, the more equally coordinates count. A scale is the size of a
    parameter's derivatives at the candidate; long steps along parameters without effect there would
    be rejected. Without `alike` the scales alone count: on fewer than all rows, where there are
    many candidates and steps are cheap, and to decide whether a descent is done.
    """
    largest = 0.0
    for k in range(n):
        largest = max(largest, c.D[i, k])
    root, least = math.sqrt(c.damping[i]), 0.0
    if alike:
        least = min(c.damping[i], 1.0) * largest * largest
    for k in range(n):
        scale[k] = root * math.sqrt(c.D[i, k] * c.D[i, k] + least)


def keep_residuals(c: GNCandidates, i: int, m: int, w: Work) -> None:
    """Store the residuals of a candidate with its derivatives, if there is room for them."""
    if c.derivatives.shape[2]:
        c.derivatives[i, c.x.shape[1]] = w.residuals[:m]


def broyden(c: GNCandidates, i: int, m: int, w: Work) -> None:
    """Broyden update of the derivatives after a trial, in the metric of the scales D."""
    x, trial, D = c.x[i], c.trial[i], c.D[i]
    total = 0.0
    for k in range(x.size):
        w.step[k] = trial[k] - x[k]
        scaled = D[k] * w.step[k]
        total += scaled * scaled
    update_columns(c.derivatives[i], D, total, m, w)


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
    d = c.x.shape[1]
    n = box.nonlinear.size if c.projects[i] else d
    x, trial = c.x[i], c.trial[i]
    if n == 0:
        c.stage[i], c.predicted_gain[i] = DONE, 0.0
        return
    # The step stays in the box, and within reach.
    low, high, scale = w.low, w.high, w.scale
    for k in range(n):
        at = x[box.nonlinear[k]] if c.projects[i] else x[k]
        low[k], high[k] = max(-at, -rules.reach), min(1 - at, rules.reach)
    # Decrease the damping until the predicted gain is large enough.
    total = c.loss[i] * m
    square = 0.0
    for k in range(n):
        square += c.q[i, k] * c.q[i, k]
    for _ in range(TRIES):
        predicted = 0.0
        for alike in range(int(rules.last), -1, -1):
            set_damping(c, i, n, alike > 0, scale)
            solve_in_box(c.R[i], c.q[i], scale, low, high, n, w.step, w.solver)
            c.predicted_gain[i] = square - norm(c.R[i], c.q[i], n, w.step)
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
    for k in range(d):
        trial[k] = x[k]
    differs = False
    for k in range(n):
        at = box.nonlinear[k] if c.projects[i] else k
        trial[at] = min(max(x[at] + w.step[k], 0.0), 1.0)
        differs = differs or trial[at] != x[at]
    c.stage[i] = TRIED if differs else DONE


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
    solve_in_box(w.T, q, w.scale, w.low, w.high, p, w.step, w.solver)
    square = w.T[p, p] * w.T[p, p] + norm(w.T, q, p, w.step)
    for j in range(p):
        k = box.linear[j]
        value = w.theta[k] + (box.high[k] - box.low[k]) * w.step[j]
        value = min(max(value, box.low[k]), box.high[k])
        if box.log[k]:
            value = math.log(value)
        c.trial[i, k] = min(max((value - box.origin[k]) / box.width[k], 0.0), 1.0)
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
