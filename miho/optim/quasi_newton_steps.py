"""Quasi-Newton steps of candidates: the losses that they need, and their next stages.

`requests_of` collects the needs of all candidates as offsets from their positions; `answer` passes
each its losses and advances it to its next stage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from miho.optim.quasi_newton import (
    bfgs,
    convex,
    curve_along,
    diagonal,
    mixed,
    newton_steps,
    parabolas,
)
from miho.optim.quasi_newton_candidates import (
    CURVATURE,
    DONE,
    HESSIAN,
    LOOK,
    SLOPE,
    STUCK,
    TRIAL,
    UNUSABLE,
    WAIT,
    Indices,
    LossRequest,
    QNBox,
    QNCandidates,
)
from miho.quantities import Array

FIRST = 1e-3
"""Offsets of differences if no curvature is known, as shares of the widths."""
SLOPE_OFFSETS = 1e-4, 1e-8, 1e-3
HESSIAN_OFFSETS = 1e-2, 1e-6, 1e-2
"""Offsets otherwise: a share of the distance at which the curvature alone would double the loss,
between the second and the third value as shares of the widths. The error of a loss is divided by
the offset in slopes and by its square in curvatures: at these offsets 1e-16 of a loss is 1e-12 of
either."""
ACCEPTED, GOOD, POOR = 1e-4, 0.75, 0.1
"""Ratios of gain to predicted gain: above the first a step is accepted, above the second the trust
region grows, below the third it shrinks (Nocedal and Wright, 2006, Algorithm 4.1)."""
AS_PREDICTED = 0.2
"""The model holds if a step gains the prediction, up to this share."""
FAILURES = 8
"""A candidate is STUCK after more consecutive rejected steps; its trust region is then at most 2^-8
of the original one."""
SHORTEST = 1e-10
"""Smallest radius as a share of the widths; much shorter steps are lost in rounding."""
LARGE = 1e-3
"""With at least this radius, a model without gain is not limited by the radius."""


@dataclass(frozen=True)
class QNRules:
    """Rules of steps on a level.

    Attributes
    ----------
    cost : float
        Cost of one evaluation.
    tolerance : float
        A descent has converged if its model predicts a relative gain below this; on the `last`
        level also after a step that gains less.
    last : bool
        Whether the level uses all rows.
    screens : bool
        Whether candidates need a first loss only.
    measures : bool
        Whether Hessians are measured by differences: before convergence, and again if the model is
        wrong, after `refresh` times the evaluations of a Hessian.
    refresh : float
        See `measures`.
    guesses : int
        Largest number of consecutive steps with predicted slopes.
    radius : float
        Longest step along each coordinate.
    rounding : float
        Largest loss that counts as 0.
    """

    cost: float
    tolerance: float
    last: bool
    screens: bool
    measures: bool
    refresh: float
    guesses: int
    radius: float
    rounding: float


def requests_of(c: QNCandidates, box: QNBox) -> list[LossRequest]:
    """Needs of the candidates, one request for each stage that occurs."""
    requests = []
    for stage in range(WAIT):
        index = np.flatnonzero(c.stage == stage)
        if index.size:
            requests.append(LossRequest(stage, index, _offsets(c, box, stage, index)))
    return requests


def points(c: QNCandidates, box: QNBox, requests: list[LossRequest]) -> Array:
    """Points of requests in search coordinates, one after the other, (n, d)."""
    d = c.z.shape[1]
    parts = [box.moved(c.z[r.index, None], r.offsets).reshape(-1, d) for r in requests]
    return np.concatenate(parts) if parts else np.empty((0, d))


def answer(
    c: QNCandidates, box: QNBox, rules: QNRules, requests: list[LossRequest], losses: Array
) -> None:
    """Pass each candidate the losses of its points, and determine its next stage."""
    start = 0
    for request in requests:
        n, k, _ = request.offsets.shape
        values = losses[start : start + n * k].reshape(n, k)
        start += n * k
        if request.stage != HESSIAN:  # progress is measured without the cost of Hessians
            c.spent_since_mark[request.index] += k * rules.cost
        c.hessian_age[request.index] += k
        if request.stage == LOOK:
            _look(c, rules, request.index, values)
        elif request.stage == SLOPE:
            _slope(c, box, rules, request, values)
        elif request.stage == TRIAL:
            _trial(c, box, rules, request.index, values[:, 0])
        else:
            _curvature(c, box, rules, request, values)


def _offsets(c: QNCandidates, box: QNBox, stage: int, index: Indices) -> Array:
    """Offsets at which a stage needs losses, (n, k, d): forward, backward and mixed differences."""
    n, d = index.size, c.z.shape[1]
    if stage == LOOK:
        return np.zeros((n, 1, d))
    if stage == TRIAL:
        return c.step[index][:, None]
    share, least, most = SLOPE_OFFSETS if stage == SLOPE else HESSIAN_OFFSETS
    with np.errstate(all="ignore"):
        h = share * np.sqrt(np.abs(c.loss[index, None]) / diagonal(c.B[index]))
    h = np.where(c.has_curvature[index, None], np.clip(h, least, most), FIRST)
    x, eye = box.shares(c.z[index]), np.eye(d)
    a = np.where(x + h <= 1, h, -h)
    forward = a[:, :, None] * eye
    if stage == SLOPE:
        return forward
    b = np.where((a > 0) & (x - h >= 0), -h, a / 2)
    parts = [forward, b[:, :, None] * eye]
    if stage == HESSIAN:
        i, j = np.triu_indices(d, 1)
        parts.append(forward[:, i] + forward[:, j])
    return np.concatenate(parts, axis=1)


def _look(c: QNCandidates, rules: QNRules, index: Indices, values: Array) -> None:
    """Record the loss on a level's rows; the slopes must be measured again on these rows."""
    c.loss[index] = c.loss_at_mark[index] = values[:, 0]
    c.measured_at[index] = c.z[index]
    c.guesses[index] = c.failures[index] = 0
    next_stage = WAIT if rules.screens else np.where(c.has_curvature[index], SLOPE, CURVATURE)
    c.stage[index] = np.where(np.isfinite(values[:, 0]), next_stage, UNUSABLE)


