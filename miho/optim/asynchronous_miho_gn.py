"""MIHO-GN with several brackets at a time, for evaluations of unequal length."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from miho.compiled.phases import CLOSED, POLISH
from miho.optim.credibility import prepare_challenge
from miho.optim.gauss_newton_steps import Round, rounds
from miho.optim.miho_gn import MIHOGN
from miho.optim.miho_gn_state import MIHOGNSettings, MIHOGNState
from miho.optim.optimizer import Resumable
from miho.optim.oracle import Oracle


@dataclass
class BracketUnderWay:
    """An active bracket and its next round, which workers evaluate.

    `evaluations` is the count of the run when the bracket last advanced. A stored state does not
    contain `rounds` and `round`: they follow from the state of the bracket.
    """

    state: MIHOGNState
    evaluations: float
    rounds: Iterator[Round] | None = field(default=None, repr=False)
    round: Round | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"rounds": None, "round": None}

    def begun(self, oracle: Oracle) -> Round | None:
        """Start the next round and return it; None at the end of the phases."""
        if self.rounds is None:
            self.rounds = rounds(oracle, self.state)
            self.round = next(self.rounds, None)
        return self.round

    def make_round(self, oracle: Oracle) -> None:
        """Make the evaluations of the next round, and start the round after it."""
        self.begun(oracle)
        try:
            self.round = None if self.rounds is None else next(self.rounds, None)
        except BaseException:
            self.rounds = self.round = None
            raise


@dataclass
class AsynchronousMIHOGNState:
    """Active brackets, and their common `search`.

    The minima of `search`, their records, the number of brackets and the end apply to all brackets.
    `arrived` is the position of the bracket whose next round is complete, None while unknown.
    """

    search: MIHOGNState
    brackets: list[BracketUnderWay] = field(default_factory=list)
    arrived: int | None = None


@dataclass(frozen=True)
class AsynchronousMIHOGN(MIHOGNSettings, Resumable[AsynchronousMIHOGNState]):
    """`MIHOGN` with several brackets at a time, as many as keep the workers busy.

    Each bracket makes its phases in rounds of independent evaluations. The bracket whose round is
    complete first continues. While there are fewer active evaluations than workers, another bracket
    begins. Brackets share known minima, stalled candidates, evidence and the stopping rule; the end
    of the search discards active brackets.

    The decisions depend only on when several brackets were active and on the order in which rounds
    ended; a journal repeats both. As in `MIHOGN`, brackets run one after the other with one worker,
    with residuals of the machine, if all parameters are linear, and until evaluations are known to
    be expensive enough for one worker each.

    Parameters
    ----------
    eta, rows_per_parameter, full_data_share, max_rows_per_parameter : optional
        Candidates that continue, and rows of each level; see `MIHOGN`, as for all settings.
    base_cost, max_cost, min_candidates, max_candidates : optional
        Cost of a rung, and number of starting points of a bracket.
    steps_per_rung, leader_steps, max_step : optional
        Steps of a descent.
    tolerance, level_tolerance, patience, min_progress, max_brackets : optional
        End of a descent, and of the search.
    damping, scale_decay, max_secants, projection_period, draws : optional
        Damping, derivatives, linear parameters, and distribution of starting points.
    final_tolerance, doubtful_brackets, doubtful_cost, challenges : optional
        Final descent, and evidence that ends the search.

    Raises
    ------
    ValueError
        If a setting is not possible.
    TypeError
        If the problem has no residuals.
    """

    @cached_property
    def method(self) -> MIHOGN:
        """The method that runs each bracket."""
        return MIHOGN(**{setting.name: getattr(self, setting.name) for setting in fields(self)})

    def start(self, oracle: Oracle, rng: np.random.Generator) -> AsynchronousMIHOGNState:
        """State before the first evaluation."""
        return AsynchronousMIHOGNState(self.method.start(oracle, rng))

    def step(self, state: AsynchronousMIHOGNState, oracle: Oracle) -> None:
        """Process the round that ended first."""
        search = state.search
        if search.settings.compiled or search.linear or not search.level_rows[-1]:
            self.method.step(search, oracle)
            return
        prepare_challenge(search, oracle)
        if state.arrived is None:
            state.arrived = self._next(state, oracle)
        bracket = state.brackets[state.arrived]
        bracket.make_round(oracle)
        # Nothing raises from here on. The bracket moves to the end of the queue.
        self._end_phases(bracket, oracle)
        state.brackets.append(state.brackets.pop(state.arrived))
        state.arrived, bracket.evaluations = None, oracle.evaluations
        latest = bracket.state
        search.learn(latest)
        search.finished = latest.finished
        if latest.phase == CLOSED:
            state.brackets.pop()
        elif latest.phase == POLISH:
            state.brackets = [bracket]

    def done(self, state: AsynchronousMIHOGNState) -> bool:
        """Whether the brackets are evidence enough, or their largest number is reached."""
        return state.search.finished

    def _next(self, state: AsynchronousMIHOGNState, oracle: Oracle) -> int:
        """Keep workers busy and wait; return the position of the next bracket to advance."""
        search = state.search
        under_way = [bracket.begun(oracle) for bracket in state.brackets]
        polishes = any(bracket.state.phase == POLISH for bracket in state.brackets)
        while (
            sum(r.evaluations for r in under_way if r is not None) < oracle.workers.count
            and search.bracket < self.max_brackets
            and not polishes
        ):
            begun = replace(search, place=np.full(5, CLOSED), turn=0)
            self.method.begin_bracket(begun, oracle)
            search.bracket, search.spent_before = begun.bracket, begun.spent_before
            state.brackets.append(BracketUnderWay(begun, oracle.evaluations))
            under_way.append(state.brackets[-1].begun(oracle))
        arrived = oracle.workers.first_ready([r.ahead for r in under_way if r is not None])
        bracket = state.brackets[arrived]
        # Evaluations of other brackets do not count for this one.
        bracket.state.spent_before += oracle.evaluations - bracket.evaluations
        bracket.state.learn(search)
        return arrived

    def _end_phases(self, bracket: BracketUnderWay, oracle: Oracle) -> None:
        """End phases that have no rounds left, until the bracket is closed or has other phases."""
        while bracket.round is None and not bracket.state.finished:
            self.method.end_phases(bracket.state, oracle)
            if bracket.state.phase == CLOSED:
                return
            bracket.rounds = None
            if not bracket.state.finished:
                bracket.begun(oracle)
