"""Configurations that descend side by side by quasi-Newton steps, from losses alone.

Each is a small machine: its `stage` says what it needs next. `needs` collects that for all of them
as offsets from where they are, and `answer` gives each its losses.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

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
from miho.optim.space import Space
from miho.quantities import Array

Indices = NDArray[np.intp]

LOOK, SLOPE, CURVATURE, HESSIAN, TRIAL = range(5)
"""What a configuration needs: its loss, differences for slopes, for curvatures or for a Hessian, or
the loss of a step."""
REST, DONE, STUCK, UNUSABLE = range(5, 9)
"""Or nothing: it has had its steps, has converged, finds no step, or has no finite loss."""

FIRST = 1e-3
"""Offsets of differences, in shares of the widths, where no curvature is known."""
SLOPE_OFFSETS = 1e-4, 1e-8, 1e-3
HESSIAN_OFFSETS = 1e-2, 1e-6, 1e-2
"""Elsewhere this share of the distance at which a curvature alone would double a loss, and limits.

Rounding in a loss weighs by the offset in slopes and by its square in curvatures: at these
offsets 1e-16 of a loss is 1e-12 of either.
"""
TAKEN, GOOD, POOR = 1e-4, 0.75, 0.1
"""A step is taken where it gains this share of what its model predicts; from here on the region of
trust grows, and below the last it shrinks (Nocedal and Wright, 2006, Alg. 4.1)."""
AS_PREDICTED = 0.2
"""A step that gains what was predicted but for this share shows that the model holds there."""
FAILURES = 8
"""Steps refused in a row until there is none: the region has then shrunk by 2^-8 at least."""
SHORTEST = 1e-10
"""The least radius: the rounding of a share of the widths is not far."""
LARGE = 1e-3
"""A radius from here on is no reason why a model predicts no gain."""


@dataclass(frozen=True)
class Box:
    """The space's box in search coordinates; steps are shares of its widths."""

    low: Array
    high: Array

    @property
    def width(self) -> Array:
        """The widths, (d,)."""
        return self.high - self.low

    @classmethod
    def of(cls, space: Space) -> Box:
        """The box of a space."""
        return cls(*space.bounds)

    def shares(self, z: Array) -> Array:
        """Search coordinates as shares of the widths, (..., d)."""
        return (z - self.low) / self.width

    def at(self, shares: Array) -> Array:
        """Shares of the widths as search coordinates, (..., d)."""
        return self.moved(self.low, shares)

    def moved(self, z: Array, offsets: Array) -> Array:
        """Where offsets in shares of the widths lead from z, kept in the box."""
        return np.minimum(np.maximum(z + offsets * self.width, self.low), self.high)