def _slope(
    c: QNCandidates, box: QNBox, rules: QNRules, request: LossRequest, values: Array
) -> None:
    """Record slopes by forward differences, corrected for the curvature, and update B by them."""
    index, a = request.index, diagonal(request.offsets)
    g = (values - c.loss[index, None]) / a - 0.5 * a * diagonal(c.B[index])
    g = np.where(np.isfinite(g), g, 0.0)
    s = (c.z[index] - c.measured_at[index]) / box.width
    away = s.any(axis=1)
    if away.any():
        m = index[away]
        c.B[m] = bfgs(c.B[m], s[away], g[away] - c.measured_g[m])
    _set_slopes(c, box, rules, index, g)


def _curvature(
    c: QNCandidates, box: QNBox, rules: QNRules, request: LossRequest, values: Array
) -> None:
    """Record slopes and curvatures by central differences, and mixed ones for a Hessian."""
    index, d = request.index, c.z.shape[1]
    a, b = diagonal(request.offsets[:, :d]), diagonal(request.offsets[:, d : 2 * d])
    ahead, loss = values[:, :d], c.loss[index]
    slope, curvature = parabolas(loss, a, ahead, b, values[:, d : 2 * d])
    if request.stage == HESSIAN:
        c.B[index] = convex(mixed(loss, a, ahead, values[:, 2 * d :], curvature), slope)
        c.hessian_age[index] = 0.0
    else:
        # along one coordinate no step is longer than a quarter of the box
        size = np.abs(curvature)
        least = np.maximum(1e-4 * size.max(axis=1, keepdims=True), np.finfo(float).tiny)
        size = np.maximum(np.maximum(size, least), 4 * np.abs(slope))
        c.B[index] = size[:, :, None] * np.eye(d)
    c.has_curvature[index] = True
    _set_slopes(c, box, rules, index, slope)


def _set_slopes(c: QNCandidates, box: QNBox, rules: QNRules, index: Indices, g: Array) -> None:
    """Record measured slopes g (n, d), and propose the next steps."""
    c.g[index] = c.measured_g[index] = g
    c.measured_at[index] = c.z[index]
    c.guesses[index] = 0
    _propose(c, box, rules, index)


