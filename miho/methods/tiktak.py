"""TikTak: local searches that start ever closer to the best point so far."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import count

import numpy as np

from miho.methods.descent import METHODS, SMALLEST_TOLERANCE, local_search
from miho.methods.least_squares import screening_losses
from miho.methods.unit_box import Sobol, UnitBox
from miho.optim import Optimizer, Oracle
from miho.optim.space import LARGEST_BATCH
from miho.quantities import Array
from miho.validate import at_least, one_of, positive, whole


@dataclass(frozen=True)
class TikTak(Optimizer):
    """TikTak (Arnoud, Guvenen and Kleineberg, 2019) with least squares.

    A round evaluates Sobol points and keeps the best share. It descends from the best, and from
    each of the others at a convex combination of that point and the lowest point of the round. The
    i-th of K points gives the latter the weight sqrt(i / K), within limits (Sec. 2.1), so the
    search changes from exploration to refinement.

    The Sobol points are scrambled anew in each round; the first of the run is the first common
    initial configuration. Convex combinations are in search coordinates. The local solver is the
    solver of `LeastSquares` instead of the authors' Nelder-Mead or DFNLS, so no final search with a
    finer tolerance is needed. Screening uses at most a fifth of the remaining evaluations and
    seconds. Requires a least-squares problem.

    Parameters
    ----------
    points : int
        Sobol points per parameter in each round.
    share : float
        Share of the points that is kept.
    lowest_weight, highest_weight : float
        Limits of the weight of the lowest point.
    rounds : int or None
        Number of rounds; None to continue until the budget ends.
    tolerance, method
        See `LeastSquares`.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    References
    ----------
    A. Arnoud, F. Guvenen and T. Kleineberg, "Benchmarking global optimizers", NBER working paper
    26340, 2019.
    """

    loads = ("scipy.stats",)
    points: int = 100
    share: float = 0.1
    lowest_weight: float = 0.1
    highest_weight: float = 0.995
    rounds: int | None = 1
    tolerance: float = 1e-10
    method: str = "trf"

    def __post_init__(self) -> None:
        whole("points", self.points, 1, LARGEST_BATCH)
        positive("share", self.share)
        at_least("lowest_weight", self.lowest_weight, 0)
        at_least("highest_weight", self.highest_weight, self.lowest_weight)
        for field in ("share", "highest_weight"):
            if getattr(self, field) > 1:
                raise ValueError(f"{field} is {getattr(self, field)!r}; expected at most 1")
        whole("rounds", self.rounds, 1, LARGEST_BATCH, none=True)
        at_least("tolerance", self.tolerance, SMALLEST_TOLERANCE)
        one_of("method", self.method, METHODS)

    def weight(self, i: int, K: int) -> float:
        """Weight of the lowest point so far in the start of the i-th of K searches, from 1."""
        if i == 1:
            return 0.0
        return min(max(self.lowest_weight, math.sqrt(i / K)), self.highest_weight)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Screen Sobol points and descend from the best, `rounds` times."""
        space = oracle.space
        box = UnitBox(space)
        n = self.points * len(space)
        common: Array | None = space.decode(space.initial(1))[0]
        for _ in count() if self.rounds is None else range(self.rounds):
            thetas = box.theta(Sobol(len(space), rng).points(n))
            if common is not None:
                thetas[0], common = common, None
            losses = screening_losses(oracle, thetas)
            order = np.argsort(losses, kind="stable")[: max(1, int(self.share * len(losses)))]
            self._descend(oracle, box, thetas[order[np.isfinite(losses[order])]])

    def _descend(self, oracle: Oracle, box: UnitBox, points: Array) -> None:
        """The local searches of a round from its best points (K, d), the best first."""
        best, least = points[:1].ravel(), math.inf
        for i, theta in enumerate(points, start=1):
            start = theta
            if math.isfinite(least):
                weight = self.weight(i, len(points))
                start = box.theta((1 - weight) * box.x(theta) + weight * box.x(best))
            lowest = local_search(oracle, start, self.tolerance, self.method)
            if lowest.loss < least:
                best, least = lowest.theta, lowest.loss
