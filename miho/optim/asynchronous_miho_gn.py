"""MIHO-GN whose brackets go on as their evaluations come."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from miho.compiled.phases import CLOSED, POLISH
from miho.optim.gauss_newton_steps import Round, rounds
from miho.optim.miho_gn import MIHOGN
from miho.optim.miho_gn_settings import MIHOGNSettings
from miho.optim.miho_gn_state import MIHOGNState
from miho.optim.optimizer import Resumable
from miho.optim.oracle import Oracle


@dataclass
class BracketUnderWay:
    """A bracket, and its next round, which workers make.

    The run had made so many `evaluations` when it last stood still. The `rounds` to come, and the
    next `round`, are not part of a stored state: they follow from where the bracket stands.
    """

    state: MIHOGNState
    evaluations: float
    rounds: Iterator[Round] | None = field(default=None, repr=False)
    round: Round | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"rounds": None, "round": None}

    def begun(self, oracle: Oracle) -> Round | None:
        """The next round, begun; None where the phases are at their end."""
        if self.rounds is None:
            self.rounds = rounds(oracle, self.state)
            self.round = next(self.rounds, None)
        return self.round

    def make_round(self, oracle: Oracle) -> None:
        """Make the evaluations of the next round, and begin the one after it."""
        self.begun(oracle)
        try:
            self.round = None if self.rounds is None else next(self.rounds, None)
        except BaseException:
            self.rounds = self.round = None
            raise


@dataclass
class AsynchronousMIHOGNState:
    """Brackets that are under way, and the `search` that they have in common.

    Of that, minima, their place in the books, the number of brackets and the end are those of all.
    The next round of the bracket at position `arrived` is there, None while that is not known.
    """

    search: MIHOGNState
    brackets: list[BracketUnderWay] = field(default_factory=list)
    arrived: int | None = None


@dataclass(frozen=True)
class AsynchronousMIHOGN(MIHOGNSettings, Resumable[AsynchronousMIHOGNState]):
    """Several brackets of `MIHOGN` at a time, as many as keep the workers busy.

    Each makes its phases in rounds of evaluations that do not depend on each other. The bracket
    whose round is there first goes on; while fewer evaluations are under way than there are
    workers, another one begins. They have the known minima, the stalled candidates and the evidence
    in common, and the rule by which the search ends; what is then under way is given up.

    What it decides depends on when several were under way and in which order rounds ended, and on
    nothing else (`record.arrivals` repeats it). It makes one bracket after the other, as `MIHOGN`
    does, with one worker, with residuals of the machine, where all parameters are linear, and as
    long as evaluations are not known to be worth a worker each. It has the settings of `MIHOGN`.
    """

    @cached_property
    def method(self) -> MIHOGN:
        """The method that makes each bracket."""
        return MIHOGN(**{setting.name: getattr(self, setting.name) for setting in fields(self)})

    def start(self, oracle: Oracle, rng: np.random.Generator) -> AsynchronousMIHOGNState:
        """The state before the first look."""
        return AsynchronousMIHOGNState(self.method.start(oracle, rng))

    def step(self, state: AsynchronousMIHOGNState, oracle: Oracle) -> None:
        """Make the round that ended first, and go on from there."""
        search = state.search
        if search.settings.compiled or search.linear or not search.level_rows[-1]:
            self.method.step(search, oracle)
            return
        self.method.test(search, oracle)
        if state.arrived is None:
            state.arrived = self._next(state, oracle)
        bracket = state.brackets[state.arrived]
        bracket.make_round(oracle)
        # The round counts: nothing raises from here on. Who was served is last in line.
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
        """After brackets whose ends are evidence enough, or after the last."""
        return state.search.finished

    def _next(self, state: AsynchronousMIHOGNState, oracle: Oracle) -> int:
        """Have workers busy and wait: the position of a bracket, which learns what others found."""
        search = state.search
        under_way = [bracket.begun(oracle) for bracket in state.brackets]
        polishes = any(bracket.state.phase == POLISH for bracket in state.brackets)
        while (
            sum(r.evaluations for r in under_way if r is not None) < oracle.workers
            and search.bracket < self.brackets
            and not polishes
        ):
            begun = replace(search, place=np.full(5, CLOSED), turn=0)
            self.method.begin_bracket(begun, oracle)
            search.bracket = begun.bracket
            state.brackets.append(BracketUnderWay(begun, oracle.evaluations))
            under_way.append(state.brackets[-1].begun(oracle))
        arrived = oracle.first_ready([r.ahead for r in under_way if r is not None])
        bracket = state.brackets[arrived]
        # What others spent meanwhile is not what this bracket did.
        bracket.state.spent_before += oracle.evaluations - bracket.evaluations
        bracket.state.learn(search)
        return arrived

    def _end_phases(self, bracket: BracketUnderWay, oracle: Oracle) -> None:
        """Where no round is left, record that, until the bracket has closed or has other phases."""
        while bracket.round is None and not bracket.state.finished:
            self.method.end_phases(bracket.state, oracle)
            if bracket.state.phase == CLOSED:
                return
            bracket.rounds = None
            if not bracket.state.finished:
                bracket.begun(oracle)
