"""Settings and state of a search by `MIHOGN`, and comparison of candidates with known minima."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.compiled.gauss_newton_candidates import (
    INSIDE,
    LEVEL,
    PHASE,
    SIZE,
    STORED,
    GNBox,
    GNCandidates,
    GNSettings,
    Minima,
    views,
)
from miho.compiled.kernel import Rows
from miho.compiled.phases import CLOSED, SCREEN
from miho.optim.brackets import DRAWS, Brackets, alike, check_brackets
from miho.optim.space import Space
from miho.quantities import Array, Integers
from miho.validate import one_of, positive_settings, whole, whole_settings

if TYPE_CHECKING:
    from miho.optim.periods import Period

ROOM = 1 << 22
"""Largest number of stored derivatives of a rung. Beyond it each step evaluates its derivatives
again, and the residuals too if they come from Python."""


@dataclass(frozen=True)
class MIHOGNSettings(Brackets):
    """Settings of `MIHOGN` and `AsynchronousMIHOGN`; see `MIHOGN`."""

    damping: float = 0.1
    scale_decay: float = 0.3
    max_secants: int = 4
    projection_period: int = 2
    draws: str = "turns"
    final_tolerance: float = 1e-16
    doubtful_brackets: int = 20
    doubtful_cost: float = 10.0
    challenges: int = 2
    max_brackets: int = 400

    def __post_init__(self) -> None:
        check_brackets(self)
        whole("doubtful_brackets", self.doubtful_brackets, 1)
        whole_settings(self, ("max_secants", "projection_period"), 0)
        whole("challenges", self.challenges, 1)
        one_of("draws", self.draws, DRAWS)
        positive_settings(self, ("damping", "scale_decay", "final_tolerance", "doubtful_cost"))
        if self.scale_decay > 1:
            raise ValueError(f"scale_decay is {self.scale_decay:g}; expected at most 1")

    def block_settings(
        self, rounding: float, slope_cost: int, compiled: bool, solved: bool = False
    ) -> GNSettings:
        """Settings of the machine before the first bracket."""
        return GNSettings(
            self.eta, self.steps_per_rung, self.leader_steps, float(self.max_step),
            self.max_secants, float(self.tolerance), float(self.level_tolerance),
            float(self.final_tolerance), float(self.patience),
            float(self.min_progress), rounding, slope_cost, compiled, projects=False, solved=solved,
            rung_budget=0.0, allowance=0, room=ROOM,
        )  # fmt: skip


class Blocks(NamedTuple):
    """Data shared by all compiled blocks of a search.

    `run` is the machine's loop for these rows; its next step may need `least` evaluations. The
    arrays take the improvements of one block, and `room` the work of steps.
    """

    rows: Rows
    run: Callable[..., int]
    least: float
    at: Integers
    losses: Array
    thetas: Array
    room: Array


class Scan(NamedTuple):
    """Loss and linear parameters at the points of a scan, and residuals at the next points."""

    solved: list[tuple[float, Array]]
    residuals: list[Array]


@dataclass
class MIHOGNState:
    """State of the search: the current bracket, and the known minima.

    Attributes
    ----------
    level_rows : ndarray of shape (levels,)
        Rows of each level, all rows on the last; 0 until known, after `attempts` to count them.
    candidates, place, order, stored
        Candidates of the bracket, its position (5,), and room for an order and for derivatives.
    stalled : list of GNCandidates
        Candidates that were set aside, one each.
    bracket, spent_before : int, float
        Number of the bracket, and evaluations before it.
    best_found_after : float
        Evaluations after which the best of `minima` was found.
    turn : int
        Position of the candidate that is evaluated next, if residuals come from Python.
    judged : int
        Number of the first minima that are known not to be zero up to rounding.
    passed, challenged, challenging : int, bool, bool
        Challenges that the best minimum has passed, whether the next bracket challenges it, and
        whether the current one does.
    tested, structured : float, bool
        Loss of the minimum whose residuals were tested, and whether they have structure.
    near, prepared : ndarray of shape (k, d) or None, (float, int)
        Starts of a challenge, unless they are drawn; loss and `passed` of the best minimum then.
    scan, periods : Scan, dict of Period
        A scan that is not complete, and the parameters of a period by position.
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
    near: Array | None = None
    prepared: tuple[float, int] = math.inf, 0
    scan: Scan = field(default_factory=lambda: Scan([], []))
    periods: dict[int, Period] = field(default_factory=dict)
    finished: bool = False
    blocks: Blocks | None = None

    def __getstate__(self) -> dict[str, Any]:
        """All fields but `blocks`, which has addresses of this process."""
        return vars(self) | {"blocks": None}

    @cached_property
    def alike(self) -> list[list[int]]:
        """Positions of nonlinear parameters whose values a challenge exchanges."""
        return alike(self.space, self.box.nonlinear)

    @property
    def best_minimum(self) -> int:
        """Position of the best known minimum."""
        return int(self.minima.loss.argmin())

    @property
    def d(self) -> int:
        """Number of parameters."""
        return self.box.low.size

    @property
    def phase(self) -> int:
        """Phase of the bracket."""
        return int(self.place[PHASE])

    @property
    def rows(self) -> int:
        """Number of rows of this level."""
        return int(self.level_rows[self.place[LEVEL]])

    @property
    def last(self) -> bool:
        """Whether this level uses all rows."""
        return bool(self.place[LEVEL] == self.level_rows.size - 1)

    @property
    def linear(self) -> bool:
        """Whether the problem is linear in all parameters."""
        return not self.box.nonlinear.size

    @property
    def with_derivatives(self) -> GNCandidates:
        """The candidates with their derivatives, which are in `stored`."""
        size, rows, n = int(self.place[SIZE]), int(self.place[STORED]), self.d + 1
        derivatives = self.stored[: size * n * rows].reshape((size, n, rows))
        return views(*self.candidates[:3], derivatives)

    @property
    def level_losses(self) -> Array:
        """Losses of the known minima over the rows of this level, (k,)."""
        return np.asarray(self.minima.sums[:, self.place[LEVEL]] / self.rows)

    def theta(self, x: Array) -> Array:
        """Parameters in units (d,) at unit coordinates x (d,)."""
        return np.asarray(self.space.decode((self.box.origin + self.box.width * x)[None])[0])

    def close(self) -> None:
        """Mark the bracket as closed."""
        self.place[PHASE] = CLOSED

    def admit(self, c: GNCandidates, level: int) -> None:
        """Set the candidates, of a new bracket or a single one, on this level."""
        n, d = c.x.shape
        self.candidates, self.order = c, np.empty(n, np.int64)
        self.place[:] = SCREEN, level, n, n, 0
        levels, settings = tuple(self.level_rows[level:].tolist()), self.settings
        numbers = room_for_derivatives(levels, n, d, settings.eta, settings.room)
        if self.stored.size < numbers:
            self.stored = np.zeros(numbers)

    def learn(self, other: MIHOGNState) -> None:
        """Take over the minima of another bracket, and the knowledge of the best one.

        If its best minimum is a different one, this bracket no longer challenges it.
        """
        self.challenging &= self.best_found_after == other.best_found_after
        self.minima, self.best_found_after = other.minima, other.best_found_after
        self.passed, self.challenged = other.passed, other.challenged
        self.tested, self.structured = other.tested, other.structured
        self.near, self.prepared = other.near, other.prepared

    def add_minimum(self, c: GNCandidates) -> None:
        """Add the end of the first candidate to the known minima."""
        loss, minima = float(c.loss[0]), self.minima
        sums = c.sums[:1] if c.sums[0, -1] > 0 else loss * self.level_rows[None]
        minimum = c.x[:1], [loss], sums, [determines(c, self.box, self.rows)]
        self.minima = Minima(*map(np.concatenate, zip(minima, minimum, strict=True)))


