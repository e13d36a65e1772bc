"""Where a search of `MIHOGN` stands, and how its candidates compare with known minima."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from miho.compiled.gauss_newton_candidates import ENTER, UNUSABLE, GNBox, GNCandidates
from miho.optim.brackets import CLOSED
from miho.optim.space import Space
from miho.quantities import Array

BOUND = 1e-9
"""A parameter that is nearer to a bound than this share of its width is at it."""
ROOM = 1 << 22
"""Numbers that the derivatives of a rung may hold; beyond, each step pays for its own, and where
nothing is compiled for the residuals again."""


@dataclass
class MIHOGNState:
    """Where the search stands: a bracket's phase and level, and its `candidates`.

    `level_rows` (levels,): how many rows each level looks at, all of them on the last (0 as long as
    that is not known, after so many `attempts` to find out). `minima` (k, d): known minima in unit
    coordinates, with `minima_losses` (k,) on all rows, `minima_sums` (k, levels) of squares over
    each level's rows, and whether the data determine all parameters there, `determined` (k,). The
    best of them was found after `best_found_after` evaluations. `waiting` are candidates that wait
    while the best of their rung goes on, `stalled` those that made too little progress, one each.
    `rung_budget` is what a rung of the bracket may cost in evaluations, `spent_before` what the
    brackets before it have; `allowance` is what a revived candidate may spend, in rows.
    """

    space: Space
    box: GNBox
    rng: np.random.Generator
    level_rows: NDArray[np.int64]
    compiled: bool
    slope_cost: int
    candidates: GNCandidates
    minima: Array
    minima_losses: Array
    minima_sums: Array
    determined: NDArray[np.bool_]
    waiting: GNCandidates | None = None
    stalled: list[GNCandidates] = field(default_factory=list)
    bracket: int = 0
    projects: bool = False
    phase: int = CLOSED
    level: int = 0
    rung_budget: float = 0.0
    spent_before: float = 0.0
    allowance: int = 0
    best_found_after: float = 0.0
    attempts: int = 0
    finished: bool = False

    @property
    def d(self) -> int:
        """The number of parameters."""
        return len(self.space)

    @property
    def rows(self) -> int:
        """How many rows this level looks at."""
        return int(self.level_rows[self.level])

    @property
    def last(self) -> bool:
        """Whether that is all rows."""
        return self.level == self.level_rows.size - 1

    @property
    def linear(self) -> bool:
        """Whether the problem is linear in all parameters."""
        return not self.box.nonlinear.size

    @property
    def look_cost(self) -> float:
        """What one look on this level costs, in evaluations."""
        return self.rows / int(self.level_rows[-1]) * (1 + self.projects * self.box.linear.size)

    @property
    def step_cost(self) -> float:
        """What a step costs: derivatives and a look."""
        return self.look_cost + self.slope_cost * self.rows / int(self.level_rows[-1])

    @property
    def level_losses(self) -> Array:
        """The losses of the known minima over the rows of this level, (k,)."""
        return np.asarray(self.minima_sums[:, self.level] / self.rows)

    def add_minimum(self, c: GNCandidates) -> None:
        """Remember where the first candidate has ended as a known minimum."""
        loss = float(c.loss[0])
        sums = c.sums if c.sums[0, -1] > 0 else loss * self.level_rows[None]
        self.minima = np.vstack([self.minima, c.x])
        self.minima_losses = np.append(self.minima_losses, loss)
        self.minima_sums = np.vstack([self.minima_sums, sums])
        self.determined = np.append(self.determined, determines(c, self.box, self.rows))

    def begin(self, phase: int) -> None:
        """Begin a phase: steps and progress are counted from here."""
        c = self.candidates
        c.trials[:] = c.spent[:] = c.spent_at_mark[:] = 0
        c.loss_at_mark[:] = c.loss
        self.phase = phase

    def look_again(self) -> None:
        """Have residuals and derivatives of the candidates evaluated where they are."""
        c = self.candidates
        c.loss[:] = c.predicted_gain[:] = np.inf
        c.stage[:], c.growth[:], c.secants[:], c.trial[:] = ENTER, 2.0, 0, c.x
        self.make_room()

    def make_room(self) -> None:
        """Make room for the candidates' derivatives on this level, where they are to be stored."""
        c = self.candidates
        stores = c.loss.size * (self.d + 1) * self.rows <= ROOM
        stores &= not (self.compiled and c.projects.all())
        self.candidates = c.with_room_for(self.rows if stores else 0)


def box_of(space: Space, linear: tuple[str, ...]) -> GNBox:
    """The box of a space whose residuals are linear in these parameters."""
    low, high = space.bounds
    names = space.names
    return GNBox(
        space.low,
        space.high,
        low,
        high - low,
        np.array([p.scale == "log" for p in space.parameters]),
        np.array([names.index(name) for name in linear], dtype=np.int64),
        np.array([k for k, name in enumerate(names) if name not in linear], dtype=np.int64),
    )


def usable(c: GNCandidates) -> GNCandidates:
    """Those with finite losses, the best first."""
    order = np.argsort(c.loss, kind="stable")
    return c.take(order[(c.stage[order] != UNUSABLE) & np.isfinite(c.loss[order])])


def square_distances(c: GNCandidates, minima: Array, box: GNBox) -> Array:
    """|R (x - x*)|^2 from the first candidate to minima x* (k, d), (k,).

    That is the metric in which steps recognise a known minimum: by how much the residuals of the
    candidate's linear model change on the way there.
    """
    coordinates = box.nonlinear if c.projects[0] else np.arange(c.x.shape[1])
    R = c.R[0, : coordinates.size, : coordinates.size]
    return np.asarray((((c.x[0] - minima)[:, coordinates] @ R.T) ** 2).sum(axis=1))


def determines(c: GNCandidates, box: GNBox, m: int) -> bool:
    """Whether m rows of data determine each parameter where the first candidate is.

    They do if it is off the bounds, and its standard deviation, by the linear model there, is less
    than its range.
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