@dataclass(frozen=True)
class Rules:
    """How steps are made on a level.

    One evaluation costs `cost`. A model has nothing more to gain where it predicts less than the
    share `tolerance` of the loss; on the `last` level a step that gains less ends a descent too.
    `screens`: a first look is all. `measures`: Hessians are measured, first where a descent seems
    to be done, and again where a model has served for `refresh` times the evaluations of a new one.
    `guesses` steps in a row may rely on slopes that the model predicts. A step is no longer than
    `radius` along each coordinate. A loss up to `rounding` is 0.
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


@dataclass
class Candidates:
    """Configurations of a rung, each with its model of the loss on the rung's rows.

    z (n, d) in search coordinates with losses (n,); slopes g (n, d) and curvatures B (n, d, d) in
    shares of the widths, B unknown unless `curved`. `step` (n, d) is on trial and should gain
    `gain` (n,), within `radius` (n,) along each coordinate. `base` (n, d) is where slopes were
    measured last, as `base_g`; `guesses` (n,) counts the steps since, `age` (n,) the evaluations
    since a Hessian was measured, inf if it never was. `steps` (n,) are left in this phase,
    `failures` (n,) were refused since the last that was taken. `spent` (n,) is what evaluations
    but those of Hessians have cost since the loss was `mark` (n,), against which progress is
    measured.
    """

    z: Array
    loss: Array
    g: Array
    B: Array
    curved: NDArray[np.bool_]
    radius: Array
    stage: Indices
    step: Array
    gain: Array
    base: Array
    base_g: Array
    guesses: Indices
    age: Array
    steps: Indices
    failures: Indices
    spent: Array
    mark: Array

    @classmethod
    def at(cls, z: Array, radius: float) -> Candidates:
        """Configurations of which nothing is known yet."""
        n, d = z.shape
        return cls(
            z=z, loss=np.full(n, np.inf), g=np.zeros((n, d)), B=np.zeros((n, d, d)),
            curved=np.zeros(n, bool), radius=np.full(n, radius), stage=np.full(n, LOOK),
            step=np.zeros((n, d)), gain=np.full(n, np.inf), base=z.copy(),
            base_g=np.zeros((n, d)), guesses=np.zeros(n, int), age=np.full(n, np.inf),
            steps=np.zeros(n, int), failures=np.zeros(n, int), spent=np.zeros(n),
            mark=np.full(n, np.inf),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.z)

    def take(self, some: Indices) -> Candidates:
        """Copies of some."""
        return Candidates(**{each.name: getattr(self, each.name)[some] for each in fields(self)})

    def best(self, n: int) -> Candidates:
        """Copies of the first n; of the `usable` ones, the best."""
        return self.take(np.arange(min(n, len(self))))

    @property
    def usable(self) -> Candidates:
        """Copies of those with a finite loss, in the order of their losses."""
        order = np.argsort(self.loss, kind="stable")
        return self.take(order[self.stage[order] != UNUSABLE])

    def go_on(self, steps: int, some: Indices | slice = slice(None)) -> None:
        """Let some make so many steps, if they are not done; progress is measured from here."""
        self.steps[some], self.spent[some], self.mark[some] = steps, 0.0, self.loss[some]
        stage = np.where(self.curved[some], SLOPE, CURVATURE)
        self.stage[some] = np.where(self.stage[some] == REST, stage, self.stage[some])

    def above(self, i: Indices | slice, away: Array) -> Array:
        """What the models of i (n,) say of the loss at offsets away (n, k, d) from a minimum."""
        return np.asarray(0.5 * np.einsum("nki,nij,nkj->nk", away, self.B[i], away))


@dataclass
class Request:
    """Offsets (n, k, d) of points whose losses `some` of the configurations need at a stage."""

    stage: int
    some: Indices
    offsets: Array


def needs(c: Candidates, box: Box) -> list[Request]:
    """What the configurations need, by stages."""
    requests = []
    for stage in range(REST):
        some = np.flatnonzero(c.stage == stage)
        if some.size:
            requests.append(Request(stage, some, _offsets(c, box, stage, some)))
    return requests


def points(c: Candidates, box: Box, requests: list[Request]) -> Array:
    """The points of requests in search coordinates, one after the other, (n, d)."""
    d = c.z.shape[1]
    parts = [box.moved(c.z[r.some, None], r.offsets).reshape(-1, d) for r in requests]
    return np.concatenate(parts) if parts else np.empty((0, d))


def answer(c: Candidates, box: Box, rules: Rules, requests: list[Request], losses: Array) -> None:
    """Give each configuration the losses of its points, and decide what it needs next."""
    done = 0
    for request in requests:
        n, k, _ = request.offsets.shape
        values = losses[done : done + n * k].reshape(n, k)
        done += n * k
        if request.stage != HESSIAN:  # which is to help: what comes after it is judged
            c.spent[request.some] += k * rules.cost
        c.age[request.some] += k
        if request.stage == LOOK:
            _look(c, rules, request.some, values)
        elif request.stage == SLOPE:
            _slope(c, box, rules, request, values)
        elif request.stage == TRIAL:
            _trial(c, box, rules, request.some, values[:, 0])
        else:
            _curvature(c, box, rules, request, values)


def _offsets(c: Candidates, box: Box, stage: int, some: Indices) -> Array:
    """Where a stage needs losses, (n, k, d): forward, backward and both for mixed differences."""
    n, d = some.size, c.z.shape[1]
    if stage == LOOK:
        return np.zeros((n, 1, d))
    if stage == TRIAL:
        return c.step[some][:, None]
    share, least, most = SLOPE_OFFSETS if stage == SLOPE else HESSIAN_OFFSETS
    with np.errstate(all="ignore"):
        h = share * np.sqrt(np.abs(c.loss[some, None]) / diagonal(c.B[some]))
    h = np.where(c.curved[some, None], np.clip(h, least, most), FIRST)
    x, eye = box.shares(c.z[some]), np.eye(d)
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


def _look(c: Candidates, rules: Rules, some: Indices, values: Array) -> None:
    """The loss on these rows: what is known of slopes is of other rows."""
    c.loss[some] = c.mark[some] = values[:, 0]
    c.base[some] = c.z[some]
    c.guesses[some] = c.failures[some] = 0
    then = REST if rules.screens else np.where(c.curved[some], SLOPE, CURVATURE)
    c.stage[some] = np.where(np.isfinite(values[:, 0]), then, UNUSABLE)


def _slope(c: Candidates, box: Box, rules: Rules, request: Request, values: Array) -> None:
    """Forward differences, less what the known curvature adds to them."""
    some, a = request.some, diagonal(request.offsets)
    g = (values - c.loss[some, None]) / a - 0.5 * a * diagonal(c.B[some])
    g = np.where(np.isfinite(g), g, 0.0)
    s = (c.z[some] - c.base[some]) / box.width
    moved = s.any(axis=1)
    if moved.any():
        m = some[moved]
        c.B[m] = bfgs(c.B[m], s[moved], g[moved] - c.base_g[m])
    _measured(c, box, rules, some, g)


def _curvature(c: Candidates, box: Box, rules: Rules, request: Request, values: Array) -> None:
    """Central differences, and mixed ones for a Hessian."""
    some, d = request.some, c.z.shape[1]
    a, b = diagonal(request.offsets[:, :d]), diagonal(request.offsets[:, d : 2 * d])
    ahead, loss = values[:, :d], c.loss[some]
    slope, curvature = parabolas(loss, a, ahead, b, values[:, d : 2 * d])
    if request.stage == HESSIAN:
        c.B[some] = convex(mixed(loss, a, ahead, values[:, 2 * d :], curvature), slope)
        c.age[some] = 0.0
    else:
        # along one coordinate no step is longer than a quarter of the box
        size = np.abs(curvature)
        least = np.maximum(1e-4 * size.max(axis=1, keepdims=True), np.finfo(float).tiny)
        size = np.maximum(np.maximum(size, least), 4 * np.abs(slope))
        c.B[some] = size[:, :, None] * np.eye(d)
    c.curved[some] = True
    _measured(c, box, rules, some, slope)


def _measured(c: Candidates, box: Box, rules: Rules, some: Indices, g: Array) -> None:
    c.g[some] = c.base_g[some] = g
    c.base[some] = c.z[some]
    c.guesses[some] = 0
    _propose(c, box, rules, some)


def _propose(c: Candidates, box: Box, rules: Rules, some: Indices) -> None:
    """The next step of each, unless its model has nothing more to gain.

    What slopes or curvatures say that were never measured is measured before it is believed.
    """
    if not some.size:
        return
    x, radius = box.shares(c.z[some]), c.radius[some, None]
    low, high = np.maximum(-x, -radius), np.minimum(1 - x, radius)
    step, gain = newton_steps(c.B[some], c.g[some], low, high)
    c.step[some], c.gain[some] = step, gain
    least = rules.tolerance * np.abs(c.loss[some])
    done = (gain <= least) & ((radius[:, 0] > LARGE) | (gain <= 1e-3 * least))
    lost = ~(gain >= 0)  # a model so narrow that its minimum is rounding
    over = done | lost
    nothing = np.abs(c.loss[some]) <= rules.rounding
    unmeasured = rules.measures & (np.isinf(c.age[some]) | (lost & (c.age[some] > 0)))
    c.stage[some] = np.select(
        [nothing, over & unmeasured, over & (c.guesses[some] > 0), lost, done],
        [DONE, HESSIAN, SLOPE, STUCK, DONE],
        TRIAL,
    )


def _trial(c: Candidates, box: Box, rules: Rules, some: Indices, loss: Array) -> None:
    """Take a step that gains, learn from it, and go on by what the model still is worth."""
    step, gain = c.step[some], c.gain[some]
    finite = np.isfinite(loss)
    fall = np.where(finite, c.loss[some] - loss, -np.inf)
    ratio = fall / gain
    taken = ratio > TAKEN
    c.steps[some] -= 1
    c.failures[some] = np.where(taken, 0, c.failures[some] + 1)
    more = c.steps[some] > 0
    holds = np.abs(ratio - 1) < AS_PREDICTED
    guess = taken & more & holds & (c.guesses[some] < rules.guesses)

    slope = np.einsum("ni,ni->n", c.g[some], step)
    curvature = np.where(finite, -2 * (fall + slope), np.nan)
    predicted = np.einsum("ni,nij,nj->n", step, c.B[some], step)
    c.radius[some] = _radius(c.radius[some], step, taken, ratio, slope, curvature, rules.radius)
    # where slopes are measured next, these say more than the loss of one step does
    learns = np.where(taken, (curvature > 0) & (guess | ~more), curvature > predicted)
    who = some[learns]
    c.B[who] = curve_along(c.B[who], step[learns], curvature[learns])

    who = some[taken]
    c.z[who], c.loss[who] = box.moved(c.z[who], step[taken]), loss[taken]
    who = some[guess]
    c.g[who] += np.einsum("nij,nj->ni", c.B[who], step[guess])
    c.guesses[who] += 1

    measured = c.guesses[some] == 0
    little = rules.last & taken & (fall <= rules.tolerance * np.abs(loss)) & measured
    d = step.shape[1]
    old = rules.measures & ~holds & (c.age[some] >= rules.refresh * d * (d + 3) / 2)
    c.stage[some] = np.select(
        [~taken & (c.failures[some] > FAILURES), little, ~more, old],
        [STUCK, DONE, REST, HESSIAN],
        SLOPE,
    )
    same = (c.stage[some] == SLOPE) & (guess | (~taken & measured))
    _propose(c, box, rules, some[same])


def _radius(
    radius: Array,
    step: Array,
    taken: NDArray[np.bool_],
    ratio: Array,
    slope: Array,
    curvature: Array,
    largest: float,
) -> Array:
    """Where models are trusted next, along each coordinate.

    After a refused step up to the minimum of the parabola along it, 0.1 to 0.5 of its length.
    """
    size = np.abs(step).max(axis=1)
    with np.errstate(all="ignore"):
        shorter = np.where(curvature > 0, np.clip(-slope / curvature, 0.1, 0.5), 0.25)
    grows = (ratio > GOOD) & (size > 0.8 * radius)
    kept = np.where(grows, np.minimum(largest, 2.5 * radius), radius)
    kept = np.where(ratio < POOR, 0.5 * size, kept)
    return np.maximum(np.where(taken, kept, shorter * size), SHORTEST)
