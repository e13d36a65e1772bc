"""The one interface of all methods, and its ask-and-tell form."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from miho.optim.oracle import Oracle
from miho.optim.space import Space

Array = NDArray[np.float64]
State = TypeVar("State")


class Optimizer(ABC):
    """A method: a frozen dataclass of its settings, which serves any number of runs."""

    @abstractmethod
    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Search until the method is done, or the oracle raises BudgetExhausted.

        Everything a method learns of the problem comes through `oracle`; all its randomness
        comes from `rng`, except the common start, `oracle.space.initial(n)`.
        """


class AskTell(Optimizer, Generic[State]):
    """A method as a state machine, so that a run can be stopped anywhere and resumed bit-exactly.

    The state is a picklable object holding the random generator. `ask` only reads it: asked
    twice, it gives the same batch. Every change happens in `tell`.
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

    @abstractmethod
    def done(self, state: State) -> bool:
        """Whether the method has nothing left to ask."""

    def leap(self, state: State, oracle: Oracle) -> bool:
        """Do at once what many asks and tells would do, if the oracle can; whether it did.

        The one method that may be overridden: there is nothing to leap over by default.
        """
        return False

    @final
    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Search from the beginning."""
        self.resume(oracle, self.init(oracle.space, rng))

    @final
    def resume(self, oracle: Oracle, state: State) -> None:
        """Go on from a state, with an oracle that holds the meter of the same moment."""
        oracle.state = state
        while not self.done(state):
            if not self.leap(state, oracle):
                thetas = self.ask(state)
                if not len(thetas):
                    raise ValueError(
                        f"{type(self).__name__}.ask gives no configuration, though done is false"
                    )
                self.tell(state, thetas, oracle(thetas))
