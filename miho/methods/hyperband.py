"""Hyperband and successive halving as published: synchronous, with rows of data as the resource."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from miho.optim import Optimizer, Oracle
from miho.optim.schedule import Rung, hyperband_table, largest_bracket
from miho.optim.space import LARGEST_BATCH
from miho.validate import whole


@dataclass(frozen=True)
class Hyperband(Optimizer):
    """Hyperband (Li, Jamieson, DeSalvo, Rostamizadeh and Talwalkar, 2018), Alg. 1.

    The resource is data: a rung evaluates its configurations on r / R of the rows. The best one in
    eta of them is evaluated again on the next rung, on eta times as many rows. The last rung of
    every bracket uses all rows, and only its losses can become best. Configurations are drawn from
    the initial distribution; the first bracket uses the common ones. Brackets are repeated until
    the budget ends.

    Nothing is learned from one configuration for the next: this is random search that spends less
    on poor draws, and it cannot be better than the best draw. If the order of the rows matters,
    every rung uses all rows and is charged for them (`Problem.cost`), and its losses can become
    best; the method is then random search that evaluates good draws again.

    Parameters
    ----------
    R : int
        Ratio of all rows to the smallest resource.
    eta : int
        Factor between rungs.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    References
    ----------
    L. Li et al., "Hyperband: a novel bandit-based approach to hyperparameter optimization", JMLR
    18, 2018.
    """

    R: int = 81
    eta: int = 3

    def __post_init__(self) -> None:
        whole("R", self.R, 1)
        whole("eta", self.eta, 2)
        first = hyperband_table(self.R, self.eta, "floor")[0].n
        whole("R: configurations in the first bracket", first, 1, LARGEST_BATCH)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Repeat the brackets until the budget ends."""
        _repeat(hyperband_table(self.R, self.eta, "floor"), self.R, oracle, rng)


@dataclass(frozen=True)
class SuccessiveHalving(Optimizer):
    """Successive halving (Jamieson and Talwalkar, 2016) with rows of data as the resource.

    `n` configurations start on the fraction 1 / R of the rows, or up to eta times that if R is not
    a power of eta. Each rung keeps one in eta, at least one, and the last rung uses all rows, as in
    `Hyperband`. The method repeats with new configurations until the budget ends.

    Parameters
    ----------
    n : int
        Configurations of the first rung.
    R : int
        Ratio of all rows to the smallest resource.
    eta : int
        Factor between rungs.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    References
    ----------
    K. Jamieson and A. Talwalkar, "Non-stochastic best arm identification and hyperparameter
    optimization", AISTATS 2016.
    """

    n: int = 64
    R: int = 64
    eta: int = 2

    def __post_init__(self) -> None:
        whole("n", self.n, 1, LARGEST_BATCH)
        whole("R", self.R, 1)
        whole("eta", self.eta, 2)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Halve until the budget ends."""
        s = largest_bracket(self.R, self.eta, "floor")
        rungs = [
            Rung(s, j, max(1, self.n // self.eta**j), self.R * self.eta**j // self.eta**s)
            for j in range(s + 1)
        ]
        _repeat(rungs, self.R, oracle, rng)


def _repeat(rungs: Sequence[Rung], R: int, oracle: Oracle, rng: np.random.Generator) -> None:
    """Run the rungs repeatedly; each bracket draws new configurations."""
    space = oracle.space
    coordinates, losses = space.initial(rungs[0].n), np.zeros(rungs[0].n)
    for repetition in count():
        for rung in rungs:
            if rung.j > 0:
                coordinates = coordinates[np.argsort(losses, kind="stable")[: rung.n]]
            elif repetition > 0 or rung is not rungs[0]:
                coordinates = space.sample(rung.n, rng)
            losses = oracle(space.decode(coordinates), rung.mutations / R)
