"""The one interface of all methods, and its ask-and-tell form."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Generic, TypeVar, final

import numpy as np

from miho.optim.oracle import Oracle
from miho.optim.space import Space
from miho.quantities import Array

State = TypeVar("State")


class Optimizer(ABC):
    """A method: a frozen dataclass of its settings, which serves any number of runs.

    `loads` names modules that it imports where it first needs them: `minimize` does so before the
    clock starts.
    """

    loads: ClassVar[Sequence[str]] = ()

    @abstractmethod
    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Search until the method is done, or the oracle raises BudgetExhausted.

        Everything a method learns of the problem comes through `oracle`; all its randomness
        comes from `rng`, except the common start, `oracle.space.initial(n)`.
        """


class Resumable(Optimizer, Generic[State]):
    """A method whose state is an object, so that a run can be cut anywhere and goes on bit-exactly.

    The state is picklable and holds the random generator. A step that is cut, because the oracle
    raises in the middle of it, leaves a state from which it goes on.
    """

    @abstractmethod
    def start(self, oracle: Oracle, rng: np.random.Generator) -> State:
        """The state before the first evaluation; nothing is evaluated here."""

    @abstractmethod
    def step(self, state: State, oracle: Oracle) -> None:
        """Evaluate something and move the state on."""

    @abstractmethod
    def done(self, state: State) -> bool:
        """Whether the method has ended by itself."""

    @final
    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Search from the beginning."""
        self.resume(oracle, self.start(oracle, rng))

    @final
    def resume(self, oracle: Oracle, state: State) -> None:
        """Go on from a state, with an oracle that holds the meter of the same moment."""
        oracle.state = state
        while not self.done(state):
            self.step(state, oracle)


class AskTell(Resumable[State]):
    """A method that asks for losses of configurations and is told them.

    `ask` only reads the state: asked twice, it gives the same batch. Every change happens in
    `tell`.
    """

    @abstractmethod
    def init(self, space: Space, rng: np.random.Generator) -> State:
        """The state before the first batch."""

    @abstractmethod
    def ask(self, state: State) -> Array:
        """The next batch in units, (n, d); it must not be modified."""

    @abstractmethod
    def tell(self, state: State, thetas: Array, losses: Array) -> None:
        """Move the state on, given the losses (n,) of the batch; +inf marks unusable values."""

    def fidelity(self, state: State) -> float:
        """The fidelity of the next batch: the share of the data that is looked at."""
        return 1.0

    def start(self, oracle: Oracle, rng: np.random.Generator) -> State:
        """The state before the first batch, of a method that needs to know the space only."""
        return self.init(oracle.space, rng)

    @final
    def step(self, state: State, oracle: Oracle) -> None:
        """Ask, evaluate and tell."""
        thetas = self.ask(state)
        if not len(thetas):
            raise ValueError(
                f"{type(self).__name__}.ask gives no configuration, though done is false"
            )
        self.tell(state, thetas, oracle(thetas, self.fidelity(state)))
