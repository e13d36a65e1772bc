"""Phases of a bracket, and the loop of the machine that runs them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from miho.compiled.gauss_newton_candidates import (
    ACTIVE,
    ENTER,
    LEVEL,
    PHASE,
    SIZE,
    STORED,
    GNCandidates,
    GNSettings,
)
from miho.compiled.kernel import Rows
from miho.core import machine
from miho.quantities import Integers

SCREEN, RUNG, LEAD, FINISH, REVIVE, POLISH, CLOSED, EMPTY, RETURNED, SOLVED = range(10)
"""First evaluations of the starts; steps of a rung; more steps of its best; the last candidate to
its end on all rows; a stalled candidate of an earlier bracket; the final descent from the best. The
others are ends: no bracket; no candidate left; no candidate leads to a new optimum; a problem that
is linear in all parameters is solved."""
UNLIMITED = 1 << 40
"""Steps of a candidate that continues as long as it makes progress."""
FINISHED, PAUSED, REACHED = range(3)
"""End of a block of steps: no candidate needs anything; the next evaluation would exceed the
allowed rows, or Ctrl-C; or the target is reached."""
NEAR, NEAR_LAST = 9.0, 0.1
"""A candidate is at a known minimum within this squared distance, in shares of its sum of squares
and units of d / rows; the first value is 3 standard deviations. On all rows it is at most the
second value, a share alone."""
BETTER = 4.0
"""But not if its loss is lower by more than this number of d / rows, which fewer rows may
explain."""
ENTERING = 1e-3
"""Largest damping at the start of a level, for a candidate that was done on the previous one."""
CHUNK = 512
"""Rows per chunk; their derivatives stay in the first-level cache."""


def nearness(d: int, m: int, last: bool) -> tuple[float, float]:
    """Tolerances on m rows for a candidate at a known minimum.

    They are the largest squared distance, and the share by which its loss must not be lower.
    """
    share = d / m
    if last:
        return min(NEAR * share, NEAR_LAST), 0.0
    return NEAR * share, BETTER * share


def begin(c: GNCandidates, place: Integers, phase: int, active: int) -> None:
    """Begin a phase; steps and progress are counted from here."""
    place[PHASE], place[ACTIVE] = phase, active
    c.trials[:active] = c.spent[:active] = c.spent_at_mark[:active] = 0
    c.loss_at_mark[:active] = c.loss[:active]


def look_again(
    c: GNCandidates, place: Integers, level_rows: Integers, settings: GNSettings
) -> None:
    """Mark the candidates for an evaluation of residuals and derivatives at the same place."""
    size = place[SIZE]
    c.loss[:size] = c.predicted_gain[:size] = math.inf
    c.stage[:size], c.growth[:size], c.secants[:size] = ENTER, 2.0, 0
    c.trial[:size] = c.x[:size]
    place[ACTIVE] = size
    make_room(c, place, level_rows, settings)


def make_room(c: GNCandidates, place: Integers, level_rows: Integers, settings: GNSettings) -> None:
    """Store derivatives on this level, if there is room and they may be updated."""
    m, size = level_rows[place[LEVEL]], place[SIZE]
    stores = size * (c.x.shape[1] + 1) * m <= settings.room
    if settings.compiled and c.projects[:size].sum() == size:
        stores = False
    place[STORED] = m if stores else 0


def room_for(d: int, m: int, levels: int) -> int:
    """Number of elements that the machine's work arrays need, with columns up to eights."""
    return levels + (d + 1) * (d + 1) + (2 * d + 1) * CHUNK + m + 7 * d + (d + 1) * (3 * d + 8) + 7


def bracket_of(rows: Rows) -> Callable[..., int]:
    """Machine loop that runs a bracket on these rows to its end, and returns how it ended.

    Its arguments are the arrays of `GNCandidates`, with the derivatives in the next array; `place`
    and `order`; box, rows of each level, minima and settings; the largest number of rows to use,
    the best loss so far, and a target; then output arrays. Each improvement is listed: the rows
    used up to and including it (`at`), its loss and its theta; reaching the target ends the block.
    `tally` (5,) is increased by the rows used, the improvements, the losses that are NaN or
    infinite, and the derivatives that are not finite. `room` has
    the size `room_for`.
    """
    return partial(machine().run_bracket, rows.calls, rows.tapes, rows.X, rows.y)
