"""Differential evolution, SciPy's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.methods.unit_oracle import UnitOracle
from miho.optim import Optimizer, Oracle
from miho.quantities import Array
from miho.validate import at_least, one_of, whole

LEVEL = 1e12
"""The first loss is scaled to this, so that the polish ends by its relative tolerance."""

STRATEGIES = tuple(
    f"{base}{crossover}"
    for base in ("best1", "best2", "rand1", "rand2", "randtobest1", "currenttobest1")
    for crossover in ("bin", "exp")
)


@dataclass(frozen=True)
class DifferentialEvolution(Optimizer):
    """Storn and Price (J. Global Optim. 11, 1997), as `scipy.optimize.differential_evolution`.

    `popsize` members a parameter, at least 5, start at the common initial configurations and evolve
    generation by generation (deferred updating, so that a generation is one batch), over the search
    coordinates scaled to the unit box. `mutation_low` to `mutation_high` is the range of the
    dithered mutation constant. A population converges when the standard deviation of its losses is
    at most `tol` of their mean; with `polish`, L-BFGS-B then goes on from its best, with finite
    differences that are charged, until a step gains less than 2.2e-9 of the loss: losses are scaled
    up so far that its other test, of the gradient, which is absolute, does not end it before. A
    converged population is replaced by a fresh one drawn from the initial distribution, until the
    budget ends.
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
        for field in ("tol", "atol", "mutation_low", "recombination"):
            at_least(field, getattr(self, field), 0)
        at_least("mutation_high", self.mutation_high, self.mutation_low)
        if self.mutation_high >= 2:
            raise ValueError(f"mutation_high is {self.mutation_high!r}; expected below 2")
        if self.recombination > 1:
            raise ValueError(f"recombination is {self.recombination!r}; expected at most 1")

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Evolve one population after the other until the budget ends."""
        members = max(5, self.popsize * len(oracle.space))
        losses = UnitOracle(oracle, members, LEVEL)
        population = losses.start

        def objective(x: Array) -> Any:
            """Of columns (d, n), as SciPy's `vectorized` has it, or of one point (d,)."""
            return losses(x.T) if x.ndim == 2 else float(losses(x[None])[0])

        settings: dict[str, Any] = {
            "strategy": self.strategy,
            "maxiter": self.maxiter,
            "tol": self.tol,
            "atol": self.atol,
            "mutation": (self.mutation_low, self.mutation_high),
            "recombination": self.recombination,
            "polish": self.polish,
        }
        box = scipy.optimize.Bounds(np.zeros(len(oracle.space)), np.ones(len(oracle.space)))
        while True:
            scipy.optimize.differential_evolution(
                objective,
                box,
                init=population,
                updating="deferred",
                vectorized=True,
                rng=rng,
                **settings,
            )
            population = losses.fresh(members, rng)
