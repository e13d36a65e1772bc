"""MIHO-GN: Hyperband over Gauss-Newton steps, on growing subsets of the data."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass

import numpy as np

from miho.compiled.gauss_newton_candidates import (
    AT_KNOWN,
    COPY_LOSS,
    DONE,
    UNUSABLE,
    GNBox,
    GNCandidates,
    Minima,
)
from miho.compiled.phases import (
    CLOSED,
    EMPTY,
    ENTERING,
    FINISH,
    POLISH,
    RETURNED,
    REVIVE,
    begin,
    look_again,
    make_room,
    nearness,
)
from miho.optim.brackets import around, draw_starts
from miho.optim.credibility import credible, is_tested, prepare_challenge, solves
from miho.optim.evidence import ENOUGH, in_optimum, is_rounding
from miho.optim.gauss_newton_blocks import run_phases
from miho.optim.meter import UnusableValueError
from miho.optim.miho_gn_state import MIHOGNSettings, MIHOGNState, box_of, square_distances
from miho.optim.optimizer import Resumable
from miho.optim.oracle import Oracle
from miho.quantities import Array

LONELY, HOPS_PERIOD, ENDS = 20, 3, 3
"""After LONELY brackets, one bracket in HOPS_PERIOD challenges a best minimum with at most ENDS
ends, although the ends do not agree yet."""
SOLVED_FIRST = 9
"""A problem that is linear in all parameters is solved on one row in this number, then on all
rows."""
ATTEMPTS = 1000
"""Attempts to find a usable configuration of a problem with an unknown number of rows."""


@dataclass(frozen=True)
class MIHOGN(MIHOGNSettings, Resumable[MIHOGNState]):
    """Multistart Gauss-Newton search in brackets of successive halving, on growing data.

    The default method of `miho.fit`; needs a `LeastSquaresProblem`. A bracket draws starting
    points, evaluates them on the first rows of the data and keeps the best. Each rung makes some
    Levenberg-Marquardt steps and passes the best candidates on to the next rung, which uses more
    rows, until one candidate descends on all rows. The search ends when enough brackets agree on
    the best optimum (`miho.optim.evidence`); then a descent from it gains the last digits. A
    problem that is linear in all parameters is solved directly.

    An optimum needs more agreement if it is at a bound, if the data do not determine all
    parameters, if its loss exceeds the noise, or if its residuals have structure
    (`miho.optim.structure`). If the loss of an optimum is zero up to rounding (`miho.optim.zero`),
    one bracket is enough.

    Parameters
    ----------
    eta : int, optional
        One candidate in `eta` continues on the next rung (η), with `eta` times as many rows.
    rows_per_parameter : float, optional
        Rows of the first level, for each parameter.
    full_data_share : float, optional
        A level with more than this share of all rows uses all rows.
    max_rows_per_parameter : float, optional
        A level after more than this number of rows for each parameter uses all rows.
    base_cost, max_cost : float, optional
        Cost of a rung in units of d + 1 evaluations: `base_cost` times Luby's sequence, at most
        `max_cost`.
    min_candidates, max_candidates : int, optional
        Smallest and largest number of starting points of a bracket.
    steps_per_rung : int, optional
        Steps of each candidate on a rung.
    leader_steps : int, optional
        Steps of the best candidate on a rung, at most.
    max_step : float, optional
        Longest step along a coordinate, as a share of the width of the bounds.
    tolerance : float, optional
        A descent has converged if its linear model predicts a relative decrease of the loss below
        this.
    level_tolerance : float, optional
        The same on m rows, fewer than all, in units of d / m, which noise hides.
    patience, min_progress : float, optional
        A descent is set aside if its loss decreases by less than the share `min_progress` in
        `patience` (d + 1) evaluations. The best of these may later use as much as one bracket.
    max_brackets : int, optional
        Largest number of brackets; the outcome is then `Outcome.BRACKETS`.
    damping : float, optional
        Initial damping (Nielsen's μ), relative to the scale of each parameter.
    scale_decay : float, optional
        Smallest factor by which a scale decreases from step to step, in every second bracket. In
        the other brackets scales never decrease, which large residuals need.
    max_secants : int, optional
        Largest number of consecutive Broyden updates between evaluations of the derivatives.
    projection_period : int, optional
        One bracket in this number solves for the linear parameters at every evaluation (variable
        projection); 0 for none.
    draws : {"turns", "thirds", "own", "scale", "uniform"}, optional
        Distribution of starting points, see `miho.optim.brackets.draw_starts`.
    final_tolerance : float, optional
        `tolerance` of the final descent from the best optimum.
    doubtful_brackets : int, optional
        Agreeing brackets that a doubtful optimum needs, which must be three quarters of the
        brackets with a known loss. Half as many are enough if only the residuals have structure;
        twice as many are needed if the optimum may be a plateau.
    doubtful_cost : float, optional
        The search for a doubtful optimum takes at least this multiple of the evaluations that
        found it.
    challenges : int, optional
        Brackets that start near the best optimum and must fail to find a better one before the
        search ends: the first a standard deviation away along each parameter, the others at some of
        its coordinates, or, if there are several optima, at the lowest points along each parameter
        or, for a model with a period, along the period.
        If groups of nonlinear parameters have similar bounds, one more bracket starts with their
        values exchanged. If brackets hardly return to the best optimum, one in three challenges it
        earlier.

    Raises
    ------
    ValueError
        If a setting is not possible.
    TypeError
        If the problem has no residuals.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> class Line(miho.LeastSquaresProblem):
    ...     name = "line"
    ...     space = miho.Space((miho.Parameter("a", "", -9, 9), miho.Parameter("b", "", -9, 9)))
    ...     x = np.linspace(0, 1, 20)
    ...     def residuals(self, theta, fidelity=1.0):
    ...         return theta[0] * np.exp(theta[1] * self.x) - 2 * np.exp(self.x)
    ...     def jacobian(self, theta, fidelity=1.0):
    ...         e = np.exp(theta[1] * self.x)
    ...         return np.stack([e, theta[0] * self.x * e], axis=1)
    ...     def loss(self, thetas, fidelity=1.0):
    ...         return np.array([np.mean(self.residuals(theta) ** 2) for theta in thetas])
    >>> miho.minimize(miho.MIHOGN(), Line()).theta.round(4)
    array([2., 1.])
    """

    def start(self, oracle: Oracle, rng: np.random.Generator) -> MIHOGNState:
        """State before the first evaluation."""
        space, N = oracle.space, oracle.traits.rows
        box = box_of(space, oracle.traits.linear)
        level_rows: tuple[int, ...] = (0,)
        if N is not None:
            level_rows = self._levels(N, box)
            if oracle.traits.cost(level_rows[0] / N) >= 1:  # fewer rows cost the same
                level_rows = level_rows[-1:]
        oracle.meter.starts.brackets = True
        kernel = oracle.traits.kernel
        settings = self.block_settings(
            float(oracle.traits.rounding), oracle.traits.jacobian_cost,
            compiled=kernel is not None and kernel.rows is not None, solved=not box.nonlinear.size,
        )  # fmt: skip
        nobody, nowhere = GNCandidates.at(np.empty((0, len(space))), 0, 0, 0, False), np.empty(0)
        sums = np.empty((0, len(level_rows)))
        minima = Minima(nobody.x.copy(), nowhere, sums, np.empty(0, bool))
        return MIHOGNState(
            space, box, rng, np.array(level_rows), settings, nobody, minima,
            place=np.full(5, CLOSED), order=np.empty(0, np.int64), stored=nowhere,
        )  # fmt: skip

    def _levels(self, N: int, box: GNBox) -> tuple[int, ...]:
        d = box.low.size
        if not box.nonlinear.size:
            first = max(math.ceil(N / SOLVED_FIRST), d + 1)
            return (first, N) if first < N else (N,)
        return self.rows_by_level(N, d)

    def done(self, state: MIHOGNState) -> bool:
        """Whether the brackets are evidence enough, or their largest number is reached."""
        return state.finished

    def step(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Make the evaluations of one phase, and move to the next."""
        if not state.level_rows[-1]:
            self._count_rows(state, oracle)
            return
        if state.phase == CLOSED:
            if solves(state, oracle):
                self._polish(state, oracle)
            else:
                prepare_challenge(state, oracle)
                self.begin_bracket(state, oracle)
        if state.phase < CLOSED:
            run_phases(oracle, state)
        self.end_phases(state, oracle)

    def end_phases(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Record the end of a bracket; then close it, or continue with other phases."""
        phase = state.phase
        if phase == RETURNED:
            self._record_return(state, oracle)
            self._close(state, oracle)
        elif phase == EMPTY:
            self._close(state, oracle)
        elif phase == FINISH:
            self._after_finish(state, oracle)
        elif phase == REVIVE:
            self._record_end(state, oracle)
            self._close(state, oracle)
        else:
            state.finished = True  # after the final descent or a linear solution

    def _count_rows(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Evaluate all residuals once, to learn their number."""
        theta = state.space.decode(state.space.initial(state.attempts + 1))[-1]
        with contextlib.suppress(UnusableValueError):
            state.level_rows[:] = oracle.residuals(theta).size
        state.attempts += 1
        state.finished = not state.level_rows[-1] and state.attempts == ATTEMPTS

    # The phases of a bracket.

    def begin_bracket(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Begin a bracket: determine its budget, and draw its starts."""
        state.bracket += 1
        state.challenging = state.challenged
        projects = state.linear or self._projects(state)
        look_cost = int(state.level_rows[0]) / int(state.level_rows[-1])
        look_cost *= 1 + projects * state.box.linear.size
        budget, n = self.sizes(state.bracket, state.d, look_cost)
        state.settings = state.settings._replace(projects=projects, rung_budget=budget)
        state.spent_before = oracle.evaluations
        if state.bracket == 2:
            from miho.optim.periods import periods_of

            state.periods.update(periods_of(oracle, state.space, state.box.nonlinear))
        # Its starts, to be evaluated on the first level, or on all rows if they are near the best.
        n, level = 1 if state.linear else n, 0
        starts = draw_starts(state.space, n, state.rng, state.bracket, self.draws, state.periods)
        if state.challenging:
            starts, level = self._challengers(state, starts)
        n = len(starts)
        oracle.starts.screened += n * (not state.linear)
        x = (starts - state.box.origin) / state.box.width
        fading = self.scale_decay if state.bracket % 2 else 1.0
        levels = state.level_rows.size
        state.admit(GNCandidates.at(x, levels, self.damping, fading, projects), level)
        make_room(state.candidates, state.place, state.level_rows, state.settings)

    def _challengers(self, state: MIHOGNState, starts: Array) -> tuple[Array, int]:
        """Starts near the best minimum, some of them from `starts` (n, d), and their level."""
        best, last = state.minima.x[state.best_minimum], state.level_rows.size - 1
        coordinates = state.box.origin + state.box.width * best
        if state.near is not None:
            return state.box.origin + state.box.width * state.near, last
        return around(coordinates, starts, state.rng), 0

    def _projects(self, state: MIHOGNState) -> bool:
        """Whether this bracket projects: one in a period, and the first if that halves d."""
        linear = state.box.linear.size
        halves = state.bracket == 1 and 2 * linear >= state.d
        return bool(linear and self.projection_period) and (
            halves or state.bracket % self.projection_period == 0
        )

    def _after_finish(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Revive the best candidate that stalled in an earlier bracket, if there is one.

        It may use as much as this bracket.
        """
        earlier = state.stalled.copy()
        self._record_end(state, oracle)
        self._close(state, oracle)
        if earlier and state.phase == CLOSED:
            best = min(range(len(earlier)), key=lambda k: float(earlier[k].loss[0]))
            spent = oracle.evaluations - state.spent_before
            allowance = int(spent * int(state.level_rows[-1]))
            state.settings = state.settings._replace(allowance=allowance)
            state.admit(state.stalled.pop(best), state.level_rows.size - 1)
            look_again(state.candidates, state.place, state.level_rows, state.settings)
            begin(state.candidates, state.place, REVIVE, 1)

    def _record_end(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Record the end of a bracket's last candidate: known, new, stalled or unusable."""
        c = state.candidates
        loss, best = float(c.loss[0]), min(state.minima.loss.tolist(), default=math.inf)
        better = not in_optimum(loss, best, oracle.traits.resolution)
        if c.stage[0] == AT_KNOWN:
            self._record_return(state, oracle)
        elif c.stage[0] == DONE:
            if better:  # challenges start again
                state.best_found_after = oracle.evaluations
                state.passed, state.challenging = 0, False
            if not state.challenging:
                oracle.starts.add(math.inf, loss, theta=state.theta(c.x[0]))
            if loss < best or not in_optimum(best, loss, oracle.traits.resolution):
                state.add_minimum(c)
        elif c.stage[0] != UNUSABLE and (better or not state.challenging):
            state.stalled.append(c.first())  # one from a challenge is no evidence if it returns

    def _record_return(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Record the end of a bracket whose best candidate leads to nothing new.

        The candidate came to a known minimum, or it converged and is no better than one. If it
        converged on fewer than all rows, it belongs to the nearest minimum that the data do not
        determine, if these rows cannot distinguish the two; otherwise its end on all rows is
        unknown.
        """
        if state.challenging:  # it started near the best minimum: a return is no evidence
            return
        c, minima = state.candidates, state.minima
        loss, came_back = float(c.loss[0]), c.stage[0] == AT_KNOWN
        if state.last and c.stage[0] == DONE:
            oracle.starts.add(math.inf, loss, theta=state.theta(c.x[0]))
            return
        near, better = nearness(state.d, state.rows, state.last)
        level_losses = state.level_losses
        matches = (loss >= (1 - better) * level_losses) & (minima.determined == came_back)
        if not came_back:
            matches &= loss <= (1 + COPY_LOSS) * level_losses
        places = matches.nonzero()[0]
        if places.size > came_back:  # a single candidate minimum needs no distance
            distances = square_distances(c, minima.x[places], state.box)
            within = came_back | (distances <= near * loss * state.rows)
            places = places[within][np.argsort(distances[within], kind="stable")]
        if places.size:
            nearest = places[0]
            end, place = float(minima.loss[nearest]), state.theta(minima.x[nearest])
            oracle.starts.add(math.inf, end, theta=place)
        else:
            oracle.starts.dropped += 1

    def _close(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Close the bracket, and end the search if the ends of brackets are evidence enough.

        Before the search ends, brackets that start near the best minimum challenge it. They count
        as evidence only if they find a better one.
        """
        state.close()
        state.passed, state.challenging = state.passed + state.challenging, False
        agreed = False
        if len(oracle.starts.descents) >= ENOUGH:
            agreement = oracle.starts.agreement(oracle.best)
            agreed = agreement.enough and credible(self, state, oracle, agreement)
        challenges = self.challenges + bool(state.alike)
        enough = agreed and state.passed >= challenges and is_tested(state, oracle)
        enough |= is_rounding(oracle.best, oracle.traits.rounding, oracle.traits.resolution)
        state.challenged = not enough and (agreed or _is_lonely(state, oracle))
        if enough or state.bracket >= self.max_brackets:
            oracle.meter.starts.exhausted = not enough
            self._polish(state, oracle)

    def _polish(self, state: MIHOGNState, oracle: Oracle) -> None:
        """Descend from the best configuration of the run to the last digits."""
        state.finished = not math.isfinite(oracle.best)
        if state.finished:
            return
        best = state.space.encode(oracle.trace.theta[-1][None])
        x = np.clip((best - state.box.origin) / state.box.width, 0.0, 1.0)
        levels = state.level_rows.size
        state.admit(GNCandidates.at(x, levels, ENTERING, self.scale_decay, False), levels - 1)
        make_room(state.candidates, state.place, state.level_rows, state.settings)
        begin(state.candidates, state.place, POLISH, 1)


def _is_lonely(state: MIHOGNState, oracle: Oracle) -> bool:
    """Whether to look for a better minimum near the best one before brackets agree.

    A model with several similar parts, such as three sines, has so many minima that hardly any
    bracket returns to the best one. A better one then shares most of its coordinates, and repeated
    challenges find the parts one after another.
    """
    if state.bracket < LONELY or state.bracket % HOPS_PERIOD or not state.minima.loss.size:
        return False
    return oracle.starts.agreement(oracle.best).agreeing <= ENDS
