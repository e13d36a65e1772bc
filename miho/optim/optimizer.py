"""The interface of all methods."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Generic, TypeVar, final

import numpy as np

from miho.optim.oracle import Oracle

State = TypeVar("State")


class Optimizer(ABC):
    """Abstract base class of a method: a frozen dataclass of settings with one method, `run`.

    One instance serves any number of runs. Derive from `AskTell` for a method that needs losses of
    batches only; it can then be resumed.

    Attributes
    ----------
    loads : sequence of str
        Modules that the method imports at their first use. `minimize` imports them before the clock
        starts.
    """

    loads: ClassVar[Sequence[str]] = ()

    @abstractmethod
    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Search until the method is done, or until the oracle raises BudgetExhausted.

        Parameters
        ----------
        oracle : Oracle
            The only access to the problem: it evaluates, counts and records.
        rng : numpy.random.Generator
            The only source of randomness, except for the common start `oracle.space.initial(n)`.
        """


class Resumable(Optimizer, Generic[State]):
    """Abstract base class of a method with a state object; a stopped run resumes bit-exactly.

    The state can be pickled and contains the random generator. If the oracle raises in the middle
    of a step, it must still be possible to resume the state that is left.
    """

    @abstractmethod
    def start(self, oracle: Oracle, rng: np.random.Generator) -> State:
        """Return the state before the first evaluation, without evaluating."""

    @abstractmethod
    def step(self, state: State, oracle: Oracle) -> None:
        """Evaluate, and advance the state."""

    @abstractmethod
    def done(self, state: State) -> bool:
        """Whether the method has ended by itself."""

    @final
    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Search from the beginning."""
        self.resume(oracle, self.start(oracle, rng))

    @final
    def resume(self, oracle: Oracle, state: State) -> None:
        """Continue from a state, with an oracle whose meter was stored together with it."""
        oracle.state = state
        while not self.done(state):
            self.step(state, oracle)
