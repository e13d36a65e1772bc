"""Hyperband over Gauss-Newton steps on growing data."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from miho.compiled.gauss_newton_state import (
    COPY_LOSS,
    DONE,
    ENTER,
    KNOWN,
    UNUSABLE,
    Box,
    Candidates,
    Minima,
    Rules,
)
from miho.optim.brackets import DRAWS, check_brackets, draw_starts, levels, luby
from miho.optim.evidence import in_optimum
from miho.optim.meter import Budget, UnusableValueError
from miho.optim.miho_gn_state import (
    CLIMB,
    FINISH,
    LEAD,
    OVER,
    POLISH,
    SCREEN,
    SHARE,
    MIHOGNState,
    box_of,
    sound,
    square_distances,
    usable,
)
from miho.optim.optimizer import Resumable
from miho.optim.oracle import Oracle
from miho.optim.problem import LeastSquaresProblem, Problem
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.validate import one_of, positive_settings, whole, whole_settings

ALONE = 1 << 40
"""Steps of a configuration that goes on as long as it makes progress."""
NEAR, NEAR_LAST = 9.0, 0.1
"""At a known minimum within 3 standard deviations: squared, in units of d / rows of the loss; on
all rows the second, if it is less."""
BETTER = 4.0
"""But not if its loss is lower than there by so many d / rows: more than a few rows may tell."""
ENTERING = 1e-3
"""The damping with which one begins a level that was done with the one before."""
SOLVED_FIRST = 9
"""A problem that is linear in all parameters is solved on one row in so many, then on all."""
ROOM = 1 << 22
"""Numbers that the derivatives of a rung may hold; beyond, each step pays for its own, and where
nothing is compiled for the residuals again."""
POLISHING = 50
"""Steps for more digits at most: valleys have no end."""
TRIALS = 1000
"""Looks for one usable configuration of a problem that does not say how many rows it has."""


@dataclass(frozen=True)
class MIHOGN(Resumable[MIHOGNState]):
    """Brackets of successive halving in which what survives has descended, on ever more rows.

    A bracket looks at configurations on the first rows of the data, `rows` for each parameter, and
    keeps the best. Each rung gives the survivors `steps` Levenberg-Marquardt steps, its best one up
    to `lead`, and `eta` times as many rows, until the last one goes to its end on all rows. A level
    with more than the share `jump` of all rows, or after `enough` rows for each parameter, is all
    of them; so are all levels of a problem that gives no fewer. Brackets have rungs of `base`
    (d + 1) evaluations times Luby's sequence, at most `largest`; `least` to `most` configurations.

    Steps are damped by `damping` at first, no longer than `reach` of the widths, and over where
    they promise less than `tolerance` of the loss; on fewer rows, m of them, `level_tolerance`
    d / m, which m rows cannot tell. Up to `secants` steps running take Broyden's derivatives. One
    bracket in `projecting` (0: none) solves for the linear parameters at each look (variable
    projection). `draws` says how starts are drawn, see `draw_starts`. A descent that gains less
    than the share `progress` of its loss in `patience` (d + 1) evaluations is set aside; the best
    of those gets as much as the next bracket has spent. What comes to a known minimum ends.

    The search ends when the ends of its brackets are evidence enough (`miho.optim.evidence`).
    Searches get stuck at bounds, where the data leave a parameter open in all of its range, and
    where the loss is more than their noise explains: at such an optimum `doubtful` brackets must
    have ended, in a search that has become `longer` times as long as when it was found. `brackets`
    are the most: a search that makes them all ends as `Outcome.BRACKETS`. Then the run's best is
    descended from to a tolerance of `digits`. A problem that is linear in all parameters is solved.

    Needs a least-squares problem; of its residuals and derivatives those of the first rows, if it
    gives them, and compiled, if it has them.
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
        ends: tuple[int, ...] = (0,)
        if N is not None:
            ends = self._levels(N, box)
            if oracle.cost(ends[0] / N) >= 1:  # fewer rows are not cheaper
                ends = ends[-1:]
        oracle.meter.starts.brackets = True
        none = np.empty((0, len(space)))
        return MIHOGNState(
            space,
            box,
            rng,
            np.array(ends),
            _has_rows(oracle),
            oracle.jacobian_cost,
            live=Candidates.at(none, len(ends), self.damping, False),
            minima=none,
            losses=np.empty(0),
            sums=np.empty((0, len(ends))),
            sound=np.empty(0, bool),
        )

    def _levels(self, N: int, box: Box) -> tuple[int, ...]:
        d = box.low.size
        if not box.nonlinear.size:
            first = max(math.ceil(N / SOLVED_FIRST), d + 1)
            return (first, N) if first < N else (N,)
        return levels(
            N, d, per_parameter=self.rows, eta=self.eta, jump=self.jump, enough=self.enough
        )

    def done(self, state: MIHOGNState) -> bool:
        """After brackets whose ends are evidence enough, or after the last."""
        return state.over

    def step(self, state: MIHOGNState, oracle: Oracle) -> None:
        """The evaluations of one phase, and what follows from them."""
        if not state.ends[-1]:
            self._count_rows(state, oracle)
            return
        if state.phase == OVER:
            self._draw(state, oracle)
        if (state.live.stage < DONE).any():
            from miho.optim.steps import give_steps  # which needs numba

            known = state.sound & (state.phase != POLISH)
            minima = Minima(state.minima[known], state.level_losses[known])
            rules = self._rules(state, oracle)
            give_steps(oracle, state.live, state.box, state.ends, minima, rules)
        phases = {
            SCREEN: self._screened,
            CLIMB: self._climbed,
            LEAD: self._led,
            FINISH: self._finished,
            SHARE: self._shared,
            POLISH: self._polished,
        }
        phases[state.phase](state, oracle)

    def rehearsals(
        self, problem: Problem, toy: LeastSquaresProblem, theta: Array
    ) -> Sequence[Callable[[], object]]:
        """A first bracket, where the problem is compiled: the toy, which is not, would make all
        compile a second time. Else residuals, derivatives and the toy."""

        def rehearse() -> None:
            oracle = Oracle(problem, Budget(evaluations=len(theta) + 2))
            from miho.compiled.gauss_newton import distinct

            none = Candidates.at(np.empty((0, len(theta))), 1, self.damping, False)
            distinct(none, box_of(oracle.space, oracle.linear))
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
        from miho.compiled.advance import advance
        from miho.compiled.triangular import in_cache

        return not in_cache(advance)

    def _count_rows(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Look once at all residuals of a problem that does not say how many there are."""
        theta = state.space.decode(state.space.initial(state.tried + 1))[-1]
        with contextlib.suppress(UnusableValueError):
            state.ends[:] = oracle.residuals(theta).size
        state.tried += 1
        state.over = not state.ends[-1] and state.tried == TRIALS

    def _rules(self, state: MIHOGNState, oracle: Oracle) -> Rules:
        """What the configurations of this phase may do."""
        share, alone = state.d / state.rows, state.phase in (LEAD, FINISH, SHARE)
        polishes = state.phase == POLISH
        steps = {
            SCREEN: 0,
            CLIMB: self.steps,
            LEAD: self.lead - self.steps,
            POLISH: POLISHING,
        }
        tolerance = self.digits if polishes else self.tolerance
        return Rules(
            level=state.level,
            last=state.last,
            steps=steps.get(state.phase, ALONE),
            reach=self.reach,
            secants=self.secants,
            tolerance=tolerance if state.last else self.level_tolerance * share,
            patience=int(self.patience * (state.d + 1) * state.rows) if alone else 0,
            share=state.share if state.phase == SHARE else 0,
            progress=self.progress,
            near=min(NEAR * share, NEAR_LAST) if state.last else NEAR * share,
            better=0.0 if state.last else BETTER * share,
            nothing=0.0 if polishes else oracle.rounding,
        )

    # The phases of a bracket.

    def _draw(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Begin a bracket."""
        state.bracket += 1
        state.projects = state.linear or self._projects(state)
        state.size = (state.d + 1) * min(self.base * luby(state.bracket), self.largest)
        state.level, state.phase, state.begun = 0, SCREEN, oracle.evaluations
        n = min(max(round(state.size / state.look_cost), self.least), self.most)
        n = 1 if state.linear else n
        starts = draw_starts(state.space, n, state.rng, state.bracket == 1, self.draws)
        oracle.screened(n * (not state.linear))
        x = (starts - state.box.origin) / state.box.width
        state.live = Candidates.at(x, state.ends.size, self.damping, state.projects)
        self._make_room(state)

    def _projects(self, state: MIHOGNState) -> bool:
        every = self.projecting and state.bracket % self.projecting == 0
        return bool(every and state.box.linear.size)

    def _screened(self, state: MIHOGNState, oracle: Oracle) -> None:
        state.live = usable(state.live)
        if not state.linear:
            self._rung(state, oracle, entering=False)
        elif not state.live.loss.size:
            self._close(state, oracle)
        elif state.last:
            state.over = True  # solved: nothing descended, and nothing has to agree
        else:
            state.level += 1
            self._enter(state)

    def _rung(self, state: MIHOGNState, oracle: Oracle, entering: bool) -> None:
        """Give the best of the live ones their steps on this level; the last one, all it needs."""
        before = state.live.loss.size
        if not before:
            self._close(state, oracle)
            return
        n = min(max(state.size / (self.steps * state.step_cost), 1), max(1, before // self.eta))
        state.live = state.live.take(slice(int(n)))
        if entering:
            self._enter(state)
        self._begin(state, FINISH if state.last and int(n) == 1 else CLIMB)

    def _enter(self, state: MIHOGNState) -> None:
        """Look at the live ones anew, on the rows of another level."""
        c = state.live
        done = c.stage == DONE
        c.projects[:] = state.projects & (state.linear | ~done | (not state.last))
        c.damping[done] = np.minimum(c.damping[done], ENTERING)
        self._look_again(state)

    def _look_again(self, state: MIHOGNState) -> None:
        """Have the residuals and derivatives of the live ones evaluated where they are."""
        c = state.live
        c.loss[:] = c.gain[:] = np.inf
        c.stage[:], c.growth[:], c.secants[:], c.trial[:] = ENTER, 2.0, 0, c.x
        self._make_room(state)

    def _begin(self, state: MIHOGNState, phase: int) -> None:
        c = state.live
        c.steps[:] = c.spent[:] = c.mark[:] = 0
        c.marked[:] = c.loss
        state.phase = phase

    def _climbed(self, state: MIHOGNState, oracle: Oracle) -> None:
        state.live = usable(state.live)
        if state.last or not state.live.loss.size:
            self._prune(state, oracle)
            return
        state.rest = state.live.take(slice(1, None))
        state.live = state.live.take(slice(1))
        self._begin(state, LEAD)

    def _led(self, state: MIHOGNState, oracle: Oracle) -> None:
        if state.rest is not None:
            state.live, state.rest = usable(state.live.beside(state.rest)), None
        self._prune(state, oracle)

    def _prune(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Go on with what may lead to something new, on more rows."""
        c = state.live
        over = (c.stage == KNOWN) | ((c.stage == DONE) & (c.loss >= self._best(state)))
        if over.all():
            if c.loss.size:
                self._returned(state, oracle, c)
            self._close(state, oracle)
            return
        from miho.compiled.gauss_newton import distinct

        c = c.take(~over)
        state.live = c.take(distinct(c, state.box))
        entering = not state.last
        state.level += entering
        self._rung(state, oracle, entering)

    def _finished(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Give what crawls as much as this bracket has spent, if there is any from before."""
        earlier = state.aside.copy()
        self._settle(state, oracle)
        self._close(state, oracle)
        if earlier and state.phase == OVER:
            best = min(range(len(earlier)), key=lambda k: float(earlier[k].loss[0]))
            state.live = state.aside.pop(best)
            self._look_again(state)
            state.share = int((oracle.evaluations - state.begun) * int(state.ends[-1]))
            self._begin(state, SHARE)

    def _shared(self, state: MIHOGNState, oracle: Oracle) -> None:
        self._settle(state, oracle)
        self._close(state, oracle)

    def _settle(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Keep what became of the last one of a bracket."""
        c = state.live
        loss = float(c.loss[0])
        if c.stage[0] == KNOWN:
            self._returned(state, oracle, c)
        elif c.stage[0] == DONE:
            oracle.ended(math.inf, loss)
            best = float(state.losses.min(initial=math.inf))
            if loss < best or not in_optimum(best, loss, oracle.resolution):
                sums = c.sums if c.sums[0, -1] > 0 else loss * state.ends[None]
                if not in_optimum(loss, best, oracle.resolution):
                    state.found = oracle.evaluations
                state.minima = np.vstack([state.minima, c.x])
                state.losses = np.append(state.losses, loss)
                state.sums = np.vstack([state.sums, sums])
                state.sound = np.append(state.sound, sound(c, state.box, state.rows))
        elif c.stage[0] != UNUSABLE:
            state.aside.append(c.with_rows(0))

    def _returned(self, state: MIHOGNState, oracle: Oracle, c: Candidates) -> None:
        """The best of a bracket has come to a known minimum, or is done and no better.

        What is done on fewer rows than all has come to a minimum that is not sound if, as far as
        these rows can tell, it is there; else nobody knows where it would have ended.
        """
        loss, rules = float(c.loss[0]), self._rules(state, oracle)
        if state.last and c.stage[0] == DONE:
            oracle.ended(math.inf, loss)
            return
        distances = square_distances(c, state.minima, state.box)
        there = loss >= (1 - rules.better) * state.level_losses
        if c.stage[0] == KNOWN:
            there &= state.sound
        else:
            there &= ~state.sound & (loss <= (1 + COPY_LOSS) * state.level_losses)
            there &= distances <= rules.near * loss * state.rows
        if there.any():
            nearest = np.argmin(np.where(there, distances, math.inf))
            oracle.ended(math.inf, float(state.losses[nearest]))
        else:
            oracle.dropped()

    def _close(self, state: MIHOGNState, oracle: Oracle) -> None:
        """End the bracket, and the search if the ends of its brackets are evidence enough."""
        state.phase = OVER
        agreement = oracle.agreement
        searched = oracle.evaluations >= self.longer * state.found
        returned = searched and agreement.here >= self.doubtful
        enough = agreement.enough and (returned or self._likely(state, oracle))
        if enough or state.bracket >= self.brackets:
            oracle.meter.starts.exhausted = not enough
            self._polish(state, oracle)

    def _likely(self, state: MIHOGNState, oracle: Oracle) -> bool:
        """Whether the best minimum so far is none where searches get stuck."""
        best = int(np.argmin(state.losses))
        return bool(state.sound[best] and state.losses[best] <= oracle.noise)

    def _polish(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Go on from the run's best, for the digits that a descent needs not to be told apart."""
        state.over = not math.isfinite(oracle.best)
        if state.over:
            return
        best = state.space.encode(oracle.trace.theta[-1][None])
        x = np.clip((best - state.box.origin) / state.box.width, 0.0, 1.0)
        state.level = state.ends.size - 1
        state.live = Candidates.at(x, state.ends.size, ENTERING, False)
        self._make_room(state)
        self._begin(state, POLISH)

    def _polished(self, state: MIHOGNState, oracle: Oracle) -> None:
        state.over = True

    def _best(self, state: MIHOGNState) -> float:
        """The least loss of a known minimum over the rows of this level."""
        return float(state.level_losses.min(initial=math.inf))

    def _make_room(self, state: MIHOGNState) -> None:
        """Room for the derivatives of the live ones on this level, where they are kept."""
        c = state.live
        kept = c.loss.size * (state.d + 1) * state.rows <= ROOM
        kept &= not (state.compiled and c.projects.all())
        state.live = c.with_rows(state.rows if kept else 0)


def _has_rows(oracle: Oracle) -> bool:
    """Whether residuals and derivatives are compiled."""
    return oracle.kernel is not None and oracle.kernel.rows is not None
