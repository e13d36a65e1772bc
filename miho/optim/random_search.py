"""Random search, the baseline that every method must beat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.optim.ask_tell import AskTell
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
    """Independent draws from the initial distribution, until the budget ends.

    Parameters
    ----------
    batch : int, optional
        Number of configurations that are drawn and evaluated at a time.
    sampling : {"normal", "uniform_plus_noise", "uniform"}, optional
        Distribution of the configurations, see `Space.sample`.

    Raises
    ------
    ValueError
        If a setting is not possible.

    Examples
    --------
    >>> import miho
    >>> from miho.methods import RandomSearch
    >>> class Bowl(miho.Problem):
    ...     name = "bowl"
    ...     space = miho.Space((miho.Parameter("a", "m", -5, 5),))
    ...     def loss(self, thetas, fidelity=1.0):
    ...         return (thetas[:, 0] - 1) ** 2
    >>> record = miho.minimize(RandomSearch(), Bowl(), miho.Budget(evaluations=2000))
    >>> record.loss < 0.01, record.evaluations
    (True, 2000.0)
    """

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
