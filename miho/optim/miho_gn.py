"""Hyperband over Gauss-Newton steps on growing data."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from miho.compiled.gauss_newton_candidates import (
    AT_KNOWN,
    COPY_LOSS,
    DONE,
    UNUSABLE,
    GNBox,
    GNCandidates,
    GNRules,
    Minima,
)
from miho.optim.brackets import (
    CLOSED,
    DRAWS,
    FINISH,
    LEAD,
    POLISH,
    REVIVE,
    RUNG,
    SCREEN,
    UNLIMITED,
    check_brackets,
    draw_starts,
    luby,
    rows_by_level,
)
from miho.optim.evidence import in_optimum
from miho.optim.meter import Budget, UnusableValueError
from miho.optim.miho_gn_state import MIHOGNState, box_of, square_distances, usable
from miho.optim.optimizer import Resumable
from miho.optim.oracle import Oracle
from miho.optim.problem import LeastSquaresProblem, Problem
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.validate import one_of, positive_settings, whole, whole_settings

NEAR, NEAR_LAST = 9.0, 0.1
"""A candidate is at a known minimum within this squared distance, in shares of its sum of squares
and units of d / rows: the first is 3 standard deviations. On all rows it is at most the second, a
share alone."""
BETTER = 4.0
"""But not if its loss is lower than there by so many d / rows: more than fewer rows may explain."""
ENTERING = 1e-3
"""The largest damping at the start of a level, for a candidate that was done on the one before."""
SOLVED_FIRST = 9
"""A problem that is linear in all parameters is solved on one row in so many, then on all."""
POLISHING = 50
"""Steps for more digits at most: in a narrow valley they would go on for long."""
ATTEMPTS = 1000
"""Looks for a usable configuration of a problem that does not say how many rows it has."""


@dataclass(frozen=True)
class MIHOGN(Resumable[MIHOGNState]):
    """Brackets of successive halving whose survivors descend, on ever more rows of the data.

    A bracket looks at configurations on the first rows of the data, `rows` for each parameter, and
    keeps the best. Each rung gives its candidates `steps` Levenberg-Marquardt steps, the best of
    them up to `lead`, and hands the best one in `eta` on to the next, with `eta` times as many
    rows, until the last candidate goes to its end on all rows. A level that would have more than
    the share `jump` of all rows has all of them; so has one after more than `enough` rows for each
    parameter, and so have all levels of a problem that cannot be evaluated on fewer. A rung costs
    about `base` (d + 1) evaluations times Luby's sequence, at most `largest` (d + 1); a bracket
    begins with `least` to `most` configurations.

    Steps are damped by `damping` at first, and no longer than `reach` of the widths. A descent is
    done where its linear model predicts a gain below the share `tolerance` of the loss; on m rows,
    fewer than all, below `level_tolerance` d / m, which so few do not tell from noise. Up to
    `secants` steps running update the derivatives (Broyden) instead of evaluating them. One bracket
    in `projecting` (0: none) solves for the linear parameters at each look (variable projection).
    `draws` is the distribution of starts, see `draw_starts`. A descent that gains less than the
    share `progress` of its loss in `patience` (d + 1) evaluations is set aside; the best of those
    may spend as much as the next bracket has. A descent that comes to a known minimum ends.

    The search ends when the ends of its brackets are evidence enough (`miho.optim.evidence`).
    Searches get stuck at bounds, where the data leave a parameter undetermined, and where the loss
    is more than noise explains: such an optimum needs the ends of `doubtful` brackets, and a search
    `longer` times as long as it took to find it. After `brackets` brackets the search ends in any
    case, as `Outcome.BRACKETS`. At last it descends from the run's best to a tolerance of `digits`.
    A problem that is linear in all parameters is solved.

    Needs a least-squares problem. Uses residuals and derivatives of its first rows, if it can give
    them, and compiled ones, if it has them.
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
    lead: int = 20
    damping: float = 0.1
    reach: float = 0.25
    secants: int = 4
    projecting: int = 2
    draws: str = "thirds"
    tolerance: float = 1e-8
    level_tolerance: float = 0.1
    digits: float = 1e-16
    patience: float = 4.0
    progress: float = 0.05
    doubtful: int = 20
    longer: float = 10.0
    brackets: int = 200

    def __post_init__(self) -> None:
        check_brackets(self)
        whole("doubtful", self.doubtful, 1)
        whole_settings(self, ("secants", "projecting"), 0)
        one_of("draws", self.draws, DRAWS)
        positive_settings(self, ("damping", "reach", "digits", "longer"))

    def start(self, oracle: Oracle, rng: np.random.Generator) -> MIHOGNState:
        """The state before the first look."""
        space, N = oracle.space, oracle.rows
        box = box_of(space, oracle.linear)
        level_rows: tuple[int, ...] = (0,)
        if N is not None:
            level_rows = self._levels(N, box)
            if oracle.cost(level_rows[0] / N) >= 1:  # fewer rows are not cheaper
                level_rows = level_rows[-1:]
        oracle.meter.starts.brackets = True
        no_points = np.empty((0, len(space)))
        return MIHOGNState(
            space,
            box,
            rng,
            np.array(level_rows),
            _has_rows(oracle),
            oracle.jacobian_cost,
            candidates=GNCandidates.at(no_points, len(level_rows), self.damping, False),
            minima=no_points,
            minima_losses=np.empty(0),
            minima_sums=np.empty((0, len(level_rows))),
            determined=np.empty(0, bool),
        )

    def _levels(self, N: int, box: GNBox) -> tuple[int, ...]:
        d = box.low.size
        if not box.nonlinear.size:
            first = max(math.ceil(N / SOLVED_FIRST), d + 1)
            return (first, N) if first < N else (N,)
        return rows_by_level(
            N, d, per_parameter=self.rows, eta=self.eta, jump=self.jump, enough=self.enough
        )

    def done(self, state: MIHOGNState) -> bool:
        """After brackets whose ends are evidence enough, or after the last."""
        return state.finished

    def step(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Make the evaluations of one phase, and go on to the next."""
        if not state.level_rows[-1]:
            self._count_rows(state, oracle)
            return
        if state.phase == CLOSED:
            self._draw(state, oracle)
        if (state.candidates.stage < DONE).any():
            from miho.optim.gauss_newton_steps import give_steps  # which needs numba

            # Only determined minima end a descent: elsewhere it may come past and go on.
            ending = state.determined & (state.phase != POLISH)
            minima = Minima(state.minima[ending], state.level_losses[ending])
            rules = self._rules(state, oracle)
            give_steps(oracle, state.candidates, state.box, state.level_rows, minima, rules)
        phases = {
            SCREEN: self._after_screen,
            RUNG: self._after_rung,
            LEAD: self._after_lead,
            FINISH: self._after_finish,
            REVIVE: self._after_revival,
            POLISH: self._after_polish,
        }
        phases[state.phase](state, oracle)

    def rehearsals(
        self, problem: Problem, toy: LeastSquaresProblem, theta: Array
    ) -> Sequence[Callable[[], object]]:
        """A first bracket of a compiled problem; else residuals, derivatives and the toy.

        The toy is not compiled: with it, a compiled problem would have other steps compiled too.
        """

        def rehearse() -> None:
            oracle = Oracle(problem, Budget(evaluations=len(theta) + 2))
            from miho.compiled.gauss_newton import distinct

            nobody = GNCandidates.at(np.empty((0, len(theta))), 1, self.damping, False)
            distinct(nobody, box_of(oracle.space, oracle.linear))
            if _has_rows(oracle):
                self.run(oracle, stream())
                return
            # The toy is linear in all, and over before the second bracket, which would project.
            toy.linear = oracle.linear
            projects = replace(self, projecting=1)
            for method in (self, projects) if oracle.linear else (self,):
                for job in super(MIHOGN, method).rehearsals(problem, toy, theta):
                    with contextlib.suppress(Exception):
                        job()

        return [lambda: problem.noise, rehearse]

    @property
    def uncompiled(self) -> bool:
        """Whether the steps are not in numba's cache."""
        from miho.compiled.gauss_newton_loop import advance
        from miho.compiled.triangular import in_cache

        return not in_cache(advance)

    def _count_rows(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Look once at all residuals of a problem that does not say how many there are."""
        theta = state.space.decode(state.space.initial(state.attempts + 1))[-1]
        with contextlib.suppress(UnusableValueError):
            state.level_rows[:] = oracle.residuals(theta).size
        state.attempts += 1
        state.finished = not state.level_rows[-1] and state.attempts == ATTEMPTS

    def _rules(self, state: MIHOGNState, oracle: Oracle) -> GNRules:
        """What the candidates of this phase may do."""
        share = state.d / state.rows  # of a loss, which so many rows do not tell from noise
        alone = state.phase in (LEAD, FINISH, REVIVE)
        polishes = state.phase == POLISH
        steps = {
            SCREEN: 0,
            RUNG: self.steps,
            LEAD: self.lead - self.steps,
            POLISH: POLISHING,
        }
        tolerance = self.digits if polishes else self.tolerance
        return GNRules(
            level=state.level,
            last=state.last,
            steps=steps.get(state.phase, UNLIMITED),
            reach=self.reach,
            secants=self.secants,
            tolerance=tolerance if state.last else self.level_tolerance * share,
            patience=int(self.patience * (state.d + 1) * state.rows) if alone else 0,
            allowance=state.allowance if state.phase == REVIVE else 0,
            progress=self.progress,
            near=min(NEAR * share, NEAR_LAST) if state.last else NEAR * share,
            better=0.0 if state.last else BETTER * share,
            rounding=0.0 if polishes else oracle.rounding,
        )

    # The phases of a bracket.

    def _draw(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Begin a bracket: draw its starts, to be looked at on the first level."""
        state.bracket += 1
        state.projects = state.linear or self._projects(state)
        state.rung_budget = (state.d + 1) * min(self.base * luby(state.bracket), self.largest)
        state.level, state.phase, state.spent_before = 0, SCREEN, oracle.evaluations
        n = min(max(round(state.rung_budget / state.look_cost), self.least), self.most)
        n = 1 if state.linear else n
        starts = draw_starts(state.space, n, state.rng, state.bracket == 1, self.draws)
        oracle.record_screened(n * (not state.linear))
        x = (starts - state.box.origin) / state.box.width
        state.candidates = GNCandidates.at(x, state.level_rows.size, self.damping, state.projects)
        state.make_room()

    def _projects(self, state: MIHOGNState) -> bool:
        every = self.projecting and state.bracket % self.projecting == 0
        return bool(every and state.box.linear.size)

    def _after_screen(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Keep the best starts; a linear problem is solved already, so look on more rows."""
        state.candidates = usable(state.candidates)
        if not state.linear:
            self._rung(state, oracle, entering=False)
        elif not state.candidates.loss.size:
            self._close(state, oracle)
        elif state.last:
            state.finished = True  # solved: nothing descended, and nothing has to agree
        else:
            state.level += 1
            self._enter(state)

    def _rung(self, state: MIHOGNState, oracle: Oracle, entering: bool) -> None:
        """Give the best candidates their steps on this level; the last one, all that it needs."""
        size = state.candidates.loss.size
        if not size:
            self._close(state, oracle)
            return
        affordable = max(state.rung_budget / (self.steps * state.step_cost), 1)
        n = int(min(affordable, max(1, size // self.eta)))
        state.candidates = state.candidates.take(slice(n))
        if entering:
            self._enter(state)
        state.begin(FINISH if state.last and n == 1 else RUNG)

    def _enter(self, state: MIHOGNState) -> None:
        """Have the candidates evaluated on the rows of the next level."""
        c = state.candidates
        done = c.stage == DONE
        c.projects[:] = state.projects & (state.linear | ~done | (not state.last))
        c.damping[done] = np.minimum(c.damping[done], ENTERING)
        state.look_again()

    def _after_rung(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Give the best one more steps, while the others wait."""
        state.candidates = usable(state.candidates)
        if state.last or not state.candidates.loss.size:
            self._prune(state, oracle)
            return
        state.waiting = state.candidates.take(slice(1, None))
        state.candidates = state.candidates.take(slice(1))
        state.begin(LEAD)

    def _after_lead(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Go on with all of the rung."""
        if state.waiting is not None:
            state.candidates, state.waiting = usable(state.candidates.joined(state.waiting)), None
        self._prune(state, oracle)

    def _prune(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Go on, on more rows, with the candidates that may lead to a minimum that is not known."""
        c = state.candidates
        least = float(state.level_losses.min(initial=math.inf))
        ended = (c.stage == AT_KNOWN) | ((c.stage == DONE) & (c.loss >= least))
        if ended.all():
            if c.loss.size:
                self._record_return(state, oracle)
            self._close(state, oracle)
            return
        from miho.compiled.gauss_newton import distinct

        c = c.take(~ended)
        state.candidates = c.take(distinct(c, state.box))
        entering = not state.last
        state.level += entering
        self._rung(state, oracle, entering)

    def _after_finish(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Revive the best candidate that stalled in an earlier bracket, if there is any.

        It may spend as much as this bracket has.
        """
        earlier = state.stalled.copy()
        self._record_end(state, oracle)
        self._close(state, oracle)
        if earlier and state.phase == CLOSED:
            best = min(range(len(earlier)), key=lambda k: float(earlier[k].loss[0]))
            state.candidates = state.stalled.pop(best)
            state.look_again()
            spent = oracle.evaluations - state.spent_before
            state.allowance = int(spent * int(state.level_rows[-1]))
            state.begin(REVIVE)

    def _after_revival(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Record its end, as that of a bracket."""
        self._record_end(state, oracle)
        self._close(state, oracle)

    def _record_end(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Record how the last candidate of a bracket has ended: known, new, stalled or unusable."""
        c = state.candidates
        loss = float(c.loss[0])
        if c.stage[0] == AT_KNOWN:
            self._record_return(state, oracle)
        elif c.stage[0] == DONE:
            oracle.record_descent(math.inf, loss)
            best = float(state.minima_losses.min(initial=math.inf))
            if loss < best or not in_optimum(best, loss, oracle.resolution):
                if not in_optimum(loss, best, oracle.resolution):
                    state.best_found_after = oracle.evaluations
                state.add_minimum(c)
        elif c.stage[0] != UNUSABLE:
            state.stalled.append(c.with_room_for(0))

    def _record_return(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Record the end of a bracket whose best candidate leads to nothing new.

        It came to a known minimum, or is done and no better than one. On fewer rows than all, one
        that is done is at a minimum that the data do not determine if it is near it, as far as
        these rows can tell; else it is not known where it would have ended on all rows.
        """
        c, rules = state.candidates, self._rules(state, oracle)
        loss = float(c.loss[0])
        if state.last and c.stage[0] == DONE:
            oracle.record_descent(math.inf, loss)
            return
        distances = square_distances(c, state.minima, state.box)
        matches = loss >= (1 - rules.better) * state.level_losses
        if c.stage[0] == AT_KNOWN:
            matches &= state.determined
        else:
            matches &= ~state.determined & (loss <= (1 + COPY_LOSS) * state.level_losses)
            matches &= distances <= rules.near * loss * state.rows
        if matches.any():
            nearest = np.argmin(np.where(matches, distances, math.inf))
            oracle.record_descent(math.inf, float(state.minima_losses[nearest]))
        else:
            oracle.record_dropped()

    def _close(self, state: MIHOGNState, oracle: Oracle) -> None:
        """End the bracket, and the search if the ends of its brackets are evidence enough."""
        state.phase = CLOSED
        agreement = oracle.agreement
        # A doubtful optimum asks for more ends, and for a longer search.
        long_enough = oracle.evaluations >= self.longer * state.best_found_after
        confirmed = long_enough and agreement.agreeing >= self.doubtful
        enough = agreement.enough and (confirmed or self._plausible(state, oracle))
        if enough or state.bracket >= self.brackets:
            oracle.meter.starts.exhausted = not enough
            self._polish(state, oracle)

    def _plausible(self, state: MIHOGNState, oracle: Oracle) -> bool:
        """Whether the data determine the best minimum so far, and noise explains its loss."""
        best = int(np.argmin(state.minima_losses))
        return bool(state.determined[best] and state.minima_losses[best] <= oracle.noise)

    def _polish(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Descend from the run's best for more digits than it took to tell minima apart."""
        state.finished = not math.isfinite(oracle.best)
        if state.finished:
            return
        best = state.space.encode(oracle.trace.theta[-1][None])
        x = np.clip((best - state.box.origin) / state.box.width, 0.0, 1.0)
        state.level = state.level_rows.size - 1
        state.candidates = GNCandidates.at(x, state.level_rows.size, ENTERING, False)
        state.make_room()
        state.begin(POLISH)

    def _after_polish(self, state: MIHOGNState, oracle: Oracle) -> None:
        """End the search."""
        state.finished = True


def _has_rows(oracle: Oracle) -> bool:
    """Whether residuals and derivatives are compiled."""
    return oracle.kernel is not None and oracle.kernel.rows is not None
