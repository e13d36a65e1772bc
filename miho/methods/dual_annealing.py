"""Dual annealing of SciPy."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # loads its subpackages on first use: importing them takes a second

from miho.methods.unit_box import UnitOracle
from miho.optim import Optimizer, Oracle
from miho.quantities import Array
from miho.validate import true_or_false, whole

LEVEL = 1e3
"""Scaled first loss: about the increase that a step may have at first (5230 / 6)."""


@dataclass(frozen=True)
class DualAnnealing(Optimizer):
    """Generalised simulated annealing with local search (Xiang et al., 1997).

    `scipy.optimize.dual_annealing` searches the search coordinates scaled to the unit box, because
    its visiting steps and the differences of its local search (L-BFGS-B; all evaluations are
    charged) have the same absolute size for all parameters. It starts at the first common initial
    configuration, then at new draws from the initial distribution, until the budget ends.

    Temperatures are differences of losses: with `accept` = -5, no increase larger than a sixth of
    the temperature is accepted. SciPy's temperature falls from 5230 to 1.5e-4 in a thousand steps.
    Losses are scaled so that the first loss is 1000, so the walk is free at first and at the end
    refuses any increase of more than 2.5e-8 of the first loss.

    Parameters
    ----------
    maxiter : int
        Steps per start.
    initial_temp : float
        Initial temperature.
    restart_temp_ratio : float
        SciPy restarts the annealing at this relative temperature.
    visit, accept : float
        Parameters of the visiting and the acceptance distribution.
    local_search : bool
        Whether to use the local search.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    References
    ----------
    Y. Xiang et al., Phys. Lett. A 233, 1997.
    """

    loads = ("scipy.optimize",)
    maxiter: int = 1000
    initial_temp: float = 5230.0
    restart_temp_ratio: float = 2e-5
    visit: float = 2.62
    accept: float = -5.0
    local_search: bool = True

    def __post_init__(self) -> None:
        whole("maxiter", self.maxiter, 1)
        true_or_false(self, ["local_search"])
        for field, low, high in (
            ("initial_temp", 0.01, 5e4),
            ("restart_temp_ratio", 0.0, 1.0),
            ("visit", 1.0, 3.0),
            ("accept", -1e4, -5.0),
        ):
            value = getattr(self, field)
            if not low < value <= high:
                raise ValueError(f"{field} is {value!r}; expected above {low:g}, at most {high:g}")

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Anneal repeatedly until the budget ends."""
        losses = UnitOracle(oracle, 1, LEVEL)
        start = losses.start[0]

        def objective(x: Array) -> float:
            return float(losses(x[None])[0])

        box = [(0.0, 1.0)] * len(oracle.space)
        while True:
            scipy.optimize.dual_annealing(
                objective,
                box,
                x0=start,
                maxiter=self.maxiter,
                initial_temp=self.initial_temp,
                restart_temp_ratio=self.restart_temp_ratio,
                visit=self.visit,
                accept=self.accept,
                no_local_search=not self.local_search,
                maxfun=math.inf,
                rng=rng,
            )
            start = losses.fresh(1, rng)[0]
