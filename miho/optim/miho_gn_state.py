"""Where a search of `MIHOGN` stands, and what its configurations tell of each other."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from miho.compiled.gauss_newton_state import UNUSABLE, Box, Candidates
from miho.optim.space import Space
from miho.quantities import Array

SCREEN, CLIMB, LEAD, FINISH, SHARE, POLISH, OVER = range(7)
"""Phases of a bracket: first looks, steps of a rung and more of its best, the last one on all rows,
one that was set aside before; more digits for the best of all; and the end."""
BOUND = 1e-9
"""A share of a width: nearer, a parameter is at its bound."""


@dataclass
class MIHOGNState:
    """Where the search stands: a bracket's phase and level, and its `live` configurations.

    `ends` are the rows of the levels, all of them last (0 as long as nobody said how many).
    `minima` (k, d) in unit coordinates are those known, with their sums of squares over the rows
    of each level, `sums` (k, levels); `sound` (k,) where the data determine all parameters there.
    `found` is what was spent when the best of them was.
    `rest` waits for the best of its rung, `aside` are configurations that crawl, one each. `size`
    is what a rung of the bracket may cost, `begun` what was spent before it, `share` the rows that
    one set aside may have.
    """

    space: Space
    box: Box
    rng: np.random.Generator
    ends: NDArray[np.int64]
    compiled: bool
    slope_cost: int
    live: Candidates
    minima: Array
    losses: Array
    sums: Array
    sound: NDArray[np.bool_]
    rest: Candidates | None = None
    aside: list[Candidates] = field(default_factory=list)
    bracket: int = 0
    projects: bool = False
    phase: int = OVER
    level: int = 0
    size: float = 0.0
    begun: float = 0.0
    share: int = 0
    found: float = 0.0
    tried: int = 0
    over: bool = False

    @property
    def d(self) -> int:
        """The number of parameters."""
        return len(self.space)

    @property
    def rows(self) -> int:
        """How many rows this level looks at."""
        return int(self.ends[self.level])

    @property
    def last(self) -> bool:
        """Whether that is all rows."""
        return self.level == self.ends.size - 1

    @property
    def linear(self) -> bool:
        """Whether the problem is linear in all parameters."""
        return not self.box.nonlinear.size

    @property
    def look_cost(self) -> float:
        """What one look on this level costs, in evaluations."""
        return self.rows / int(self.ends[-1]) * (1 + self.projects * self.box.linear.size)

    @property
    def step_cost(self) -> float:
        """What a step costs: derivatives and a look."""
        return self.look_cost + self.slope_cost * self.rows / int(self.ends[-1])

    @property
    def level_losses(self) -> Array:
        """The losses of the known minima over the rows of this level, (k,)."""
        return np.asarray(self.sums[:, self.level] / self.rows)


def box_of(space: Space, linear: tuple[str, ...]) -> Box:
    """The box of a space whose residuals are linear in these parameters."""
    low, high = space.bounds
    names = space.names
    return Box(
        space.low,
        space.high,
        low,
        high - low,
        np.array([p.scale == "log" for p in space.parameters]),
        np.array([names.index(name) for name in linear], dtype=np.int64),
        np.array([k for k, name in enumerate(names) if name not in linear], dtype=np.int64),
    )


def usable(c: Candidates) -> Candidates:
    """Those with finite losses, the best first."""
    order = np.argsort(c.loss, kind="stable")
    return c.take(order[(c.stage[order] != UNUSABLE) & np.isfinite(c.loss[order])])


def square_distances(c: Candidates, minima: Array, box: Box) -> Array:
    """From the first configuration to minima (k, d), in the metric by which steps know them, (k,).

    |R (x - x*)|^2: what the linear model where it is says of the way there.
    """
    which = box.nonlinear if c.projects[0] else np.arange(c.x.shape[1])
    R = c.R[0, : which.size, : which.size]
    return np.asarray((((c.x[0] - minima)[:, which] @ R.T) ** 2).sum(axis=1))


def sound(c: Candidates, box: Box, m: int) -> bool:
    """Whether the data determine each parameter within its range, off the bounds.

    Its standard deviation, by the factor of the derivatives there, is less than the range.
    """
    if (c.x < BOUND).any() or (c.x > 1 - BOUND).any():
        return False
    n = box.nonlinear.size if c.projects[0] else box.low.size
    R = c.R[0, :n, :n]
    if not np.diag(R).all():
        return False
    deviation = math.sqrt(c.loss[0] * m / max(m - n, 1))
    with np.errstate(over="ignore", invalid="ignore"):  # NaN and infinity are no such deviations
        return bool((np.linalg.norm(np.linalg.inv(R), axis=1) * deviation <= 1).all())