@lru_cache(maxsize=256)
def room_for_derivatives(levels: tuple[int, ...], n: int, d: int, eta: int, most: int) -> int:
    """Numbers to store derivatives of n candidates, and of their survivors, on these levels.

    At most `most`; 0 on a level where one candidate needs more.
    """
    numbers = 0
    for rows in levels:
        if (d + 1) * rows <= most:
            numbers = max(numbers, min(n * (d + 1) * rows, most))
        n = max(1, n // eta)
    return numbers


def box_of(space: Space, linear: tuple[str, ...]) -> GNBox:
    """Box of a space whose residuals are linear in these parameters."""
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

    Steps recognise a known minimum in this metric: the change of the residuals in the linear model
    of the candidate.
    """
    apart, R = c.x[0] - minima, c.R[0]
    if c.projects[0]:
        n = box.nonlinear.size
        apart, R = apart[:, box.nonlinear], R[:n, :n]
    return np.asarray(np.add.reduce((apart @ R.T) ** 2, axis=1))


def at_bound(x: Array) -> bool:
    """Whether a configuration (d,) in unit coordinates is at a bound, where steps fix it.

    In bounds a billion times as wide as the answer, the tolerance is a billionth of the width.
    """
    return bool((x <= INSIDE).any() or (x >= 1 - INSIDE).any())


def determines(c: GNCandidates, box: GNBox, m: int) -> bool:
    """Whether m rows of data determine each parameter at the first candidate.

    They do if it is off the bounds, and if its standard deviation in the linear model is less than
    its range.
    """
    if at_bound(c.x[0]):
        return False
    n = box.nonlinear.size if c.projects[0] else box.low.size
    R = c.R[0, :n, :n]
    if not np.diag(R).all():
        return False
    deviation = math.sqrt(c.loss[0] * m / max(m - n, 1))
    with np.errstate(over="ignore", invalid="ignore"):  # NaN and infinity compare as false
        rows = np.linalg.inv(R)
        return bool((np.sqrt(np.add.reduce(rows * rows, axis=1)) * deviation <= 1).all())
