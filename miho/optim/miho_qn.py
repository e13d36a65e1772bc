"""Hyperband over quasi-Newton steps on growing data, from losses alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from miho.optim.brackets import check_brackets, draw_starts, levels, luby
from miho.optim.candidates import (
    DONE,
    HESSIAN,
    LOOK,
    REST,
    SLOPE,
    STUCK,
    UNUSABLE,
    Box,
    Candidates,
    Rules,
    answer,
    needs,
    points,
)
from miho.optim.miho_qn_state import (
    CLIMB,
    FINISH,
    LEAD,
    NEAR_LAST,
    OVER,
    SCREEN,
    SHARE,
    MIHOQNState,
    at_known,
    away_from,
    distinct,
)
from miho.optim.optimizer import AskTell
from miho.optim.oracle import Oracle
from miho.optim.quasi_newton import diagonal
from miho.optim.simplex import Simplex
from miho.optim.space import Space
from miho.optim.trace import Starts
from miho.quantities import Array
from miho.validate import positive_settings, whole_settings

ALONE = 1 << 40
"""Steps of a configuration that goes on as long as it makes progress."""
LITTLE = 1e-6
"""A simplex that gains less than this share of a loss was the last one."""
SHARP = 1e-3
"""Where a curvature alone would double a loss within this share of a width, it may be a kink."""
REENTRY = 0.05
"""The least radius with which a level begins, whatever trouble the one before had."""


@dataclass(frozen=True)
class MIHOQN(AskTell[MIHOQNState]):
    """Brackets of successive halving in which what survives has descended, on ever more rows.

    A bracket looks at configurations on the first rows of the data, `rows` for each parameter, and
    keeps the best. Each rung gives the survivors `steps` quasi-Newton steps, its best one up to
    `lead`, and `eta` times as many rows, until the last one goes to its end on all rows. A level
    with more than the share `jump` of all rows, or after `enough` rows for each parameter, is all
    of them; so are all levels of a problem that says no rows. Brackets have rungs of `base` (d + 1)
    evaluations times Luby's sequence, at most `largest`; `least` to `most` configurations.

    Slopes and curvatures are differences of losses on the rung's rows, and go up with the
    configuration: the first curvatures are those along the coordinates, later ones BFGS updates.
    A descent that goes on alone has its Hessian measured, the best one of a rung at once, others
    before they are believed to be done; and anew where a step did not go as predicted, after
    `refresh` times as many evaluations as that takes. Up to `guesses` steps in a row rely on slopes
    that the model predicts. Steps stay within `radius` of the widths along each coordinate, and are
    over where they promise less than `tolerance` of the loss; on m rows, fewer than all,
    `level_tolerance` d / m, which they cannot tell. Kinks stop such steps: where none helps, a
    simplex with edges of `edge` of the widths has up to `polish` d evaluations, and if it makes
    progress, steps go on.

    A descent that gains less than the share `progress` of its loss in `patience` (d + 1)
    evaluations is set aside; the best of those gets as much as the next bracket spends. A bracket
    whose best one comes to a known minimum ends. The search ends when the ends of its brackets are
    evidence enough (`miho.optim.evidence`), at the latest after `brackets` of them.
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
        ends: tuple[int, ...] = (0,)
        costs: tuple[float, ...] = (1.0,)
        if N is not None:
            ends = levels(
                N,
                len(space),
                per_parameter=self.rows,
                eta=self.eta,
                jump=self.jump,
                enough=self.enough,
            )
            costs = tuple(oracle.cost(m / N) for m in ends)
            if costs[0] >= 1.0:  # fewer rows are not cheaper
                ends, costs = ends[-1:], costs[-1:]
        state = self._begin(space, rng, ends, costs, oracle.meter.starts)
        state.starts.brackets = True
        return state

    def _begin(
        self,
        space: Space,
        rng: np.random.Generator,
        ends: tuple[int, ...],
        costs: tuple[float, ...],
        starts: Starts,
    ) -> MIHOQNState:
        none = np.empty((0, len(space)))
        live = Candidates.at(none, self.radius)
        state = MIHOQNState(space, Box.of(space), rng, ends, costs, live, none, starts)
        self._proceed(state)
        return state

    def done(self, state: MIHOQNState) -> bool:
        """After brackets whose ends are evidence enough, or after the last."""
        return state.over

    def fidelity(self, state: MIHOQNState) -> float:
        """The share of the rows that the level looks at."""
        return 1.0 if state.last else state.rows / state.ends[-1]

    def ask(self, state: MIHOQNState) -> Array:
        """What all configurations of the rung need next."""
        return state.space.decode(state.batch)

    def tell(self, state: MIHOQNState, thetas: Array, losses: Array) -> None:
        """Give each configuration its losses, and see what is needed next."""
        state.spent += losses.size * state.cost
        if state.last:
            state.best = min(state.best, float(losses.min()))
        if state.simplex is not None:
            state.simplex.tell(losses)
        else:
            answer(state.live, state.box, self._rules(state), state.requests, losses)
            if state.phase in (LEAD, FINISH, SHARE):
                self._watch(state)
        self._proceed(state)

    def _rules(self, state: MIHOQNState) -> Rules:
        level_tolerance = self.level_tolerance * state.d / max(state.rows, 1)
        return Rules(
            cost=state.cost,
            tolerance=self.tolerance if state.last else level_tolerance,
            last=state.last,
            screens=state.phase == SCREEN,
            measures=state.phase in (LEAD, FINISH, SHARE),
            refresh=self.refresh,
            guesses=self.guesses,
            radius=self.radius,
            rounding=state.starts.rounding,
        )

    def _watch(self, state: MIHOQNState) -> None:
        """Stop the one that goes on alone where it crawls, or has come to a known minimum."""
        c = state.live
        if c.stage[0] >= REST:
            return
        if state.phase != LEAD and at_known(state, c)[0]:
            c.stage[0] = REST
        elif c.spent[0] >= self.patience * (state.d + 1) * state.cost:
            crawls = c.mark[0] - c.loss[0] < self.progress * abs(c.mark[0])
            if crawls and (state.phase != SHARE or state.spent - state.begun >= state.share):
                c.stage[0] = REST
            c.spent[0], c.mark[0] = 0.0, c.loss[0]

    # The phases of a bracket.

    def _proceed(self, state: MIHOQNState) -> None:
        """Go on to the next phase until losses are needed."""
        phases = {
            SCREEN: self._screened,
            CLIMB: self._climbed,
            LEAD: self._led,
            FINISH: self._finished,
            SHARE: self._shared,
            OVER: self._draw,
        }
        while not state.over:
            simplex = state.simplex
            if simplex is not None:
                if simplex.done or simplex.evaluations >= self.polish * state.d:
                    self._polished(state, simplex)
                    continue
                state.batch = state.box.at(simplex.batch)
                return
            state.requests = needs(state.live, state.box)
            if state.requests:
                state.batch = points(state.live, state.box, state.requests)
                return
            phases[state.phase](state)

    def _draw(self, state: MIHOQNState) -> None:
        """Begin a bracket."""
        state.bracket += 1
        state.size = (state.d + 1) * min(self.base * luby(state.bracket), self.largest)
        state.level, state.begun, state.phase = 0, state.spent, SCREEN
        n = min(max(round(state.size / state.cost), self.least), self.most)
        z = draw_starts(state.space, n, state.rng, state.bracket == 1)
        state.starts.screened += n
        state.live = Candidates.at(z, self.radius)

    def _screened(self, state: MIHOQNState) -> None:
        state.live = state.live.usable
        self._rung(state)

    def _rung(self, state: MIHOQNState) -> None:
        """Give the best of the live ones their steps on this level; the last one, all it needs."""
        before = len(state.live)
        if not before:
            self._close(state)
            return
        steps = state.size / (self.steps * (state.d + 2) * state.cost)
        state.live = state.live.best(int(min(max(steps, 1), max(1, before / self.eta))))
        alone = state.last and len(state.live) == 1
        state.phase = FINISH if alone else CLIMB
        state.live.go_on(ALONE if alone else self.steps)

    def _climbed(self, state: MIHOQNState) -> None:
        if not self._pruned(state):
            return
        c = state.live
        if state.last:
            self._rung(state)
            return
        state.phase = LEAD
        c.go_on(self.lead, slice(1))
        if c.stage[0] in (SLOPE, DONE) and math.isinf(c.age[0]):
            c.stage[0] = HESSIAN

    def _led(self, state: MIHOQNState) -> None:
        if self._pruned(state):
            state.level += 1
            c = state.live
            c.radius = np.maximum(c.radius, REENTRY)
            c.stage[:] = LOOK
            self._rung(state)

    def _pruned(self, state: MIHOQNState) -> bool:
        """Keep what may lead to something new; whether there is any.

        A bracket whose best one has come back to a known minimum has come back to it: to follow
        those that are worse on the same rows costs more than the next bracket.
        """
        state.live = c = state.live.usable
        known = at_known(state, c)
        if not len(c) or known[0]:
            if len(c):
                self._returned(state)
            self._close(state)
            return False
        c = c.take(np.flatnonzero(~known))
        state.live = c.take(distinct(state, c))
        return True

    def _finished(self, state: MIHOQNState) -> None:
        """Give what crawls as much as this bracket has spent, if there is any from before."""
        earlier = list(state.aside)
        if not self._settled(state):
            return
        if not earlier:
            self._close(state)
            return
        best = min(range(len(earlier)), key=lambda k: earlier[k].loss[0])
        state.live, state.phase = state.aside.pop(best), SHARE
        state.share, state.begun = state.spent - state.begun, state.spent
        state.live.go_on(ALONE)

    def _shared(self, state: MIHOQNState) -> None:
        if self._settled(state):
            self._close(state)

    def _settled(self, state: MIHOQNState) -> bool:
        """Keep what became of the last one of a bracket; False if a simplex has the last word."""
        c = state.live
        stage = int(c.stage[0])
        size = max(abs(c.loss[0]), state.starts.rounding)
        sharp = (diagonal(c.B[:1]) * SHARP**2 > size).any()
        again = (np.abs(state.losses - c.loss[0]) <= NEAR_LAST * size).any()
        if (stage == STUCK or (stage == DONE and sharp)) and not (again or state.polished):
            around = state.box.shares(c.z[0])
            state.simplex = Simplex.around(around, float(c.loss[0]), self.edge)
            return False
        state.polished = False
        if stage in (DONE, STUCK):
            state.minima = np.vstack([state.minima, c.z])
            state.losses = np.append(state.losses, c.loss[0])
            state.starts.ended(math.inf, float(c.loss[0]))
        elif stage != UNUSABLE and at_known(state, c)[0]:
            self._returned(state)
        elif stage != UNUSABLE:
            state.aside.append(c)
        return True

    def _polished(self, state: MIHOQNState, simplex: Simplex) -> None:
        """Go on from the simplex's best corner, if it gained."""
        c = state.live
        x, loss = simplex.best
        state.simplex = None
        gain = c.loss[0] - loss
        c.z[0] = c.base[0] = state.box.at(x)
        c.loss[0] = loss
        state.polished = gain <= LITTLE * abs(loss)
        if not state.polished:
            c.stage[0], c.failures[0], c.radius[0] = REST, 0, max(c.radius[0], REENTRY)
            if gain >= self.progress * abs(loss):
                c.go_on(ALONE)

    def _returned(self, state: MIHOQNState) -> None:
        """The best of a bracket has come back to a known minimum."""
        c = state.live
        above = c.above(slice(1), away_from(state, c.z[:1], state.minima))
        state.starts.ended(math.inf, float(state.losses[np.argmin(above[0])]))

    def _close(self, state: MIHOQNState) -> None:
        """End the bracket, and the search if the ends of its brackets are evidence enough."""
        state.phase = OVER
        enough = state.starts.agreement(state.best).enough
        state.over = enough or state.bracket >= self.brackets
        state.starts.exhausted = state.over and not enough
