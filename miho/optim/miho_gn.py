"""Hyperband over Gauss-Newton steps on growing data."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from miho.optim.gauss_newton import (
    DONE, ENTER, KNOWN, READY, SLOPES, UNUSABLE, Box, Candidates, Known, Rules,
    descend, distinct,
)  # fmt: skip
from miho.optim.evidence import in_optimum
from miho.optim.optimizer import Resumable
from miho.optim.oracle import Oracle, UnusableValueError
from miho.optim.space import Parameter, Space
from miho.optim.validate import positive, whole

Array = NDArray[np.float64]

SCREEN, CLIMB, LEAD, FINISH, SHARE, OVER = "screen", "climb", "lead", "finish", "share", "over"
DECADES = 3
APART = 1.1
ROOM = 1 << 22
"""Numbers that the derivatives of a rung may take; beyond, Broyden's update is left out."""


@dataclass
class MIHOGNState:
    space: Space
    rng: np.random.Generator
    box: Box
    ends: NDArray[np.int64]
    cost: float
    slope_cost: int
    compiled: bool
    bracket: int = 0
    size: float = 0.0
    projects: bool = False
    phase: str = OVER
    level: int = 0
    begun: float = 0.0
    alive: Candidates | None = None
    rest: Candidates | None = None
    minima: Known = field(default_factory=lambda: Known(np.empty((0, 0)), np.empty(0)))
    sums: Array = field(default_factory=lambda: np.empty((0, 0)))
    sound: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, bool))
    rounding: float = 0.0
    aside: list[Candidates] = field(default_factory=list)
    least: float = math.inf
    over: bool = False
    asked: int = 0


