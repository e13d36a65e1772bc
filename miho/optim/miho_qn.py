"""Hyperband over quasi-Newton steps on growing data, from losses alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from miho.compiled.phases import CLOSED, FINISH, LEAD, REVIVE, RUNG, SCREEN, UNLIMITED
from miho.optim.brackets import check_brackets, draw_starts, luby, rows_by_level
from miho.optim.miho_qn_state import (
    NEAR_LAST,
    MIHOQNState,
    at_known,
    distinct,
    offsets_from,
)
from miho.optim.optimizer import AskTell
from miho.optim.oracle import Oracle
from miho.optim.quasi_newton import diagonal
from miho.optim.quasi_newton_candidates import (
    DONE,
    HESSIAN,
    LOOK,
    SLOPE,
    STUCK,
    UNUSABLE,
    WAIT,
    QNBox,
    QNCandidates,
)
from miho.optim.quasi_newton_steps import QNRules, answer, points, requests_of
from miho.optim.simplex import Simplex
from miho.optim.space import Space
from miho.optim.trace import Starts
from miho.quantities import Array
from miho.validate import positive_settings, whole_settings

LITTLE = 1e-6
"""A simplex that gains less than this share of a loss was the last one."""
SHARP = 1e-3
"""A curvature that alone would double the loss within this share of a width may be a kink."""
REENTRY = 0.05
"""The least radius at the start of a level and after a simplex, whatever failed before."""


@dataclass(frozen=True)
class MIHOQN(AskTell[MIHOQNState]):
    """Brackets of successive halving whose survivors descend, on ever more rows of the data.

    A bracket looks at configurations on the first rows of the data, `rows` for each parameter, and
    keeps the best. Each rung gives its candidates `steps` quasi-Newton steps, the best of them up
    to `lead`, and hands the best one in `eta` on to the next, with `eta` times as many rows, until
    the last candidate goes to its end on all rows. A level that would have more than the share
    `jump` of all rows has all of them; so has one after more than `enough` rows for each parameter,
    and so have all levels of a problem that does not say how many rows it has. A rung costs about
    `base` (d + 1) evaluations times Luby's sequence, at most `largest` (d + 1); a bracket begins
    with `least` to `most` configurations.

    Slopes and curvatures are differences of losses on the rung's rows, and are taken along to the
    next level: the first curvatures are those along the coordinates, later ones BFGS updates. A
    candidate that goes on alone has its Hessian measured: the best one of a rung at once, others
    before they count as done; and again where a step did not go as predicted, after `refresh` times
    as many evaluations as that takes. Up to `guesses` steps in a row rely on slopes that the model
    predicts. Steps stay within `radius` of the widths along each coordinate. A descent is done
    where its model predicts a gain below the share `tolerance` of the loss; on m rows, fewer than
    all, below `level_tolerance` d / m, which so few do not tell from noise. Kinks stop such steps:
    where none helps, a simplex with edges of `edge` of the widths has up to `polish` d evaluations,
    and if it makes progress, steps go on.

    A descent that gains less than the share `progress` of its loss in `patience` (d + 1)
    evaluations is set aside; the best of those may spend as much as the next bracket has. A bracket
    whose best candidate comes to a known minimum ends. The search ends when the ends of its
    brackets are evidence enough (`miho.optim.evidence`), at the latest after `brackets` of them.
    """

    eta: int = 3
    rows: float = 4.0
    jump: float = 0.5
    enough: float = 200.0
    base: float = 0.5
    largest: float = 32.0
    least: int = 3
    most: int = 243
    steps: int = 3
    lead: int = 60
    radius: float = 0.5
    tolerance: float = 1e-9
    level_tolerance: float = 0.1
    guesses: int = 3
    refresh: float = 1.0
    patience: float = 8.0
    progress: float = 0.05
    edge: float = 0.02
    polish: int = 30
    brackets: int = 200

    def __post_init__(self) -> None:
        check_brackets(self)
        whole_settings(self, ("guesses", "polish"), 0)
        positive_settings(self, ("radius", "refresh", "edge"))

    def init(self, space: Space, rng: np.random.Generator) -> MIHOQNState:
        """The state before the first batch, of a problem without cheaper versions of itself."""
        return self._begin(space, rng, (0,), (1.0,), Starts(brackets=True))

    def start(self, oracle: Oracle, rng: np.random.Generator) -> MIHOQNState:
        """The state before the first batch."""
        space, N = oracle.space, oracle.rows
        level_rows: tuple[int, ...] = (0,)
        level_costs: tuple[float, ...] = (1.0,)
        if N is not None:
            level_rows = rows_by_level(
                N,
                len(space),
                per_parameter=self.rows,
                eta=self.eta,
                jump=self.jump,
                enough=self.enough,
            )
            level_costs = tuple(oracle.cost(m / N) for m in level_rows)
            if level_costs[0] >= 1.0:  # fewer rows are not cheaper
                level_rows, level_costs = level_rows[-1:], level_costs[-1:]
        state = self._begin(space, rng, level_rows, level_costs, oracle.meter.starts)
        state.starts.brackets = True
        return state

    def _begin(
        self,
        space: Space,
        rng: np.random.Generator,
        level_rows: tuple[int, ...],
        level_costs: tuple[float, ...],
        starts: Starts,
    ) -> MIHOQNState:
        """The state with the first bracket's starts drawn."""
        no_points = np.empty((0, len(space)))
        candidates, box = QNCandidates.at(no_points, self.radius), QNBox.of(space)
        state = MIHOQNState(
            space, box, rng, level_rows, level_costs, candidates, minima=no_points, starts=starts
        )
        self._proceed(state)
        return state

    def done(self, state: MIHOQNState) -> bool:
        """After brackets whose ends are evidence enough, or after the last."""
        return state.finished

    def fidelity(self, state: MIHOQNState) -> float:
        """The share of the rows that the level looks at."""
        return 1.0 if state.last else state.rows / state.level_rows[-1]

    def ask(self, state: MIHOQNState) -> Array:
        """The points whose losses the candidates of the rung need next."""
        return state.space.decode(state.batch)

    def tell(self, state: MIHOQNState, thetas: Array, losses: Array) -> None:
        """Give each candidate its losses, and see what is needed next."""
        state.spent += losses.size * state.cost
        if state.last:
            state.best = min(state.best, float(losses.min()))
        if state.simplex is not None:
            state.simplex.tell(losses)
        else:
            answer(state.candidates, state.box, self._rules(state), state.requests, losses)
            if state.phase in (LEAD, FINISH, REVIVE):
                self._watch(state)
        self._proceed(state)

    def _rules(self, state: MIHOQNState) -> QNRules:
        """How steps are made in this phase, on this level."""
        level_tolerance = self.level_tolerance * state.d / max(state.rows, 1)
        return QNRules(
            cost=state.cost,
            tolerance=self.tolerance if state.last else level_tolerance,
            last=state.last,
            screens=state.phase == SCREEN,
            measures=state.phase in (LEAD, FINISH, REVIVE),
            refresh=self.refresh,
            guesses=self.guesses,
            radius=self.radius,
            rounding=state.starts.rounding,
        )

    def _watch(self, state: MIHOQNState) -> None:
        """Stop a candidate that goes on alone where it stalls, or has come to a known minimum."""
        c = state.candidates
        if c.stage[0] >= WAIT:
            return
        if state.phase != LEAD and at_known(state, c)[0]:
            c.stage[0] = WAIT
        elif c.spent_since_mark[0] >= self.patience * (state.d + 1) * state.cost:
            stalls = c.loss_at_mark[0] - c.loss[0] < self.progress * abs(c.loss_at_mark[0])
            if stalls and (
                state.phase != REVIVE or state.spent - state.spent_before >= state.allowance
            ):
                c.stage[0] = WAIT
            c.spent_since_mark[0], c.loss_at_mark[0] = 0.0, c.loss[0]

    # The phases of a bracket.

    def _proceed(self, state: MIHOQNState) -> None:
        """Go on to the next phase until losses are needed."""
        phases = {
            SCREEN: self._after_screen,
            RUNG: self._after_rung,
            LEAD: self._after_lead,
            FINISH: self._after_finish,
            REVIVE: self._after_revival,
            CLOSED: self._draw,
        }
        while not state.finished:
            simplex = state.simplex
            if simplex is not None:
                if simplex.done or simplex.evaluations >= self.polish * state.d:
                    self._after_simplex(state, simplex)
                    continue
                state.batch = state.box.at(simplex.batch)
                return
            state.requests = requests_of(state.candidates, state.box)
            if state.requests:
                state.batch = points(state.candidates, state.box, state.requests)
                return
            phases[state.phase](state)

    def _draw(self, state: MIHOQNState) -> None:
        """Begin a bracket: draw its starts, to be looked at on the first level."""
        state.bracket += 1
        state.rung_budget = (state.d + 1) * min(self.base * luby(state.bracket), self.largest)
        state.level, state.spent_before, state.phase = 0, state.spent, SCREEN
        n = min(max(round(state.rung_budget / state.cost), self.least), self.most)
        z = draw_starts(state.space, n, state.rng, state.bracket)
        state.starts.screened += n
        state.candidates = QNCandidates.at(z, self.radius)

    def _after_screen(self, state: MIHOQNState) -> None:
        """Keep the best starts."""
        state.candidates = state.candidates.usable
        self._rung(state)

    def _rung(self, state: MIHOQNState) -> None:
        """Give the best candidates their steps on this level; the last one, all that it needs."""
        size = len(state.candidates)
        if not size:
            self._close(state)
            return
        affordable = max(state.rung_budget / (self.steps * (state.d + 2) * state.cost), 1)
        n = int(min(affordable, max(1, size / self.eta)))
        state.candidates = state.candidates.first(n)
        alone = state.last and len(state.candidates) == 1
        state.phase = FINISH if alone else RUNG
        state.candidates.go_on(UNLIMITED if alone else self.steps)

    def _after_rung(self, state: MIHOQNState) -> None:
        """Give the best one more steps, with its Hessian measured if it never was."""
        if not self._prune(state):
            return
        c = state.candidates
        if state.last:
            self._rung(state)
            return
        state.phase = LEAD
        c.go_on(self.lead, slice(1))
        if c.stage[0] in (SLOPE, DONE) and math.isinf(c.hessian_age[0]):
            c.stage[0] = HESSIAN

    def _after_lead(self, state: MIHOQNState) -> None:
        """Go on with all of the rung, on more rows."""
        if self._prune(state):
            state.level += 1
            c = state.candidates
            c.radius = np.maximum(c.radius, REENTRY)
            c.stage[:] = LOOK
            self._rung(state)

    def _prune(self, state: MIHOQNState) -> bool:
        """Drop the candidates that lead to known minima or are copies; False if the bracket ends.

        It ends where its best candidate is at a known minimum: to follow those that are worse on
        the same rows would cost more than the next bracket.
        """
        state.candidates = c = state.candidates.usable
        known = at_known(state, c)
        if not len(c) or known[0]:
            if len(c):
                self._record_return(state)
            self._close(state)
            return False
        c = c.take(np.flatnonzero(~known))
        state.candidates = c.take(distinct(state, c))
        return True

    def _after_finish(self, state: MIHOQNState) -> None:
        """Revive the best candidate that stalled in an earlier bracket, if there is any.

        It may spend as much as this bracket has.
        """
        earlier = list(state.stalled)
        if not self._record_end(state):
            return
        if not earlier:
            self._close(state)
            return
        best = min(range(len(earlier)), key=lambda k: earlier[k].loss[0])
        state.candidates, state.phase = state.stalled.pop(best), REVIVE
        state.allowance, state.spent_before = state.spent - state.spent_before, state.spent
        state.candidates.go_on(UNLIMITED)

    def _after_revival(self, state: MIHOQNState) -> None:
        """Record its end, as that of a bracket."""
        if self._record_end(state):
            self._close(state)

    def _record_end(self, state: MIHOQNState) -> bool:
        """Record how the last candidate of a bracket has ended: new, known, stalled or unusable.

        False if it goes on with a simplex: where it is stuck, or at what may be a kink.
        """
        c = state.candidates
        stage = int(c.stage[0])
        size = max(abs(c.loss[0]), state.starts.rounding)
        sharp = (diagonal(c.B[:1]) * SHARP**2 > size).any()
        known = (np.abs(state.minima_losses - c.loss[0]) <= NEAR_LAST * size).any()
        if (stage == STUCK or (stage == DONE and sharp)) and not (known or state.polished):
            centre = state.box.shares(c.z[0])
            state.simplex = Simplex.around(centre, float(c.loss[0]), self.edge)
            return False
        state.polished = False
        if stage in (DONE, STUCK):
            state.minima = np.vstack([state.minima, c.z])
            state.minima_losses = np.append(state.minima_losses, c.loss[0])
            state.starts.add(math.inf, float(c.loss[0]), theta=state.space.decode(c.z)[0])
        elif stage != UNUSABLE and at_known(state, c)[0]:
            self._record_return(state)
        elif stage != UNUSABLE:
            state.stalled.append(c)
        return True

    def _after_simplex(self, state: MIHOQNState, simplex: Simplex) -> None:
        """Go on from the simplex's best corner, if it gained."""
        c = state.candidates
        x, loss = simplex.best
        state.simplex = None
        gain = c.loss[0] - loss
        c.z[0] = c.measured_at[0] = state.box.at(x)
        c.loss[0] = loss
        state.polished = gain <= LITTLE * abs(loss)
        if not state.polished:
            c.stage[0], c.failures[0], c.radius[0] = WAIT, 0, max(c.radius[0], REENTRY)
            if gain >= self.progress * abs(loss):
                c.go_on(UNLIMITED)

    def _record_return(self, state: MIHOQNState) -> None:
        """Record that the best candidate of a bracket has come to a known minimum, the nearest."""
        c = state.candidates
        rise = c.rise(slice(1), offsets_from(state, state.minima, c.z[:1]))
        nearest = np.argmin(rise[0])
        place = state.space.decode(state.minima[nearest : nearest + 1])[0]
        state.starts.add(math.inf, float(state.minima_losses[nearest]), theta=place)

    def _close(self, state: MIHOQNState) -> None:
        """End the bracket, and the search if the ends of its brackets are evidence enough."""
        state.phase = CLOSED
        enough = state.starts.agreement(state.best).enough
        state.finished = enough or state.bracket >= self.brackets
        state.starts.exhausted = state.finished and not enough
