"""The phases of a bracket: which candidates go on from steps to steps, and on how many rows.

Between two phases candidates make steps. Candidates are
moved in their arrays, the best first; `order` (n,) is for positions of so many.
"""

from __future__ import annotations

import math

import numpy as np

from miho.compiled.gauss_newton import is_copy
from miho.compiled.gauss_newton_candidates import (
    ACTIVE,
    AT_KNOWN,
    DONE,
    ENTER,
    LEVEL,
    PHASE,
    SIZE,
    STORED,
    UNUSABLE,
    GNBox,
    GNCandidates,
    GNRules,
    GNSettings,
    Minima,
)
from miho.compiled.phases import (
    EMPTY,
    FINISH,
    LEAD,
    POLISH,
    RETURNED,
    REVIVE,
    RUNG,
    SCREEN,
    SOLVED,
    UNLIMITED,
)
from miho.compiled.workspace import copy
from miho.quantities import Integers

NEAR, NEAR_LAST = 9.0, 0.1
"""A candidate is at a known minimum within this squared distance, in shares of its sum of squares
and units of d / rows: the first is 3 standard deviations. On all rows it is at most the second, a
share alone."""
BETTER = 4.0
"""But not if its loss is lower than there by so many d / rows: more than fewer rows may explain."""
ENTERING = 1e-3
"""The largest damping at the start of a level, for a candidate that was done on the one before."""
POLISHING = 50
"""Steps for more digits at most: in a narrow valley they would go on for long."""


def nearness(d: int, m: int, last: bool) -> tuple[float, float]:
    """The squared distance within which a candidate is at a known minimum, and by which share its
    loss is lower where it is not, on m rows."""
    share = d / m
    if last:
        return min(NEAR * share, NEAR_LAST), 0.0
    return NEAR * share, BETTER * share


def rules_of(place: Integers, level_rows: Integers, d: int, settings: GNSettings) -> GNRules:
    """What the candidates of this phase may do."""
    phase, level = place[PHASE], place[LEVEL]
    m, last = level_rows[level], level == level_rows.size - 1
    share = d / m  # of a loss, which so many rows do not tell from noise
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
    """Begin the next phase after the steps of one; false where the bracket has ended.

    It has if its last candidate has come to its end, or no candidate may lead to a minimum that is
    not known. The record is to be made anew, since a level has derivatives of its own.
    """
    phase, last = place[PHASE], place[LEVEL] == level_rows.size - 1
    if phase > LEAD:
        return False
    sort_usable(c, place, order)
    # A problem that is linear in all is solved already: look on more rows.
    if phase == SCREEN and settings.solved:
        if not place[SIZE] or last:
            place[PHASE] = SOLVED if place[SIZE] else EMPTY
            return False
        place[LEVEL] += 1
        enter(c, place, level_rows, settings)
        return True
    if phase == SCREEN:
        return begin_rung(c, place, box, level_rows, settings, False)
    # The best one of a rung has more steps, while the others wait.
    if phase == RUNG and place[SIZE] and not last:
        begin(c, place, LEAD, 1)
        return True
    return prune(c, place, order, box, level_rows, minima, settings)


def begin(c: GNCandidates, place: Integers, phase: int, active: int) -> None:
    """Begin a phase: steps and progress are counted from here."""
    place[PHASE], place[ACTIVE] = phase, active
    for i in range(active):
        c.trials[i] = c.spent[i] = c.spent_at_mark[i] = 0
        c.loss_at_mark[i] = c.loss[i]


def begin_rung(
    c: GNCandidates,
    place: Integers,
    box: GNBox,
    level_rows: Integers,
    settings: GNSettings,
    entering: bool,
) -> bool:
    """Give the best candidates their steps on this level; the last one, all that it needs."""
    size = place[SIZE]
    if not size:
        place[PHASE] = EMPTY
        return False
    # A step costs derivatives and a look.
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
    """Have the candidates evaluated on the rows of the next level."""
    last = place[LEVEL] == level_rows.size - 1
    for i in range(place[SIZE]):
        done = c.stage[i] == DONE
        c.projects[i] = settings.projects and (settings.solved or not done or not last)
        if done:
            c.damping[i] = min(c.damping[i], ENTERING)
    look_again(c, place, level_rows, settings)


def look_again(
    c: GNCandidates, place: Integers, level_rows: Integers, settings: GNSettings
) -> None:
    """Have residuals and derivatives of the candidates evaluated where they are."""
    for i in range(place[SIZE]):
        c.loss[i] = c.predicted_gain[i] = math.inf
        c.stage[i], c.growth[i], c.secants[i] = ENTER, 2.0, 0
        copy(c.x[i], c.trial[i])
    place[ACTIVE] = place[SIZE]
    make_room(c, place, level_rows, settings)


def make_room(c: GNCandidates, place: Integers, level_rows: Integers, settings: GNSettings) -> None:
    """Have derivatives stored on this level, if there is room and they may be updated."""
    m, size = level_rows[place[LEVEL]], place[SIZE]
    stores = size * (c.x.shape[1] + 1) * m <= settings.room
    if settings.compiled and c.projects[:size].sum() == size:
        stores = False
    place[STORED] = m if stores else 0


def prune(
    c: GNCandidates,
    place: Integers,
    order: Integers,
    box: GNBox,
    level_rows: Integers,
    minima: Minima,
    settings: GNSettings,
) -> bool:
    """Go on, on more rows, with the candidates that may lead to a minimum that is not known."""
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
    # Copies of better ones end.
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


def sort_usable(c: GNCandidates, place: Integers, order: Integers) -> None:
    """Keep those with finite losses, the best first."""
    size = int(place[SIZE])
    usable = np.flatnonzero((c.stage[:size] != UNUSABLE) & np.isfinite(c.loss[:size]))
    order[: usable.size] = usable[np.argsort(c.loss[usable], kind="stable")]
    keep(c, place, order, usable.size)


def keep(c: GNCandidates, place: Integers, order: Integers, count: int) -> None:
    """Move the candidates at the first `count` positions of `order` to the front, so ordered."""
    for array in c[:4]:
        array[:count] = array[order[:count]]
    place[SIZE] = count