def _propose(c: QNCandidates, box: QNBox, rules: QNRules, index: Indices) -> None:
    """Set the next step of each candidate, or end its descent if its model predicts no gain.

    Predicted slopes and curvatures are measured first.
    """
    if not index.size:
        return
    x, radius = box.shares(c.z[index]), c.radius[index, None]
    low, high = np.maximum(-x, -radius), np.minimum(1 - x, radius)
    step, gain = newton_steps(c.B[index], c.g[index], low, high)
    c.step[index], c.predicted_gain[index] = step, gain
    tolerance = rules.tolerance * np.abs(c.loss[index])
    converged = (gain <= tolerance) & ((radius[:, 0] > LARGE) | (gain <= 1e-3 * tolerance))
    no_gain = ~(gain >= 0)  # a model so narrow that its minimum is rounding
    ends = converged | no_gain
    zero = np.abs(c.loss[index]) <= rules.rounding
    age = c.hessian_age[index]
    unmeasured = rules.measures & (np.isinf(age) | (no_gain & (age > 0)))
    c.stage[index] = np.select(
        [zero, ends & unmeasured, ends & (c.guesses[index] > 0), no_gain, converged],
        [DONE, HESSIAN, SLOPE, STUCK, DONE],
        TRIAL,
    )


def _trial(c: QNCandidates, box: QNBox, rules: QNRules, index: Indices, loss: Array) -> None:
    """Accept or reject steps by their losses (n,), update the models, and set the next stages."""
    # Gain of each step, and whether a step with predicted slopes (`guess`) may follow.
    step, gain = c.step[index], c.predicted_gain[index]
    finite = np.isfinite(loss)
    fall = np.where(finite, c.loss[index] - loss, -np.inf)
    ratio = fall / gain
    accepted = ratio > ACCEPTED
    c.steps_left[index] -= 1
    c.failures[index] = np.where(accepted, 0, c.failures[index] + 1)
    more = c.steps_left[index] > 0
    holds = np.abs(ratio - 1) < AS_PREDICTED
    guess = accepted & more & holds & (c.guesses[index] < rules.guesses)

    # The loss of a step gives the curvature along it: for the radius, and for B.
    slope = np.einsum("ni,ni->n", c.g[index], step)
    curvature = np.where(finite, -2 * (fall + slope), np.nan)
    predicted = np.einsum("ni,nij,nj->n", step, c.B[index], step)
    c.radius[index] = _radius(
        c.radius[index], step, accepted, ratio, slope, curvature, rules.radius
    )
    # Slopes that are measured next determine more than the loss of one step.
    learns = np.where(accepted, (curvature > 0) & (guess | ~more), curvature > predicted)
    i = index[learns]
    c.B[i] = curve_along(c.B[i], step[learns], curvature[learns])

    # Move, and predict the slopes there.
    i = index[accepted]
    c.z[i], c.loss[i] = box.moved(c.z[i], step[accepted]), loss[accepted]
    i = index[guess]
    c.g[i] += np.einsum("nij,nj->ni", c.B[i], step[guess])
    c.guesses[i] += 1

    # The next stage; candidates with known slopes propose their next step at once.
    measured = c.guesses[index] == 0
    little = rules.last & accepted & (fall <= rules.tolerance * np.abs(loss)) & measured
    d = step.shape[1]
    old = rules.measures & ~holds & (c.hessian_age[index] >= rules.refresh * d * (d + 3) / 2)
    c.stage[index] = np.select(
        [~accepted & (c.failures[index] > FAILURES), little, ~more, old],
        [STUCK, DONE, WAIT, HESSIAN],
        SLOPE,
    )
    knows_slopes = (c.stage[index] == SLOPE) & (guess | (~accepted & measured))
    _propose(c, box, rules, index[knows_slopes])


def _radius(
    radius: Array,
    step: Array,
    accepted: NDArray[np.bool_],
    ratio: Array,
    slope: Array,
    curvature: Array,
    largest: float,
) -> Array:
    """Radius of the next steps, (n,), after steps (n, d) with this `ratio` of gain to prediction.

    After a rejected step it is the minimum of the parabola along the step, 0.1 to 0.5 of its
    length.
    """
    size = np.abs(step).max(axis=1)
    with np.errstate(all="ignore"):
        shorter = np.where(curvature > 0, np.clip(-slope / curvature, 0.1, 0.5), 0.25)
    grows = (ratio > GOOD) & (size > 0.8 * radius)
    following = np.where(grows, np.minimum(largest, 2.5 * radius), radius)
    following = np.where(ratio < POOR, 0.5 * size, following)
    return np.maximum(np.where(accepted, following, shorter * size), SHORTEST)
