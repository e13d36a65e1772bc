"""The multistart of Hickernell and Yuan, as implemented in R's gslnls."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from miho.methods.descent import (
    SMALLEST_TOLERANCE,
    Lowest,
    descend,
    ending_where_unusable,
    local_search,
)
from miho.methods.unit_box import Sobol, UnitBox
from miho.optim import Descent, Optimizer, Oracle, Space
from miho.optim.space import LARGEST_BATCH
from miho.quantities import Array
from miho.validate import at_least, positive, whole, whole_settings

LOWER = 0.99
"""A stationary point is new if its sum of squares is below this share of the best (gslnls)."""
CENTRED = 0.75
"""Initial power that draws starting points towards the values nearest to zero (gslnls)."""


@dataclass(frozen=True)
class HickernellYuan(Optimizer):
    """A simple multistart algorithm (Hickernell and Yuan, 1997), as in gslnls.

    A major iteration fills the sample up to N quasi-random points and concentrates it by p
    iterations of the local solver from each. The q best points are retained. A point that has been
    retained s times starts a search if it is within a share epsilon of the best. An end that is
    lower than the best by 1 % is a new stationary point; all other retained points count as worse.
    The run has converged with NSP stationary points, at least `least`, and more than r + sqrt(r)
    NSP worse points since the last. Then, or after `major` iterations, a final search continues
    from the best. Points with a rank-deficient Jacobian are dropped.

    Starting points are drawn towards the value of each range that is nearest to zero: a distance a
    from there becomes ((1 + a)^k - 1) / k, with k from the scales of the parameters at the last
    stationary point.

    The settings are documented in R's gslnls 1.4 by the publication's symbols (`mstart_n` is N, and
    so on). This implementation differs from gslnls: ranges are in search coordinates; the Sobol
    sequence is scrambled; its first point is the first common initial configuration; the local
    solver is SciPy's trust-region reflective solver, with one evaluation per iteration; and
    rank is judged with columns of norm 1, whereas gslnls uses a determinant that depends on the
    units. Requires a least-squares problem.

    Parameters
    ----------
    N : int
        Points of the sample.
    p : int
        Iterations of the local solver that concentrate the sample.
    q : int
        Retained points.
    r : float
        Controls the number of worse points before convergence.
    s : int
        Number of times that a point is retained before it starts a search.
    epsilon : float
        Share of the best sum of squares within which a point may start a search.
    search : int
        Most iterations of a search.
    major : int
        Most major iterations.
    least : int
        Smallest number of stationary points.
    final : int
        Most iterations of the final search.
    tolerance : float
        Relative tolerance of the local solver.
    rounds : int or None
        Number of complete repetitions; None to continue until the budget ends.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    References
    ----------
    F. J. Hickernell and Y. Yuan, "A simple multistart algorithm for global optimization", OR
    Transactions 1, 1997.
    """

    loads = ("scipy.stats",)

    N: int = 30
    p: int = 5
    q: int = 3
    r: float = 4.0
    s: int = 2
    epsilon: float = 0.25
    search: int = 10
    major: int = 250
    least: int = 1
    final: int = 100
    tolerance: float = math.sqrt(SMALLEST_TOLERANCE)
    rounds: int | None = 1

    def __post_init__(self) -> None:
        numbers = ("N", "p", "q", "s", "search", "major", "final")
        whole_settings(self, numbers, 1, LARGEST_BATCH)
        if self.q > self.N:
            raise ValueError(f"q is {self.q!r}; expected at most N, {self.N}")
        positive("r", self.r)
        at_least("epsilon", self.epsilon, 0)
        whole("least", self.least, 0)
        at_least("tolerance", self.tolerance, SMALLEST_TOLERANCE)
        whole("rounds", self.rounds, 1, LARGEST_BATCH, none=True)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Sample, concentrate and search until enough points were no better; `rounds` times."""
        common: Array | None = oracle.space.decode(oracle.space.initial(1))[0]
        for _ in count() if self.rounds is None else range(self.rounds):
            sample = _Sample(oracle.space, rng, self.N, common)
            common = None
            for _ in range(self.major):
                self._iterate(oracle, sample)
                if self.converged(sample.stationary, sample.worse):
                    break
            if math.isfinite(sample.best_loss):
                local_search(oracle, sample.best, self.tolerance, "trf", 1 + self.final)

    def converged(self, stationary: int, worse: int) -> bool:
        """Return whether NSP `stationary` and NWSP `worse` points are enough."""
        return stationary >= self.least and worse > self.r + math.sqrt(self.r) * stationary

    def _iterate(self, oracle: Oracle, sample: _Sample) -> None:
        """One major iteration (Algorithm 2.1)."""
        sample.fill()
        for i in range(self.N):
            sample.losses[i] = math.inf
            lowest, slopes = self._search(oracle, sample.thetas[i], self.p, nullcontext(Descent()))
            if slopes.full_rank:
                sample.thetas[i], sample.losses[i] = lowest.theta, lowest.loss
                if lowest.loss < LOWER * sample.best_loss:
                    sample.best, sample.best_loss = lowest.theta, lowest.loss
        for i in sample.retain(self.q, self.s):
            sample.worse += 1
            near = sample.losses[i] < (1 + self.epsilon) * sample.best_loss
            if sample.stationary and not near:
                continue
            record = oracle.starts.descent()
            lowest, slopes = self._search(oracle, sample.thetas[i], self.search, record)
            lower = not sample.stationary or lowest.loss < LOWER * sample.best_loss
            if lower and slopes.full_rank and math.isfinite(lowest.loss):
                sample.best, sample.best_loss = lowest.theta, lowest.loss
                sample.stationary, sample.worse = sample.stationary + 1, 0
                sample.power = (slopes.scale.min() / slopes.scale) ** 0.25

    def _search(
        self, oracle: Oracle, start: Array, iterations: int, record: AbstractContextManager[Descent]
    ) -> tuple[Lowest, _Slopes]:
        lowest, slopes = Lowest(oracle.residuals, start), _Slopes(oracle)
        with ending_where_unusable(), record as descent:
            descent.converged = descend(
                lowest, slopes, start, oracle.space, self.tolerance, "trf", 1 + iterations
            )
        return lowest, slopes


