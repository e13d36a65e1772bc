"""MIHO-QN: Hyperband over quasi-Newton steps from losses alone, on growing subsets of the data."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from miho.compiled.phases import CLOSED, FINISH, LEAD, REVIVE, RUNG, SCREEN, UNLIMITED
from miho.optim.ask_tell import AskTell
from miho.optim.brackets import Brackets, check_brackets, draw_starts
from miho.optim.miho_qn_state import NEAR_LAST, MIHOQNState, at_known, distinct, offsets_from
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
"""A simplex that decreases the loss by less than this share is the last."""
SHARP = 1e-3
"""A curvature that alone would double the loss within this share of a width may be a kink."""
REENTRY = 0.05
"""Smallest radius at the start of a level and after a simplex."""


@dataclass(frozen=True)
class MIHOQN(Brackets, AskTell[MIHOQNState]):
    """Multistart quasi-Newton search in brackets of successive halving, from losses alone.

    For problems without residuals, or with a loss that is not smooth. It shares brackets, levels
    and the stopping rule with `MIHOGN`. Slopes and curvatures are finite differences of losses on
    the rows of a rung, and are kept on the next level: the first curvatures are along the
    coordinates, later ones are BFGS updates. A candidate that continues alone has its Hessian
    measured: the best of a rung at once, others before they count as converged. If no step helps,
    as at a kink, a Nelder-Mead simplex takes over, and steps continue if it makes progress.

    Parameters
    ----------
    eta, rows_per_parameter, full_data_share, max_rows_per_parameter : optional
        Candidates that continue, and rows of each level, as in `MIHOGN`. A problem with an unknown
        number of rows has one level.
    base_cost, max_cost, min_candidates, max_candidates : optional
        Cost of a rung, and number of starting points of a bracket, as in `MIHOGN`.
    steps_per_rung, leader_steps, max_step, tolerance, level_tolerance : optional
        Steps of a candidate, and their end, as in `MIHOGN`.
    patience, min_progress, max_brackets : optional
        End of a descent without progress, and of the search, as in `MIHOGN`.
    max_predicted_steps : int, optional
        Largest number of consecutive steps with predicted instead of measured slopes.
    hessian_interval : float, optional
        A Hessian is measured again if a step was not as predicted, after this multiple of its cost.
    simplex_edge : float, optional
        Edges of a simplex, as a share of the widths.
    simplex_budget : int, optional
        Evaluations of a simplex for each parameter, at most.

    Raises
    ------
    ValueError
        If a setting is not possible.

    Examples
    --------
    >>> import miho
    >>> class Bowl(miho.Problem):
    ...     name = "bowl"
    ...     space = miho.Space((miho.Parameter("a", "m", -5, 5), miho.Parameter("b", "m", -5, 5)))
    ...     def loss(self, thetas, fidelity=1.0):
    ...         return ((thetas - [1, 2]) ** 2).sum(axis=1)
    >>> miho.minimize(miho.MIHOQN(), Bowl()).theta.round(4)
    array([1., 2.])
    """

    leader_steps: int = 60
    max_step: float = 0.5
    tolerance: float = 1e-9
    patience: float = 8.0
    max_predicted_steps: int = 3
    hessian_interval: float = 1.0
    simplex_edge: float = 0.02
    simplex_budget: int = 30

    def __post_init__(self) -> None:
        check_brackets(self)
        whole_settings(self, ("max_predicted_steps", "simplex_budget"), 0)
        positive_settings(self, ("hessian_interval", "simplex_edge"))

    def init(self, space: Space, rng: np.random.Generator) -> MIHOQNState:
        """State before the first batch, for a problem without cheaper approximations."""
        return self._begin(space, rng, (0,), (1.0,), Starts(brackets=True))

    def start(self, oracle: Oracle, rng: np.random.Generator) -> MIHOQNState:
        """State before the first batch."""
        space, N = oracle.space, oracle.traits.rows
        level_rows: tuple[int, ...] = (0,)
        level_costs: tuple[float, ...] = (1.0,)
        if N is not None:
            level_rows = self.rows_by_level(N, len(space))
            level_costs = tuple(oracle.traits.cost(m / N) for m in level_rows)
            if level_costs[0] >= 1.0:  # fewer rows cost the same
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
        """State with the starts of the first bracket."""
        no_points = np.empty((0, len(space)))
        candidates, box = QNCandidates.at(no_points, self.max_step), QNBox.of(space)
        state = MIHOQNState(
            space, box, rng, level_rows, level_costs, candidates, minima=no_points, starts=starts
        )
        self._proceed(state)
        return state

    def done(self, state: MIHOQNState) -> bool:
        """Whether the brackets are evidence enough, or their largest number is reached."""
        return state.finished

    def fidelity(self, state: MIHOQNState) -> float:
        """Share of the rows that the level uses."""
        return 1.0 if state.last else state.rows / state.level_rows[-1]

    def ask(self, state: MIHOQNState) -> Array:
        """Points whose losses the candidates of the rung need next."""
        return state.space.decode(state.batch)

    def tell(self, state: MIHOQNState, thetas: Array, losses: Array) -> None:
        """Pass the losses on to the candidates, and determine the next points."""
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
        """Rules of steps in this phase, on this level."""
        level_tolerance = self.level_tolerance * state.d / max(state.rows, 1)
        return QNRules(
            cost=state.cost,
            tolerance=self.tolerance if state.last else level_tolerance,
            last=state.last,
            screens=state.phase == SCREEN,
            measures=state.phase in (LEAD, FINISH, REVIVE),
            refresh=self.hessian_interval,
            guesses=self.max_predicted_steps,
            radius=self.max_step,
            rounding=state.starts.rounding,
        )

    def _watch(self, state: MIHOQNState) -> None:
        """Stop a candidate that continues alone if it stalls or has reached a known minimum."""
        c = state.candidates
        if c.stage[0] >= WAIT:
            return
        if state.phase != LEAD and at_known(state, c)[0]:
            c.stage[0] = WAIT
        elif c.spent_since_mark[0] >= self.patience * (state.d + 1) * state.cost:
            stalls = c.loss_at_mark[0] - c.loss[0] < self.min_progress * abs(c.loss_at_mark[0])
            if stalls and (
                state.phase != REVIVE or state.spent - state.spent_before >= state.allowance
            ):
                c.stage[0] = WAIT
            c.spent_since_mark[0], c.loss_at_mark[0] = 0.0, c.loss[0]

    # The phases of a bracket.

    def _proceed(self, state: MIHOQNState) -> None:
        """Move through the phases until losses are needed."""
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
                if simplex.done or simplex.evaluations >= self.simplex_budget * state.d:
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
        """Begin a bracket: draw its starts, to be evaluated on the first level."""
        state.bracket += 1
        state.level, state.spent_before, state.phase = 0, state.spent, SCREEN
        state.rung_budget, n = self.sizes(state.bracket, state.d, state.cost)
        z = draw_starts(state.space, n, state.rng, state.bracket)
        state.starts.screened += n
        state.candidates = QNCandidates.at(z, self.max_step)

    def _after_screen(self, state: MIHOQNState) -> None:
        """Keep the best starts."""
        state.candidates = state.candidates.usable
        self._rung(state)

    def _rung(self, state: MIHOQNState) -> None:
        """Give the best candidates their steps on this level; a single one has no limit."""
        size = len(state.candidates)
        if not size:
            self._close(state)
            return
        affordable = max(state.rung_budget / (self.steps_per_rung * (state.d + 2) * state.cost), 1)
        n = int(min(affordable, max(1, size / self.eta)))
        state.candidates = state.candidates.first(n)
        alone = state.last and len(state.candidates) == 1
        state.phase = FINISH if alone else RUNG
        state.candidates.go_on(UNLIMITED if alone else self.steps_per_rung)

    def _after_rung(self, state: MIHOQNState) -> None:
        """Give the best candidate more steps, and measure its Hessian if it never was."""
        if not self._prune(state):
            return
        c = state.candidates
        if state.last:
            self._rung(state)
            return
        state.phase = LEAD
        c.go_on(self.leader_steps, slice(1))
        if c.stage[0] in (SLOPE, DONE) and math.isinf(c.hessian_age[0]):
            c.stage[0] = HESSIAN

    def _after_lead(self, state: MIHOQNState) -> None:
        """Continue with all candidates of the rung on more rows."""
        if self._prune(state):
            state.level += 1
            c = state.candidates
            c.radius = np.maximum(c.radius, REENTRY)
            c.stage[:] = LOOK
            self._rung(state)

    def _prune(self, state: MIHOQNState) -> bool:
        """Drop candidates that lead to known minima or are copies; false if the bracket ends.

        It ends if its best candidate is at a known minimum: worse candidates on the same rows would
        cost more than the next bracket.
        """
        state.candidates = c = state.candidates.usable
        returns = at_known(state, c)
        if not len(c) or returns[0]:
            if len(c):
                self._record_return(state)
            self._close(state)
            return False
        c = c.take(np.flatnonzero(~returns))
        state.candidates = c.take(distinct(state, c))
        return True

    def _after_finish(self, state: MIHOQNState) -> None:
        """Revive the best candidate that stalled in an earlier bracket, if there is one.

        It may use as much as this bracket.
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
        """Record the end of a revived candidate, as the end of a bracket."""
        if self._record_end(state):
            self._close(state)

    def _record_end(self, state: MIHOQNState) -> bool:
        """Record the end of a bracket's last candidate: new, known, stalled or unusable.

        Returns false if it continues with a simplex, because it is stuck or may be at a kink.
        """
        c = state.candidates
        stage = int(c.stage[0])
        size = max(abs(c.loss[0]), state.starts.rounding)
        sharp = (diagonal(c.B[:1]) * SHARP**2 > size).any()
        at_minimum = (np.abs(state.minima_losses - c.loss[0]) <= NEAR_LAST * size).any()
        if (stage == STUCK or (stage == DONE and sharp)) and not (at_minimum or state.polished):
            centre = state.box.shares(c.z[0])
            state.simplex = Simplex.around(centre, float(c.loss[0]), self.simplex_edge)
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
        """Continue from the best corner of the simplex, if it made progress."""
        c = state.candidates
        x, loss = simplex.best
        state.simplex = None
        gain = c.loss[0] - loss
        c.z[0] = c.measured_at[0] = state.box.at(x)
        c.loss[0] = loss
        state.polished = gain <= LITTLE * abs(loss)
        if not state.polished:
            c.stage[0], c.failures[0], c.radius[0] = WAIT, 0, max(c.radius[0], REENTRY)
            if gain >= self.min_progress * abs(loss):
                c.go_on(UNLIMITED)

    def _record_return(self, state: MIHOQNState) -> None:
        """Record that the best candidate of a bracket has come to the nearest known minimum."""
        c = state.candidates
        rise = c.rise(slice(1), offsets_from(state, state.minima, c.z[:1]))
        nearest = np.argmin(rise[0])
        place = state.space.decode(state.minima[nearest : nearest + 1])[0]
        state.starts.add(math.inf, float(state.minima_losses[nearest]), theta=place)

    def _close(self, state: MIHOQNState) -> None:
        """Close the bracket, and end the search if the ends of brackets are evidence enough."""
        state.phase = CLOSED
        enough = state.starts.agreement(state.best).enough
        state.finished = enough or state.bracket >= self.max_brackets
        state.starts.exhausted = state.finished and not enough