@dataclass(frozen=True)
class MIHOGN(Resumable[MIHOGNState]):
    eta: int = 3
    rows: float = 4.0
    base: float = 0.5
    largest: float = 32.0
    steps: int = 3
    lead: int = 20
    least: int = 3
    most: int = 243
    damping: float = 0.1
    reach: float = 0.25
    jump: float = 0.5
    enough: float = 200.0
    level_tolerance: float = 0.1
    tolerance: float = 1e-8
    patience: int = 4
    progress: float = 0.05
    brackets: int = 200
    doubtful: int = 20
    draws: str = "space"
    project: str = "even"

    def start(self, oracle: Oracle, rng: np.random.Generator) -> MIHOGNState:
        space, d = oracle.space, len(oracle.space)
        box = Box.of(space, oracle.linear)
        return MIHOGNState(space, rng, box, self._levels(oracle, d, box), 1.0, oracle.jacobian_cost, oracle.compiled_rows is not None, rounding=oracle.meter.starts.rounding,
                           minima=Known(np.empty((0, d)), np.empty(0)))

    def _levels(self, oracle: Oracle, d: int, box: Box) -> NDArray[np.int64]:
        """Rows of each level, the last one all."""
        N = oracle.rows
        if N is None:
            return np.array([0])
        if not box.nonlinear.size:
            return np.unique([max(math.ceil(N / 9), min(N, d + 1)), N])
        m = min(N, max(1, math.ceil(self.rows * d)))
        if oracle.cost(m / N) >= 1:
            return np.array([N])
        ends = [m]
        while ends[-1] < N:
            further = self.eta * ends[-1]
            ends.append(N if further > self.jump * N or ends[-1] > self.enough * d else further)
        return np.array(ends)

    def done(self, state: MIHOGNState) -> bool:
        return state.over

    def step(self, state: MIHOGNState, oracle: Oracle) -> None:
        if not state.ends[-1]:
            self._count_rows(state, oracle)
            return
        if state.phase == OVER:
            self._draw(state, oracle)
        c = state.alive
        assert c is not None
        descend(oracle, c, state.box, state.ends, self._sound_minima(state), self._rules(state, oracle),
                state.slope_cost)
        getattr(self, "_after_" + state.phase)(state, oracle)

    def _count_rows(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Look once at all residuals of a problem that does not say how many there are."""
        theta = state.space.decode(state.space.initial(state.asked + 1))[state.asked]
        state.asked += 1
        state.over = state.asked == 1000
        with contextlib.suppress(UnusableValueError):
            state.ends[:] = oracle.residuals(theta).size
            state.asked, state.over = 0, False

    # -- the phases of a bracket

    def _draw(self, state: MIHOGNState, oracle: Oracle) -> None:
        state.bracket += 1
        d, p = len(state.space), len(state.box.linear)
        state.projects = bool(p) and (
            {"even": state.bracket % 2 == 0, "always": True, "never": False, "odd": state.bracket % 2 == 1}[self.project]
            or not state.box.nonlinear.size)
        state.size = (d + 1) * min(self.base * luby(state.bracket), self.largest)
        look = self._share(state, 0) * (p + 1 if state.projects else 1)
        n = int(np.clip(round(state.size / look), self.least, self.most))
        if not state.box.nonlinear.size:
            n = 1
        x = self._starts(state, n)
        state.begun = oracle.evaluations
        oracle.screened(n)
        state.alive = Candidates.at(x, state.ends.size, self.damping, state.projects)
        state.phase, state.level = SCREEN, 0
        self._room(state)

    def _after_screen(self, state: MIHOGNState, oracle: Oracle) -> None:
        c = usable(state.alive)
        if c.loss.size:
            state.least = min(state.least, float(c.loss[0]))
        if not state.box.nonlinear.size:
            if state.level + 1 < state.ends.size:
                state.alive = c
                state.level += 1
                self._enter(state)
                return
            state.phase, state.over = OVER, True
            if c.loss.size:
                self._ended(state, oracle, float(oracle.best), True)
            return
        self._rung(state, oracle, c, c.loss.size)

    def _rung(self, state: MIHOGNState, oracle: Oracle, c: Candidates, before: int) -> None:
        """Keep the best, and give them their steps at this level."""
        d, p = len(state.space), len(state.box.linear)
        if not c.loss.size:
            state.phase = OVER
            self._close(state, oracle)
            return
        step = self._share(state, state.level) * ((p + 1 if state.projects else 1) + state.slope_cost)
        n = int(np.clip(state.size / (self.steps * step), 1, max(1, before // self.eta)))
        state.alive = c.take(np.arange(min(n, c.loss.size)))
        last = state.level == state.ends.size - 1
        m = state.ends[state.level]
        if c.rows.shape[2] != m or (state.alive.stage == ENTER).any():
            pass
        self._begin(state, FINISH if last and state.alive.loss.size == 1 else CLIMB)

    def _begin(self, state: MIHOGNState, phase: str) -> None:
        c = state.alive
        c.steps[:], c.spent[:], c.mark[:], c.marked[:] = 0, 0, 0, c.loss
        state.phase = phase

    def _after_climb(self, state: MIHOGNState, oracle: Oracle) -> None:
        c = usable(state.alive)
        last = state.level == state.ends.size - 1
        if last or not c.loss.size:
            state.alive, state.rest = c, None
            self._pruned(state, oracle)
            return
        state.rest = c.take(np.arange(1, c.loss.size))
        state.alive = c.take(np.arange(1))
        self._begin(state, LEAD)

    def _after_lead(self, state: MIHOGNState, oracle: Oracle) -> None:
        state.alive = state.alive.beside(state.rest)
        state.rest = None
        self._pruned(state, oracle)

    def _pruned(self, state: MIHOGNState, oracle: Oracle) -> None:
        c = usable(state.alive)
        before = c.loss.size
        if not before:
            state.phase = OVER
            self._close(state, oracle)
            return
        minima = self._minima(state)
        gone = c.stage == KNOWN
        if minima.loss.size:
            gone |= (c.stage == DONE) & (c.loss >= minima.loss.min() * (1 - 1e-12))
        if gone.all():
            self._returned(state, oracle, c)
            state.phase = OVER
            self._close(state, oracle)
            return
        c = c.take(np.flatnonzero(~gone))
        c = c.take(distinct(c, state.box, int(state.ends[state.level])))
        last = state.level == state.ends.size - 1
        state.alive = c
        if last:
            self._rung(state, oracle, c, c.loss.size)
            return
        state.level += 1
        d, p = len(state.space), len(state.box.linear)
        step = self._share(state, state.level) * ((p + 1 if state.projects else 1) + state.slope_cost)
        n = int(np.clip(state.size / (self.steps * step), 1, max(1, c.loss.size // self.eta)))
        state.alive = c.take(np.arange(min(n, c.loss.size)))
        self._enter(state)
        last = state.level == state.ends.size - 1
        self._begin(state, FINISH if last and state.alive.loss.size == 1 else CLIMB)

    def _enter(self, state: MIHOGNState) -> None:
        c = state.alive
        last = state.level == state.ends.size - 1
        finished = c.stage == DONE
        c.projects[:] = state.projects & (~finished | (not last))
        if not state.box.nonlinear.size:
            c.projects[:] = True
        c.damping[finished] = np.minimum(c.damping[finished], 1e-3)
        c.stage[:], c.loss[:], c.gain[:], c.growth[:], c.secants[:] = ENTER, np.inf, np.inf, 2.0, 0
        c.trial[:] = c.x
        self._room(state)

    def _after_finish(self, state: MIHOGNState, oracle: Oracle) -> None:
        self._settle(state, oracle, state.alive)
        self._close(state, oracle)
        if not state.aside or state.over:
            state.phase = OVER
            return
        best = min(range(len(state.aside)), key=lambda k: state.aside[k].loss[0])
        state.alive = state.aside.pop(best)
        self._begin(state, SHARE)

    def _after_share(self, state: MIHOGNState, oracle: Oracle) -> None:
        self._settle(state, oracle, state.alive)
        state.phase = OVER
        self._close(state, oracle)

    def _settle(self, state: MIHOGNState, oracle: Oracle, c: Candidates) -> None:
        """What became of the last one of a bracket, on all rows."""
        stage = int(c.stage[0])
        if stage == KNOWN:
            self._returned(state, oracle, c)
        elif stage == DONE:
            loss = float(c.loss[0])
            self._ended(state, oracle, loss, True)
            best = state.minima.loss.min(initial=math.inf)
            if loss < best or not in_optimum(float(best), loss, state.rounding):
                sums = c.sums[0] if c.sums[0, -1] > 0 else loss * state.ends
                state.minima = Known(np.vstack([state.minima.x, c.x]),
                                     np.append(state.minima.loss, loss))
                state.sums = np.vstack([state.sums.reshape(-1, state.ends.size), sums])
                state.sound = np.append(state.sound, self._sound(state, c))
        elif stage != UNUSABLE:
            state.aside.append(c)

    def _sound(self, state: MIHOGNState, c: Candidates) -> bool:
        """Whether the data determine each parameter within its range, off its bounds."""
        n = state.box.nonlinear.size if c.projects[0] else len(state.space)
        if (c.x <= 1e-9).any() or (c.x >= 1 - 1e-9).any():
            return False
        m = int(state.ends[-1])
        R = c.R[0, :n, :n]
        if not n:
            return True
        if not np.abs(np.diag(R)).all():
            return False
        variance = c.loss[0] * m / max(m - n, 1)
        inverse = np.linalg.inv(R)
        return bool((np.einsum("ij,ij->i", inverse, inverse) * variance <= 1).all())

    def _returned(self, state: MIHOGNState, oracle: Oracle, c: Candidates) -> None:
        """A bracket came back to what is known, or ended at something that is not better."""
        minima = self._minima(state)
        nearest = int(np.argmin(((minima.x - c.x[0]) ** 2).sum(axis=1)))
        loss = float(state.minima.loss[nearest])
        if c.stage[0] != KNOWN:
            # of a few rows only: as far as they tell two optima apart
            best = int(np.argmin(minima.loss))
            worse = math.log(max(1.0, c.loss[0] / minima.loss[best])) / math.log(APART)
            loss = float(state.minima.loss[best] * APART ** math.floor(1 + worse))
        self._ended(state, oracle, loss, True)

    def _ended(self, state: MIHOGNState, oracle: Oracle, loss: float, converged: bool) -> None:
        oracle.ended(math.inf, loss, converged=converged)

    def _close(self, state: MIHOGNState, oracle: Oracle) -> None:
        """The end of a bracket: whether that is enough."""
        if state.bracket >= self.brackets:
            state.over = True
        elif state.minima.loss.size:
            best = int(np.argmin(state.minima.loss))
            crawling = any(c.loss[0] < state.minima.loss[best] for c in state.aside)
            agreement = oracle.agreement
            enough = agreement.enough and (state.sound[best] or agreement.here >= self.doubtful)
            state.over = enough and not crawling

    # -- what the phases need

    def _share(self, state: MIHOGNState, level: int) -> float:
        return float(state.ends[level] / state.ends[-1]) if state.ends[-1] else 1.0

    def _minima(self, state: MIHOGNState) -> Known:
        """The known minima with their losses over the rows of this level."""
        if not state.minima.loss.size or state.level == state.ends.size - 1:
            return state.minima
        return Known(state.minima.x, state.sums[:, state.level] / state.ends[state.level])

    def _sound_minima(self, state: MIHOGNState) -> Known:
        minima = self._minima(state)
        return Known(minima.x[state.sound], minima.loss[state.sound])

    def _room(self, state: MIHOGNState) -> None:
        c, m = state.alive, int(state.ends[state.level])
        n, d = c.x.shape
        few = not state.compiled or (n * (d + 1) * m <= ROOM and not c.projects.all())
        state.alive = c.with_rows(m if few else 0)

    def _rules(self, state: MIHOGNState, oracle: Oracle) -> Rules:
        d, m, last = len(state.space), max(1, int(state.ends[state.level])), state.level == state.ends.size - 1
        N = max(1, int(state.ends[-1]))
        phase = state.phase
        steps = {SCREEN: 0, CLIMB: self.steps, LEAD: self.lead - self.steps}.get(phase, 1 << 40)
        share = 0
        if phase == SHARE:
            share = int((oracle.evaluations - state.begun) * N)
        return Rules(
            level=state.level, last=last, steps=steps, reach=self.reach,
            tolerance=self.tolerance if last else self.level_tolerance * d / m,
            patience=0 if phase in (SCREEN, CLIMB) else self.patience * (d + 1) * m,
            share=share, progress=self.progress,
            near=min(9 * d / m, 0.1) if last else 9 * d / m, better=0.0 if last else 4 * d / m,
            nothing=0.0,
        )

    def _starts(self, state: MIHOGNState, n: int) -> Array:
        """Unit coordinates (n, d): by scale, from the space's own distribution, uniform."""
        space, rng, d = state.space, state.rng, len(state.space)
        low, high = space.bounds
        u = rng.random((n, d))
        x = u.copy()
        first = state.bracket == 1
        own = space.initial(n) if first else space.sample(n, rng)
        own = (space.encode(space.clip(space.decode(own))) - low) / (high - low)
        kinds = {"space": [0, 2, 2], "thirds": [0, 2, 1], "uniform": [1], "own": [0], "scale": [2], "halves": [0, 2]}[self.draws]
        kind = np.array(kinds)[np.arange(n) % len(kinds)]
        if first:
            kind[0] = 0
        x[kind == 0] = own[kind == 0]
        for k, parameter in enumerate(space.parameters):
            x[kind == 2, k] = by_scale(u[kind == 2, k], parameter)
        return np.clip(x, 0, 1)


def by_scale(u: Array, parameter: Parameter) -> Array:
    """Unit coordinates of values that are small or large alike, from uniform numbers.

    On a linear scale the magnitude is log-uniform over the DECADES below the largest one that the
    range allows on its side of zero; the two sides have equal parts of u. A range that is not
    wide against its distance from zero, and a log scale, are drawn from uniformly.
    """
    low, high = parameter.low, parameter.high
    if parameter.scale == "log" or min(abs(low), abs(high)) * 10 > max(abs(low), abs(high)) and low * high > 0:
        return u
    if low < 0 < high:
        left = u < 0.5
        u = np.where(left, 1 - 2 * u, 2 * u - 1)
        value = np.where(left, -magnitude(u, 0.0, -low), magnitude(u, 0.0, high))
    elif low >= 0:
        value = magnitude(u, low, high)
    else:
        value = -magnitude(1 - u, -high, -low)
    return np.clip((value - low) / (high - low), 0.0, 1.0)


def magnitude(u: Array, low: float, high: float) -> Array:
    """Log-uniform from low, or the last of the DECADES below high, to high."""
    low = max(low, high * 10.0**-DECADES)
    return np.asarray(low * (high / low) ** u)


def usable(c: Candidates) -> Candidates:
    order = np.argsort(c.loss, kind="stable")
    return c.take(order[(c.stage[order] != UNUSABLE) & np.isfinite(c.loss[order])])


def luby(k: int) -> int:
    while True:
        n = k.bit_length()
        if k == 2**n - 1:
            return 2 ** (n - 1)
        k -= 2 ** (n - 1) - 1
