"""Differential evolution of SciPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # loads its subpackages on first use: importing them takes a second

from miho.methods.unit_box import UnitOracle
from miho.optim import Optimizer, Oracle
from miho.quantities import Array
from miho.validate import at_least, one_of, settings_at_least, true_or_false, whole

LEVEL = 1e12
"""Scaled first loss: large enough for the polish to end by its relative tolerance."""

STRATEGIES = tuple(
    f"{base}{crossover}"
    for base in ("best1", "best2", "rand1", "rand2", "randtobest1", "currenttobest1")
    for crossover in ("bin", "exp")
)


@dataclass(frozen=True)
class DifferentialEvolution(Optimizer):
    """Differential evolution (Storn and Price, 1997) by `scipy.optimize.differential_evolution`.

    A population starts at the common initial configurations and evolves generation by generation
    (deferred updating, so that a generation is one batch) over the search coordinates scaled to the
    unit box. A converged population is replaced by a new one from the initial distribution, until
    the budget ends.

    Parameters
    ----------
    strategy : str
        Strategy, one of `STRATEGIES`.
    popsize : int
        Members per parameter; a population has at least 5 members.
    maxiter : int
        Most generations of a population.
    tol, atol : float
        A population converges when the standard deviation of its losses is at most atol + tol times
        their mean.
    mutation_low, mutation_high : float
        Range of the dithered mutation constant.
    recombination : float
        Crossover probability.
    polish : bool
        Whether L-BFGS-B continues from the best member of a converged population, until a step
        gains less than 2.2e-9 of the loss. Its finite differences are charged. Losses are scaled up
        so that its other test, an absolute tolerance of the gradient, does not end it earlier.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    References
    ----------
    R. Storn and K. Price, J. Global Optim. 11, 1997.
    """

    loads = ("scipy.optimize",)
    strategy: str = "best1bin"
    popsize: int = 15
    maxiter: int = 1000
    tol: float = 0.01
    atol: float = 0.0
    mutation_low: float = 0.5
    mutation_high: float = 1.0
    recombination: float = 0.7
    polish: bool = True

    def __post_init__(self) -> None:
        one_of("strategy", self.strategy, STRATEGIES)
        whole("popsize", self.popsize, 1, 100_000)
        whole("maxiter", self.maxiter, 1)
        true_or_false(self, ["polish"])
        settings_at_least(self, ("tol", "atol", "mutation_low", "recombination"), 0)
        at_least("mutation_high", self.mutation_high, self.mutation_low)
        if self.mutation_high >= 2:
            raise ValueError(f"mutation_high is {self.mutation_high!r}; expected below 2")
        if self.recombination > 1:
            raise ValueError(f"recombination is {self.recombination!r}; expected at most 1")

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Evolve populations until the budget ends."""
        members = max(5, self.popsize * len(oracle.space))
        losses = UnitOracle(oracle, members, LEVEL)
        population = losses.start

        def objective(x: Array) -> Any:
            """Losses of columns (d, n), for SciPy's `vectorized`, or the loss of one point (d,)."""
            return losses(x.T) if x.ndim == 2 else float(losses(x[None])[0])

        box = scipy.optimize.Bounds(np.zeros(len(oracle.space)), np.ones(len(oracle.space)))
        while True:
            scipy.optimize.differential_evolution(
                objective,
                box,
                strategy=self.strategy,  # type: ignore[arg-type]
                maxiter=self.maxiter,
                tol=self.tol,
                atol=self.atol,
                mutation=(self.mutation_low, self.mutation_high),
                recombination=self.recombination,
                polish=self.polish,
                init=population,
                updating="deferred",
                vectorized=True,
                rng=rng,
            )
            population = losses.fresh(members, rng)
