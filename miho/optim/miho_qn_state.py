"""Where a search of `MIHOQN` stands, and what its configurations tell of each other."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from miho.optim.candidates import Box, Candidates, Request
from miho.optim.simplex import Simplex
from miho.optim.space import Space
from miho.optim.trace import Starts
from miho.quantities import Array

SCREEN, CLIMB, LEAD, FINISH, SHARE, OVER = range(6)
"""Phases of a bracket: first looks, steps of a rung and more of its best, the last one on all rows,
one that was set aside, and the end."""
NEAR = 9.0
"""At a known minimum within 3 standard deviations: squared, in units of d / rows of the loss."""
NEAR_LAST = 1e-4
"""And on all rows, in units of the loss."""
BASIN = 0.1
"""But no further from it than this share of a width: further away models say nothing."""
COPY, COPY_LOSS = 0.5, 0.05
"""A near copy of a better one: within this many d / rows of its loss, which differs by less."""


@dataclass
class MIHOQNState:
    """Where the search stands: a bracket's phase and level, and the `batch` (n, d) in search
    coordinates whose losses it needs, as `requests` of the `live` configurations or a `simplex`.

    `ends` are the rows of the levels, `costs` what one look at each costs. `minima` (k, d) in
    search coordinates are those known, with `losses` (k,) on all rows. `aside` are configurations
    that crawl, one each. `starts` are the run's, or the state's own where there is no run; `best`
    is the least loss on all rows. `size` is what a rung of the bracket may cost, `spent` what all
    evaluations have cost, `begun` what those had before this bracket or its last phase, which may
    cost `share`. The last one of a bracket is `polished` where a simplex brings it no further.
    """

    space: Space
    box: Box
    rng: np.random.Generator
    ends: tuple[int, ...]
    costs: tuple[float, ...]
    live: Candidates
    minima: Array
    starts: Starts
    losses: Array = field(default_factory=lambda: np.empty(0))
    batch: Array = field(default_factory=lambda: np.empty((0, 0)))
    requests: list[Request] = field(default_factory=list)
    best: float = math.inf
    aside: list[Candidates] = field(default_factory=list)
    simplex: Simplex | None = None
    polished: bool = False
    bracket: int = 0
    phase: int = OVER
    level: int = 0
    size: float = 0.0
    spent: float = 0.0
    begun: float = 0.0
    share: float = 0.0
    over: bool = False

    @property
    def d(self) -> int:
        """The number of parameters."""
        return len(self.space)

    @property
    def cost(self) -> float:
        """What one evaluation costs on this level."""
        return self.costs[self.level]

    @property
    def rows(self) -> int:
        """How many rows this level looks at."""
        return self.ends[self.level]

    @property
    def last(self) -> bool:
        """Whether that is all rows."""
        return self.level == len(self.ends) - 1


def away_from(state: MIHOQNState, z: Array, others: Array) -> Array:
    """From others (k, d) to z (n, d), in shares of the widths, (n, k, d)."""
    return (z[:, None] - others) / state.box.width


def at_known(state: MIHOQNState, c: Candidates) -> NDArray[np.bool_]:
    """Which configurations are at a known minimum, as far as these rows can tell."""
    if not state.losses.size:
        return np.zeros(len(c), bool)
    away = away_from(state, c.z, state.minima)
    near = NEAR_LAST if state.last else NEAR * state.d / state.rows
    at = c.above(slice(None), away) <= near * np.abs(c.loss[:, None])
    at &= np.abs(away).max(axis=2) < BASIN
    if state.last:
        higher = c.loss[:, None] - state.losses
        at &= (higher >= 0) & (higher <= near * np.abs(c.loss[:, None]))
    return np.asarray(at.any(axis=1) & c.curved)


def distinct(state: MIHOQNState, c: Candidates) -> NDArray[np.intp]:
    """Those that are no near copies of better ones."""
    away = away_from(state, c.z, c.z)
    near = COPY * state.d / max(state.rows, 1) * np.abs(c.loss[:, None])
    copy = c.above(slice(None), away) <= near
    copy &= np.abs(c.loss[:, None] - c.loss) <= COPY_LOSS * np.abs(c.loss[:, None])
    copy &= c.curved[:, None]
    kept: list[int] = []
    for k in range(len(c)):
        if not copy[kept, k].any():
            kept.append(k)
    return np.array(kept)
