"""State of a search by `MIHOQN`, and comparison of its candidates with known minima."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from miho.compiled.phases import CLOSED
from miho.optim.quasi_newton_candidates import LossRequest, QNBox, QNCandidates
from miho.optim.simplex import Simplex
from miho.optim.space import Space
from miho.optim.trace import Starts
from miho.quantities import Array

NEAR = 9.0
"""A candidate is at a known minimum within 3 standard deviations: its model predicts an increase of
the loss up to this, in units of d / rows of the loss."""
NEAR_LAST = 1e-4
"""The same on all rows, as a share of the loss."""
BASIN = 0.1
"""Largest distance from a known minimum, as a share of a width; models do not extend further."""
COPY, COPY_LOSS = 0.5, 0.05
"""A candidate is a copy of a better one if the loss increases by at most this between them, in
units of d / rows of the loss, and if their losses differ by at most this share."""


@dataclass
class MIHOQNState:
    """State of the search: phase and level of a bracket, its candidates, and the points they need.

    Attributes
    ----------
    batch : ndarray of shape (n, d)
        Points whose losses are needed, in search coordinates: of `requests`, or of a `simplex`
        around the only candidate.
    level_rows, level_costs : tuple
        Rows of each level, and the cost of an evaluation.
    minima, minima_losses : ndarray of shape (k, d) and (k,)
        Known minima in search coordinates, and their losses on all rows.
    best : float
        Smallest loss on all rows.
    stalled : list of QNCandidates
        Candidates that were set aside, one each.
    starts : Starts
        Starts of the run.
    rung_budget, spent, spent_before, allowance : float
        Budget of a rung; cost of all evaluations so far, before this bracket or its last phase; and
        limit of this phase.
    polished : bool
        Whether a simplex did not improve the last candidate.
    """

    space: Space
    box: QNBox
    rng: np.random.Generator
    level_rows: tuple[int, ...]
    level_costs: tuple[float, ...]
    candidates: QNCandidates
    minima: Array
    starts: Starts
    minima_losses: Array = field(default_factory=lambda: np.empty(0))
    batch: Array = field(default_factory=lambda: np.empty((0, 0)))
    requests: list[LossRequest] = field(default_factory=list)
    best: float = math.inf
    stalled: list[QNCandidates] = field(default_factory=list)
    simplex: Simplex | None = None
    polished: bool = False
    bracket: int = 0
    phase: int = CLOSED
    level: int = 0
    rung_budget: float = 0.0
    spent: float = 0.0
    spent_before: float = 0.0
    allowance: float = 0.0
    finished: bool = False

    @property
    def d(self) -> int:
        """Number of parameters."""
        return len(self.space)

    @property
    def cost(self) -> float:
        """Cost of one evaluation on this level."""
        return self.level_costs[self.level]

    @property
    def rows(self) -> int:
        """Number of rows of this level."""
        return self.level_rows[self.level]

    @property
    def last(self) -> bool:
        """Whether this level uses all rows."""
        return self.level == len(self.level_rows) - 1


def offsets_from(state: MIHOQNState, points: Array, z: Array) -> Array:
    """Offsets from points (k, d) to z (n, d), in shares of the widths, (n, k, d)."""
    return (z[:, None] - points) / state.box.width


def at_known(state: MIHOQNState, c: QNCandidates) -> NDArray[np.bool_]:
    """Whether candidates are at a known minimum, as far as the rows of the level show, (n,)."""
    if not state.minima_losses.size:
        return np.zeros(len(c), bool)
    offsets = offsets_from(state, state.minima, c.z)
    near = NEAR_LAST if state.last else NEAR * state.d / state.rows
    known = c.rise(slice(None), offsets) <= near * np.abs(c.loss[:, None])
    known &= np.abs(offsets).max(axis=2) < BASIN
    if state.last:
        higher = c.loss[:, None] - state.minima_losses
        known &= (higher >= 0) & (higher <= near * np.abs(c.loss[:, None]))
    return np.asarray(known.any(axis=1) & c.has_curvature)


def distinct(state: MIHOQNState, c: QNCandidates) -> NDArray[np.intp]:
    """Positions of the candidates, sorted by loss, without copies of better ones."""
    offsets = offsets_from(state, c.z, c.z)
    near = COPY * state.d / max(state.rows, 1) * np.abs(c.loss[:, None])
    copy = c.rise(slice(None), offsets) <= near
    copy &= np.abs(c.loss[:, None] - c.loss) <= COPY_LOSS * np.abs(c.loss[:, None])
    copy &= c.has_curvature[:, None]
    originals: list[int] = []
    for k in range(len(c)):
        if not copy[originals, k].any():
            originals.append(k)
    return np.array(originals)
