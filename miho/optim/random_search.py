"""Random search, the baseline that every method must beat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.optim.optimizer import AskTell
from miho.optim.space import LARGEST_BATCH, SAMPLINGS, Space
from miho.quantities import Array
from miho.validate import one_of, whole


@dataclass
class RandomSearchState:
    """The next batch (n, d), in search coordinates."""

    space: Space
    rng: np.random.Generator
    batch: Array


@dataclass(frozen=True)
class RandomSearch(AskTell[RandomSearchState]):
    """Independent draws from the initial distribution, `batch` at a time, until the budget ends."""

    batch: int = 1000
    sampling: str = "normal"

    def __post_init__(self) -> None:
        whole("batch", self.batch, 1, LARGEST_BATCH)
        one_of("sampling", self.sampling, SAMPLINGS)

    def init(self, space: Space, rng: np.random.Generator) -> RandomSearchState:
        """State with the common initial configurations as first batch."""
        return RandomSearchState(space, rng, space.initial(self.batch, self.sampling))

    def ask(self, state: RandomSearchState) -> Array:
        """The last batch, in units."""
        return state.space.decode(state.batch)

    def tell(self, state: RandomSearchState, thetas: Array, losses: Array) -> None:
        """Draw the next batch."""
        state.batch = state.space.sample(self.batch, state.rng, self.sampling)

    def done(self, state: RandomSearchState) -> bool:
        """False: only the budget ends the search."""
        return False
