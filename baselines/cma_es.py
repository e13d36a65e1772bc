"""CMA-ES with restarts of growing and of small populations, from the library `cmaes`."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field

import cmaes
import numpy as np

from miho.methods.unit_box import LossScale, UnitBox
from miho.optim import AskTell, Space
from miho.quantities import Array
from miho.validate import one_of, positive, whole

RESTARTS = ("ipop", "bipop")
LEVEL = 1e3
"""Scaled first loss: the library's tolerance of 1e-12 is then 1e-15 of it, above its rounding
errors."""


@dataclass
class CMAESState:
    """The strategy of the current restart, the batch asked (n, d) in the unit box, and the budgets.

    All restarts share `scale`; `large` counts restarts with a grown population. Evaluations are
    `used`, of at most `limit`, in this restart, `last_large` in the last large restart,
    `spent_large` in all large restarts, and `spent_small` in all others.
    """

    space: Space
    rng: np.random.Generator
    strategy: cmaes.CMA | None
    batch: Array
    scale: LossScale = field(default_factory=lambda: LossScale(LEVEL))
    large: int = 0
    is_large: bool = False
    used: int = 0
    limit: float = math.inf
    spent_small: int = 0
    spent_large: int = 0
    last_large: int = 0


@dataclass(frozen=True)
class CMAES(AskTell[CMAESState]):
    """The CMA evolution strategy (Hansen, arXiv:1604.00772), restarted until the budget ends.

    Population and learning rates are the tutorial's defaults for the dimension. The search is over
    the search coordinates scaled to the unit box. The first mean is the first common initial
    configuration, which is evaluated first; restarts begin anywhere in the box. A strategy ends by
    the library's tests: losses of the last generations that agree to 1e-15 of the run's first loss,
    or a distribution that is too small, too large or too thin to continue.

    Parameters
    ----------
    restarts : {'bipop', 'ipop'}
        `ipop` multiplies the population by `growth` at every restart (Auger and Hansen, CEC 2005).
        `bipop` adds restarts with random small populations and step sizes, alternating so that both
        kinds spend equally (Hansen, GECCO 2009, Sec. 2).
    sigma : float
        Initial step size in every coordinate.
    growth : int
        Growth of the population.
    resampling : int
        Most new draws for a point outside the box, which is then clipped (by the library).

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    restarts: str = "bipop"
    sigma: float = 0.2
    growth: int = 2
    resampling: int = 100

    def __post_init__(self) -> None:
        one_of("restarts", self.restarts, RESTARTS)
        positive("sigma", self.sigma)
        whole("growth", self.growth, 2)
        whole("resampling", self.resampling, 1)

    def init(self, space: Space, rng: np.random.Generator) -> CMAESState:
        """The first batch is the first common initial configuration alone."""
        first = UnitBox(space).x(space.decode(space.initial(1)))
        return CMAESState(space=space, rng=rng, strategy=None, batch=first)

    def ask(self, state: CMAESState) -> Array:
        """The generation in progress, or the common start."""
        if state.strategy is None:
            return state.space.decode(state.space.initial(1))
        return UnitBox(state.space).theta(state.batch)

    def tell(self, state: CMAESState, thetas: Array, losses: Array) -> None:
        """Move the distribution, restart if it has ended, and draw the next generation."""
        values = state.scale(losses).tolist()
        if state.strategy is None:
            strategy = self._strategy(state.batch[0], self.sigma, None)
        else:
            # Like a pickle, a copy has no generator and only half of the covariance matrix.
            strategy = copy.copy(state.strategy)
            strategy.tell(list(zip(state.batch, values, strict=True)))
            state.used += len(values)
            if strategy.should_stop() or state.used >= state.limit:
                strategy = self._restart(state)
        strategy.reseed_rng(int(state.rng.integers(2**32)))
        state.batch = np.array([strategy.ask() for _ in range(strategy.population_size)])
        state.strategy = strategy

    def done(self, state: CMAESState) -> bool:
        """False: only the budget ends the run."""
        return False

    def _strategy(self, mean: Array, sigma: float, population: int | None) -> cmaes.CMA:
        return cmaes.CMA(
            mean=mean,
            sigma=sigma,
            bounds=np.tile([0.0, 1.0], (mean.size, 1)),
            n_max_resampling=self.resampling,
            seed=0,
            population_size=population,
        )

    def _restart(self, state: CMAESState) -> cmaes.CMA:
        """A new strategy of the kind, large or small, that has used less so far."""
        d, rng = len(state.space), state.rng
        default = 4 + math.floor(3 * math.log(d))
        if state.is_large:
            state.spent_large += state.used
            state.last_large = state.used
        else:
            state.spent_small += state.used
        state.used = 0
        state.is_large = self.restarts == "ipop" or state.spent_small >= state.spent_large
        mean = rng.random(d)
        if state.is_large:
            state.large += 1
            state.limit = math.inf
            return self._strategy(mean, self.sigma, default * self.growth**state.large)
        state.limit = state.last_large / 2
        grown = self.growth**state.large / 2
        share, scale = rng.random(2)
        population = math.floor(default * grown**share**2)
        return self._strategy(mean, self.sigma * 10 ** (-2 * scale), population)
