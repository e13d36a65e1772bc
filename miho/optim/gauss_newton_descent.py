"""One Gauss-Newton descent from a start, on the machine."""

from __future__ import annotations

import math

import numpy as np

from miho.compiled.gauss_newton_candidates import GNCandidates, Minima
from miho.compiled.kernel import Rows
from miho.compiled.phases import (
    CHUNK,
    PAUSED,
    POLISH,
    SCREEN,
    begin,
    bracket_of,
    make_room,
    room_for,
)
from miho.optim.miho_gn_state import MIHOGNSettings, box_of
from miho.optim.space import Space
from miho.quantities import Array

LOOKS = 100
"""Evaluations of all rows between two checks for Ctrl-C, at least the cost of one Jacobian."""


def descended(rows: Rows, space: Space, start: Array) -> Array:
    """End of a descent from `start` (d,), by the steps of `MIHOGN` on all rows.

    Returns the start if its residuals are not finite.
    """
    method, box, d, N = MIHOGNSettings(), box_of(space, ()), len(space), rows.y.size
    levels, place = np.array([N]), np.array([SCREEN, 0, 1, 1, 0])
    x = (space.encode(space.clip(start)) - box.origin) / box.width
    c = GNCandidates.at(np.clip(x, 0.0, 1.0)[None], 1, method.damping, method.scale_decay, False)
    settings = method.block_settings(0.0, d, compiled=True)
    make_room(c, place, levels, settings)
    begin(c, place, POLISH, 1)
    minima = Minima(np.empty((0, d)), np.empty(0), np.empty((0, 1)), np.empty(0, bool))
    stored, room = np.zeros((d + 1) * int(place[-1])), np.empty(room_for(d, max(CHUNK, N), 1))
    at, losses, thetas = np.empty(LOOKS, np.int64), np.empty(LOOKS), np.empty((LOOKS, d))
    run, best, ended, end = bracket_of(rows), math.inf, PAUSED, start
    while ended == PAUSED:
        tally = np.zeros(5, np.int64)
        ended = run(
            *c[:3], stored, place, np.empty(1, np.int64), box, levels, minima, settings,
            max(LOOKS, d) * N, best, -math.inf, at, losses, thetas, tally, room,
        )  # fmt: skip
        if tally[1]:
            best, end = float(losses[tally[1] - 1]), thetas[tally[1] - 1].copy()
    return end
