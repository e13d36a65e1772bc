"""The ask-and-tell form of a method."""

from __future__ import annotations

from abc import abstractmethod
from typing import final

import numpy as np

from miho.optim.optimizer import Resumable, State
from miho.optim.oracle import Oracle
from miho.optim.space import Space
from miho.quantities import Array


class AskTell(Resumable[State]):
    """Abstract base class of a method that alternates between `ask` and `tell`.

    `ask` returns a batch of configurations and does not change the state: a second call returns the
    same batch. `tell` receives the losses and makes all changes.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> import miho
    >>> @dataclass(frozen=True)
    ... class Uniform(miho.AskTell[list]):
    ...     def init(self, space, rng):
    ...         return [space, rng, space.sample(10, rng, "uniform")]
    ...     def ask(self, state):
    ...         return state[0].decode(state[2])
    ...     def tell(self, state, thetas, losses):
    ...         state[2] = state[0].sample(10, state[1], "uniform")
    ...     def done(self, state):
    ...         return False
    >>> class Square(miho.Problem):
    ...     name, space = "square", miho.Space((miho.Parameter("a", "", -1, 1),))
    ...     def loss(self, thetas, fidelity=1.0):
    ...         return thetas[:, 0] ** 2
    >>> record = miho.minimize(Uniform(), Square(), miho.Budget(evaluations=100))
    >>> round(record.evaluations), record.loss < 0.01
    (100, True)
    """

    @abstractmethod
    def init(self, space: Space, rng: np.random.Generator) -> State:
        """Return the state before the first batch.

        Parameters
        ----------
        space : Space
            Parameters of the run; `space.initial(n)` are the common first configurations.
        rng : numpy.random.Generator
            The only source of randomness.

        Returns
        -------
        State
            A picklable object of the method's choice.
        """

    @abstractmethod
    def ask(self, state: State) -> Array:
        """Return the next batch of configurations.

        Parameters
        ----------
        state : State
            The state, which must not change.

        Returns
        -------
        ndarray of shape (n, d)
            Configurations in units, which the caller does not modify.
        """

    @abstractmethod
    def tell(self, state: State, thetas: Array, losses: Array) -> None:
        """Advance the state, given the losses of the batch.

        Parameters
        ----------
        state : State
            The state, which changes.
        thetas : ndarray of shape (n, d)
            The batch, in units.
        losses : ndarray of shape (n,)
            Its losses; +inf marks unusable values.
        """

    def fidelity(self, state: State) -> float:
        """Fidelity of the next batch: the fraction of the data to use.

        Parameters
        ----------
        state : State
            The state.

        Returns
        -------
        float
            Fraction of the data, in (0, 1]; by default all.
        """
        return 1.0

    def start(self, oracle: Oracle, rng: np.random.Generator) -> State:
        """Return the state before the first batch; calls `init`."""
        return self.init(oracle.space, rng)

    @final
    def step(self, state: State, oracle: Oracle) -> None:
        """Ask, evaluate and tell."""
        thetas = self.ask(state)
        if not len(thetas):
            raise ValueError(
                f"{type(self).__name__}.ask: expected at least one configuration, got none, while "
                "done is false; return a batch, or end the search"
            )
        self.tell(state, thetas, oracle(thetas, self.fidelity(state)))