class _Slopes:
    """Jacobians (m, d) that record their scale and rank; ValueError if the first lacks full rank.

    `scale` (d,) are the largest norms of the columns, in search coordinates (Moré's scaling);
    `full_rank` refers to the last Jacobian.
    """

    def __init__(self, oracle: Oracle) -> None:
        self._oracle = oracle
        self._box = UnitBox(oracle.space)
        low, high = oracle.space.bounds
        self._range = high - low
        self.scale = np.zeros(len(oracle.space))
        self.full_rank = False

    def __call__(self, theta: Array) -> Array:
        jacobian = self._oracle.jacobian(theta)
        columns = jacobian * (self._box.slope(theta) / self._range)
        norms = np.linalg.norm(columns, axis=0)
        first, self.scale = not self.scale.any(), np.maximum(self.scale, norms)
        self.full_rank = bool((norms > 0).all()) and _independent(columns / norms)
        if first and not self.full_rank:
            raise ValueError("the Jacobian does not have full rank")
        return jacobian


def _independent(columns: Array) -> bool:
    """Return whether columns (m, d) of norm 1 are independent according to their Gram matrix."""
    smallest = np.linalg.eigvalsh(columns.T @ columns)[0]
    return bool(smallest > columns.shape[1] * SMALLEST_TOLERANCE)


class _Sample:
    """N points `thetas` (N, d) and their `losses`, with the best and the counts so far.

    `retained` (N,) counts the major iterations with a point among the q best. The first point is
    the `common` one, unless it is None.
    """

    def __init__(
        self, space: Space, rng: np.random.Generator, N: int, common: Array | None
    ) -> None:
        d = len(space)
        self._space, self._sobol, self._common = space, Sobol(d, rng), common
        self.thetas, self.losses = np.empty((N, d)), np.full(N, math.inf)
        self.retained: NDArray[np.int64] = np.zeros(N, np.int64)
        self.stationary = self.worse = 0
        self.best, self.best_loss, self.power = np.empty(d), math.inf, np.full(d, CENTRED)

    def fill(self) -> None:
        """Replace each point that is not retained by a new draw."""
        space = self._space
        low, high = space.bounds
        new = np.flatnonzero(self.retained == 0)
        coordinates = low + (high - low) * self._sobol.points(len(new))
        coordinates = towards_zero(coordinates, low, high, self.power)
        self.thetas[new] = space.clip(space.decode(coordinates))
        if self._common is not None:
            self.thetas[0], self._common = self._common, None

    def retain(self, q: int, s: int) -> list[int]:
        """Retain the q best; return and release the points retained for the s-th time."""
        best = np.argsort(self.losses, kind="stable")[:q]
        best = best[np.isfinite(self.losses[best])]
        counts = self.retained[best] + 1
        self.retained[:] = 0
        self.retained[best] = np.where(counts < s, counts, 0)
        return [int(i) for i in best[counts >= s]]


def towards_zero(coordinates: Array, low: Array, high: Array, power: Array) -> Array:
    """Coordinates (n, d) drawn to the value of their range that is nearest to zero (gslnls 1.4)."""
    nearest = np.clip(0.0, low, high)
    away = coordinates - nearest
    return np.asarray(nearest + np.sign(away) * ((1 + np.abs(away)) ** power - 1) / power)
