"""Where a search of `MIHOGN` stands, and how its candidates compare with known minima."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.compiled.gauss_newton import INSIDE
from miho.compiled.gauss_newton_candidates import (
    LEVEL,
    PHASE,
    GNBox,
    GNCandidates,
    GNSettings,
    Minima,
)
from miho.compiled.kernel import Rows
from miho.compiled.phases import CLOSED, SCREEN
from miho.optim.space import Space
from miho.quantities import Array, Integers


class Blocks(NamedTuple):
    """What all compiled blocks of a search have in common.

    `run` is that of these rows, and may need `least` evaluations for its next step. There is room
    for the improvements of one block, and for steps to be worked out in.
    """

    rows: Rows
    run: Callable[..., int]
    least: float
    at: Integers
    losses: Array
    thetas: Array
    room: Array


@dataclass
class MIHOGNState:
    """Where the search stands: its bracket, and the known minima.

    `place` (5,) is where the bracket stands, `settings` how it goes on, `order` (n,) and `stored`
    room for the positions of its `candidates` and for their derivatives. `level_rows` (levels,):
    how many rows each level looks at, all of them on the last (0 as long as that is not known,
    after so many `attempts` to find out). Where residuals come from Python candidates are evaluated
    in turn, now the one at position `turn`. The best of the `minima` was found after
    `best_found_after` evaluations. `stalled` are candidates that made too little progress, one
    each; before the bracket, `spent_before` evaluations were spent. The first `judged` minima are
    known not to be zero to rounding. The best minimum has `passed` so many challenges; it is
    `challenged` by the next bracket, or the one under way is `challenging`. Whether residuals are
    `structured` is known of the minimum whose loss is `tested`.
    """

    space: Space
    box: GNBox
    rng: np.random.Generator
    level_rows: NDArray[np.int64]
    settings: GNSettings
    candidates: GNCandidates
    minima: Minima
    place: NDArray[np.int64]
    order: NDArray[np.int64]
    stored: Array
    stalled: list[GNCandidates] = field(default_factory=list)
    bracket: int = 0
    spent_before: float = 0.0
    best_found_after: float = 0.0
    attempts: int = 0
    turn: int = 0
    judged: int = 0
    passed: int = 0
    challenged: bool = False
    challenging: bool = False
    tested: float = math.inf
    structured: bool = False
    finished: bool = False
    blocks: Blocks | None = None

    def __getstate__(self) -> dict[str, Any]:
        """All but its blocks, which hold addresses of this process."""
        return vars(self) | {"blocks": None}

    @property
    def best_minimum(self) -> int:
        """The position of the best known minimum."""
        return int(np.argmin(self.minima.loss))

    @property
    def d(self) -> int:
        """The number of parameters."""
        return len(self.space)

    @property
    def phase(self) -> int:
        """The bracket's phase."""
        return int(self.place[PHASE])

    @property
    def rows(self) -> int:
        """How many rows this level looks at."""
        return int(self.level_rows[self.place[LEVEL]])

    @property
    def last(self) -> bool:
        """Whether that is all rows."""
        return bool(self.place[LEVEL] == self.level_rows.size - 1)

    @property
    def linear(self) -> bool:
        """Whether the problem is linear in all parameters."""
        return not self.box.nonlinear.size

    @property
    def level_losses(self) -> Array:
        """The losses of the known minima over the rows of this level, (k,)."""
        return np.asarray(self.minima.sums[:, self.place[LEVEL]] / self.rows)

    def theta(self, x: Array) -> Array:
        """The parameters in units (d,) at a place x (d,) of the box."""
        return np.asarray(self.space.decode((self.box.origin + self.box.width * x)[None])[0])

    def close(self) -> None:
        """Have no bracket, until the next is drawn."""
        self.place[PHASE] = CLOSED

    def admit(self, c: GNCandidates, level: int) -> None:
        """Have candidates of a new bracket, or one that goes on alone, on this level."""
        n, d = c.x.shape
        self.candidates, self.order = c, np.empty(n, np.int64)
        self.place[:] = SCREEN, level, n, n, 0
        levels, settings = tuple(self.level_rows[level:].tolist()), self.settings
        numbers = room_for_derivatives(levels, n, d, settings.eta, settings.room)
        if self.stored.size < numbers:
            self.stored = np.zeros(numbers)

    def learn(self, other: MIHOGNState) -> None:
        """Know the minima that another bracket knows, and what is known of the best one.

        Where that is another one than this bracket has known, it is none that this one challenges.
        """
        self.challenging &= self.best_found_after == other.best_found_after
        self.minima, self.best_found_after = other.minima, other.best_found_after
        self.passed, self.challenged = other.passed, other.challenged
        self.tested, self.structured = other.tested, other.structured

    def add_minimum(self, c: GNCandidates) -> None:
        """Remember where the first candidate has ended as a known minimum."""
        loss, known = float(c.loss[0]), self.minima
        sums = c.sums[:1] if c.sums[0, -1] > 0 else loss * self.level_rows[None]
        new = c.x[:1], [loss], sums, [determines(c, self.box, self.rows)]
        self.minima = Minima(*map(np.concatenate, zip(known, new, strict=True)))


@lru_cache(maxsize=256)
def room_for_derivatives(levels: tuple[int, ...], n: int, d: int, eta: int, most: int) -> int:
    """How many numbers derivatives of n candidates, and of those that go on, have on these levels.

    That is up to `most`, and none on a level where those of one candidate are more.
    """
    numbers = 0
    for rows in levels:
        if (d + 1) * rows <= most:
            numbers = max(numbers, min(n * (d + 1) * rows, most))
        n = max(1, n // eta)
    return numbers


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


def square_distances(c: GNCandidates, minima: Array, box: GNBox) -> Array:
    """|R (x - x*)|^2 from the first candidate to minima x* (k, d), (k,).

    That is the metric in which steps recognise a known minimum: by how much the residuals of the
    candidate's linear model change on the way there.
    """
    apart, R = c.x[0] - minima, c.R[0]
    if c.projects[0]:
        n = box.nonlinear.size
        apart, R = apart[:, box.nonlinear], R[:n, :n]
    return np.asarray(np.add.reduce((apart @ R.T) ** 2, axis=1))


def at_bound(x: Array) -> bool:
    """Whether a configuration (d,) in shares of the widths is at a bound, where steps hold it.

    In a box of a billion times the answer, that is a billionth of the width from a bound.
    """
    return bool((x <= INSIDE).any() or (x >= 1 - INSIDE).any())


def determines(c: GNCandidates, box: GNBox, m: int) -> bool:
    """Whether m rows of data determine each parameter where the first candidate is.

    They do if it is off the bounds, and its standard deviation, by the linear model there, is less
    than its range.
    """
    if at_bound(c.x[0]):
        return False
    n = box.nonlinear.size if c.projects[0] else box.low.size
    R = c.R[0, :n, :n]
    if not np.diag(R).all():
        return False
    deviation = math.sqrt(c.loss[0] * m / max(m - n, 1))
    with np.errstate(over="ignore", invalid="ignore"):  # NaN and infinity are no such deviations
        return bool((np.linalg.norm(np.linalg.inv(R), axis=1) * deviation <= 1).all())
