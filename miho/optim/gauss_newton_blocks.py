"""Brackets of Gauss-Newton descents on the machine, in blocks of evaluations."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from miho.compiled import Block
from miho.compiled.kernel import INFINITE, NAN, Rows
from miho.compiled.phases import CHUNK, FINISHED, bracket_of, room_for
from miho.optim.miho_gn_state import Blocks, MIHOGNState
from miho.optim.oracle import Oracle

REASONS = NAN, INFINITE, "derivative is not finite"
"""Reasons for rejected values, in the order of the counts of a block."""
EVENTS = 1024
"""Evaluations of all rows in one block, at most; each may be an improvement, which needs room."""


def run_phases(oracle: Oracle, state: MIHOGNState) -> None:
    """Run a bracket to its end, on the machine if possible; continues an interrupted bracket.

    Raises as the oracle does at the end of the budget.
    """
    # Without the machine, the problem makes each evaluation.
    kernel = oracle.traits.kernel
    rows = None if kernel is None else kernel.rows
    if rows is None:
        from miho.optim.gauss_newton_steps import rounds

        for _ in rounds(oracle, state):
            pass
        return
    if state.blocks is None or state.blocks.rows is not rows:
        state.blocks = blocks_on(rows, state)
    oracle.spend(partial(_block, state, state.blocks), state.blocks.least)


def _block(state: MIHOGNState, blocks: Blocks, most: float, best: float, target: float) -> Block:
    """Run at most this number of evaluations, which the oracle limits and records."""
    c, N, least = state.candidates, blocks.rows.y.size, blocks.least
    limit = round(min(most, max(EVENTS, least)) * N)  # a whole number of rows, up to rounding
    tally = np.zeros(5, np.int64)
    ended = blocks.run(
        *c[:3], state.stored, state.place, state.order, state.box,
        state.level_rows, state.minima, state.settings, limit, best, target,
        blocks.at, blocks.losses, blocks.thetas, tally, blocks.room,
    )  # fmt: skip
    spent, k, *unusable = tally.tolist()
    rejected = dict(zip(REASONS, unusable, strict=True))
    looked_at = None
    if best == math.inf and not k:
        thetas = state.space.decode(state.box.origin + state.box.width * c.x)
        looked_at = state.rows / N, c.loss, thetas
    at, losses, thetas = blocks.at[:k] / N, blocks.losses[:k], blocks.thetas[:k]
    return Block(spent / N, at, losses, thetas, rejected, ended == FINISHED, looked_at)


def blocks_on(rows: Rows, state: MIHOGNState) -> Blocks:
    """Data shared by all blocks of a search on these rows."""
    d, levels, slope_cost = state.d, state.level_rows, state.settings.slope_cost
    stored = [m for m in levels.tolist() if (d + 1) * m <= state.settings.room]
    room = np.empty(room_for(d, max([CHUNK, *stored]), levels.size))
    least = float(max(state.box.linear.size + 1, slope_cost))
    at, losses, thetas = np.empty(EVENTS, np.int64), np.empty(EVENTS), np.empty((EVENTS, d))
    return Blocks(rows, bracket_of(rows), least, at, losses, thetas, room)
