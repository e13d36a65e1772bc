"""Phases of a bracket: which candidates continue, and on how many rows.

Candidates make steps between two phases. They are moved within their arrays, the best first;
`order` (n,) has room for their positions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from miho.compiled.gauss_newton_candidates import (
    AT_KNOWN,
    COPY,
    COPY_LOSS,
    DONE,
    LEVEL,
    PHASE,
    READY,
    SIZE,
    UNUSABLE,
    GNBox,
    GNCandidates,
    GNSettings,
    Minima,
)
from miho.compiled.phases import (
    EMPTY,
    ENTERING,
    FINISH,
    LEAD,
    POLISH,
    RETURNED,
    REVIVE,
    RUNG,
    SCREEN,
    SOLVED,
    UNLIMITED,
    begin,
    look_again,
    nearness,
)
from miho.compiled.triangular import norm
from miho.quantities import Array, Integers

POLISHING = 50
"""Steps of the final descent, at most; in a narrow valley they would take long."""


class GNRules(NamedTuple):
    """Rules of a block of steps.

    Attributes
    ----------
    level, last : int, bool
        Level whose rows are used, and whether these are all rows.
    steps : int
        Largest number of trials of a candidate.
    reach : float
        Longest step, in box widths.
    secants : int
        Largest number of consecutive Broyden updates.
    tolerance : float
        A candidate is done if the predicted gain is below this share of the sum of squares.
    patience, progress, allowance : int, float, int
        A candidate that gains less than the share `progress` of its loss over `patience` rows (0:
        unlimited) stops once it has used `allowance` rows.
    near, better : float
        Squared distance from a known minimum, in shares of the sum of squares, at which a candidate
        is on its way to it, unless its loss is lower by the share `better`.
    ending : bool
        Whether known minima end descents; only minima that the data determine do, because a descent
        may pass others.
    rounding : float
        Largest loss that counts as 0.
    """

    level: int
    last: bool
    steps: int
    reach: float
    secants: int
    tolerance: float
    patience: int
    allowance: int
    progress: float
    near: float
    better: float
    ending: bool
    rounding: float


def rules_of(place: Integers, level_rows: Integers, d: int, settings: GNSettings) -> GNRules:
    """Rules for the candidates of this phase."""
    phase, level = place[PHASE], place[LEVEL]
    m, last = level_rows[level], level == level_rows.size - 1
    share = d / m  # of a loss; a smaller change is noise
    near, better = nearness(d, m, last)
    steps = UNLIMITED
    if phase == SCREEN:
        steps = 0
    elif phase == RUNG:
        steps = settings.steps
    elif phase == LEAD:
        steps = settings.lead - settings.steps
    elif phase == POLISH:
        steps = POLISHING
    alone = phase in (LEAD, FINISH, REVIVE)
    tolerance = settings.digits if phase == POLISH else settings.tolerance
    return GNRules(
        level,
        last,
        steps,
        settings.reach,
        settings.secants,
        tolerance if last else settings.level_tolerance * share,
        int(settings.patience * (d + 1) * m) if alone else 0,
        settings.allowance if phase == REVIVE else 0,
        settings.progress,
        near,
        better,
        phase != POLISH,
        0.0 if phase == POLISH else settings.rounding,
    )


def next_phase(
    c: GNCandidates,
    place: Integers,
    order: Integers,
    box: GNBox,
    level_rows: Integers,
    minima: Minima,
    settings: GNSettings,
) -> bool:
    """Begin the next phase after the steps of one; false if the bracket has ended.

    A bracket ends if its last candidate has come to its end, or if no candidate can lead to a new
    minimum. The record must then be created again, because the derivatives depend on the level.
    """
    phase, last = place[PHASE], place[LEVEL] == level_rows.size - 1
    if phase > LEAD:
        return False
    sort_usable(c, place, order)
    # A problem that is linear in all parameters is solved: evaluate more rows.
    if phase == SCREEN and settings.solved:
        if not place[SIZE] or last:
            place[PHASE] = SOLVED if place[SIZE] else EMPTY
            return False
        place[LEVEL] += 1
        enter(c, place, level_rows, settings)
        return True
    if phase == SCREEN:
        return begin_rung(c, place, box, level_rows, settings, False)
    # The best candidate of a rung makes more steps, while the others wait.
    if phase == RUNG and place[SIZE] and not last:
        begin(c, place, LEAD, 1)
        return True
    return prune(c, place, order, box, level_rows, minima, settings)


def begin_rung(
    c: GNCandidates,
    place: Integers,
    box: GNBox,
    level_rows: Integers,
    settings: GNSettings,
    entering: bool,
) -> bool:
    """Give the best candidates their steps on this level; a single one has no limit."""
    size = place[SIZE]
    if not size:
        place[PHASE] = EMPTY
        return False
    # A step costs derivatives and one evaluation.
    share = level_rows[place[LEVEL]] / level_rows[-1]
    solved = box.linear.size if settings.projects else 0
    step_cost = (
        share * (1 + solved) + settings.slope_cost * level_rows[place[LEVEL]] / level_rows[-1]
    )
    affordable = max(settings.rung_budget / (settings.steps * step_cost), 1.0)
    place[SIZE] = int(min(affordable, max(1, size // settings.eta)))
    if entering:
        enter(c, place, level_rows, settings)
    alone = place[LEVEL] == level_rows.size - 1 and place[SIZE] == 1
    begin(c, place, FINISH if alone else RUNG, place[SIZE])
    return True


def enter(c: GNCandidates, place: Integers, level_rows: Integers, settings: GNSettings) -> None:
    """Mark the candidates for an evaluation on the rows of the next level."""
    last = place[LEVEL] == level_rows.size - 1
    for i in range(place[SIZE]):
        done = c.stage[i] == DONE
        c.projects[i] = settings.projects and (settings.solved or not done or not last)
        if done:
            c.damping[i] = min(c.damping[i], ENTERING)
    look_again(c, place, level_rows, settings)


def prune(
    c: GNCandidates,
    place: Integers,
    order: Integers,
    box: GNBox,
    level_rows: Integers,
    minima: Minima,
    settings: GNSettings,
) -> bool:
    """Continue on more rows with the candidates that may lead to a new minimum."""
    level, size = place[LEVEL], place[SIZE]
    least = math.inf
    for k in range(minima.loss.size):
        least = min(least, minima.sums[k, level] / level_rows[level])
    count = 0
    for i in range(size):
        if c.stage[i] != AT_KNOWN and not (c.stage[i] == DONE and c.loss[i] >= least):
            order[count] = i
            count += 1
    if count == 0:
        place[PHASE] = RETURNED if size else EMPTY
        return False
    keep(c, place, order, count)
    # Drop copies of better candidates.
    count = 0
    for j in range(place[SIZE]):
        new = True
        for i in order[:count]:
            new = new and not is_copy(c, i, j, box)
        if new:
            order[count] = j
            count += 1
    keep(c, place, order, count)
    entering = level < level_rows.size - 1
    place[LEVEL] += entering
    return begin_rung(c, place, box, level_rows, settings, entering)


def is_copy(c: GNCandidates, i: int, j: int, box: GNBox) -> bool:
    """Whether candidate j, the worse of two, is a copy of i as far as the rows show."""
    modelled = c.stage[i] == READY or c.stage[i] == DONE
    close = c.loss[j] - c.loss[i] <= COPY_LOSS * c.loss[i]
    if not (modelled and close):
        return False
    return bool(square_distance(c, i, c.x[j], box) <= COPY * c.x.shape[1] * c.loss[i])


def sort_usable(c: GNCandidates, place: Integers, order: Integers) -> None:
    """Keep the candidates with finite losses, the best first."""
    size = int(place[SIZE])
    usable = np.flatnonzero((c.stage[:size] != UNUSABLE) & np.isfinite(c.loss[:size]))
    order[: usable.size] = usable[np.argsort(c.loss[usable], kind="stable")]
    keep(c, place, order, usable.size)


def keep(c: GNCandidates, place: Integers, order: Integers, count: int) -> None:
    """Move the candidates at the first `count` positions of `order` to the front, in this order."""
    for array in c[:4]:
        array[:count] = array[order[:count]]
    place[SIZE] = count


def square_distance(c: GNCandidates, i: int, x: Array, box: GNBox) -> float:
    """|R (x_i - x)|^2: the change of a candidate's linear model from x_i to x (d,)."""
    away = c.x[i] - x
    return norm(c.R[i], np.zeros(x.size), away[box.nonlinear] if c.projects[i] else away)
