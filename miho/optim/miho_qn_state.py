"""Where a search of `MIHOQN` stands, and how its candidates compare with known minima."""

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
"""A candidate is at a known minimum within 3 standard deviations: where by its model the loss rises
by no more than this on the way, in units of d / rows of the loss."""
NEAR_LAST = 1e-4
"""The same on all rows, as a share of the loss."""
BASIN = 0.1
"""But no further from it than this share of a width: its model does not reach further."""
COPY, COPY_LOSS = 0.5, 0.05
"""A candidate is a copy of a better one where the loss rises by no more than this on the way, in
units of d / rows of the loss, and their losses differ by no more than this share."""


@dataclass
class MIHOQNState:
    """Where the search stands: a bracket's phase and level, its `candidates`, and what they need.

    They need the losses of `batch` (n, d) in search coordinates, which are those of their
    `requests`, or of a `simplex` around the only one. `level_rows` (levels,): how many rows each
    level looks at; `level_costs` (levels,): what an evaluation costs there. `minima` (k, d): known
    minima in search coordinates, with `minima_losses` (k,) on all rows; `best`: the least loss on
    all rows so far. `stalled` are candidates that made too little progress, one each. `starts` are
    those of the run, or the state's own where there is no run. `rung_budget` is what a rung of the
    bracket may cost, `spent` what all evaluations have cost, `spent_before` what they had before
    this bracket, or before its last phase, which may cost `allowance`. `polished`: a simplex did
    not bring the last candidate further.
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
        """The number of parameters."""
        return len(self.space)

    @property
    def cost(self) -> float:
        """What one evaluation costs on this level."""
        return self.level_costs[self.level]

    @property
    def rows(self) -> int:
        """How many rows this level looks at."""
        return self.level_rows[self.level]

    @property
    def last(self) -> bool:
        """Whether that is all rows."""
        return self.level == len(self.level_rows) - 1


def offsets_from(state: MIHOQNState, points: Array, z: Array) -> Array:
    """Offsets from points (k, d) to z (n, d), in shares of the widths, (n, k, d)."""
    return (z[:, None] - points) / state.box.width


def at_known(state: MIHOQNState, c: QNCandidates) -> NDArray[np.bool_]:
    """Which candidates are at a known minimum, as far as the level's rows can tell, (n,)."""
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
    """Positions of the candidates, sorted by loss, that are no copies of better ones."""
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
