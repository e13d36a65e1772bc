"""The cluster Gauss-Newton method: many points that share their linear models."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from miho.methods.unit_box import UnitBox
from miho.optim import Optimizer, Oracle, UnusableValueError
from miho.optim.space import LARGEST_BATCH
from miho.quantities import Array
from miho.validate import positive, whole

STOPPED = 1e10
"""A point stops when its damping has grown by this factor (CGNM)."""


@dataclass(frozen=True)
class ClusterGaussNewton(Optimizer):
    """Cluster Gauss-Newton method (Aoki, Hayami, Toshimoto and Sugiyama, 2022).

    N points, uniform over the box, move for up to `iterations`. Each point has a linear model of
    the residuals, fitted to all points' residuals by least squares with the weights 1 / distance^(2
    gamma) (Sec. 2.2, step 2-1), and tries the step that minimises the model's sum of squares with
    Tikhonov's damping lambda (2-2). If the step lowers the sum of squares, it is taken and lambda
    is divided by 10; otherwise the point stays and lambda is multiplied by 10 (2-3). The method
    needs no derivatives: an iteration costs one evaluation per point.

    Distances are in search coordinates scaled to the unit box; the publication scales them by the
    initial ranges, too. Lambda has the unit of the squared residuals and is relative to the median
    sum of squares of the first cluster, so that the method does not depend on that unit. A step
    across a bound is shortened to half of the way to it, and a point whose lambda has grown to 1e10
    times the first stops; both are as in the authors' R package CGNM. The first point is the first
    common initial configuration. N residual vectors are kept in memory. Requires a least-squares
    problem.

    The method is designed to find many solutions if data determine few parameters. For tire forces
    in wide boxes its points stop above the optimum, whether distances are scaled by the box or by
    the cluster, and whether steps stop half way to a bound or at it.

    Parameters
    ----------
    N : int
        Points of a cluster.
    iterations : int
        Most iterations of a cluster.
    damping : float
        Initial lambda, relative to the median sum of squares.
    gamma : float
        Exponent of the weights.
    rounds : int or None
        Number of clusters; None to continue until the budget ends.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    References
    ----------
    Y. Aoki, K. Hayami, K. Toshimoto and Y. Sugiyama, "Cluster Gauss-Newton method", Optimization
    and Engineering 23, 2022.
    """

    N: int = 250
    iterations: int = 25
    damping: float = 1.0
    gamma: float = 2.0
    rounds: int | None = 1

    def __post_init__(self) -> None:
        whole("N", self.N, 2, LARGEST_BATCH)
        whole("iterations", self.iterations, 1, LARGEST_BATCH)
        positive("damping", self.damping)
        positive("gamma", self.gamma)
        whole("rounds", self.rounds, 1, LARGEST_BATCH, none=True)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Move one cluster after the other."""
        common: Array | None = oracle.space.decode(oracle.space.initial(1))[0]
        for _ in count() if self.rounds is None else range(self.rounds):
            X, Y = self._first(oracle, rng, common)
            common = None
            if len(X):
                self._move(oracle, X, Y)

    def _first(
        self, oracle: Oracle, rng: np.random.Generator, common: Array | None
    ) -> tuple[Array, Array]:
        """Points (N, d) with usable residuals (N, m); empty if no draw of N has any."""
        box = UnitBox(oracle.space)
        X: list[Array] = []
        Y: list[Array] = []
        while len(X) < self.N:
            for x in rng.random((self.N - len(X), len(oracle.space))):
                theta = box.theta(x)
                if common is not None:
                    theta, common = common, None
                residuals = _residuals(oracle, theta)
                if residuals is not None:
                    X.append(box.x(theta))
                    Y.append(residuals)
            if not X:
                break
        return np.array(X), np.array(Y)

    def _move(self, oracle: Oracle, X: Array, Y: Array) -> None:
        """The main iteration from the cluster X (N, d) with residuals Y (N, m)."""
        box = UnitBox(oracle.space)
        squares = np.einsum("nm,nm->n", Y, Y)
        first = self.damping * float(np.median(squares))
        damping = np.full(self.N, first)
        for _ in range(self.iterations):
            moving = np.flatnonzero(damping < STOPPED * first)
            if not moving.size:
                break
            steps = cluster_steps(X, Y, damping, self.gamma, moving)
            for i, step in zip(moving, steps, strict=True):
                x = X[i] + within(X[i], step)
                residuals = _residuals(oracle, box.theta(x))
                if residuals is not None and residuals @ residuals < squares[i]:
                    X[i], Y[i], squares[i] = x, residuals, residuals @ residuals
                    damping[i] /= 10
                else:
                    damping[i] *= 10


def _residuals(oracle: Oracle, theta: Array) -> Array | None:
    """Residuals (m,) at parameters (d,); None if they are not usable."""
    try:
        residuals = oracle.residuals(theta)
    except UnusableValueError:
        return None
    return residuals if np.isfinite(residuals @ residuals) else None


def cluster_steps(
    X: Array, Y: Array, damping: Array, gamma: float, moving: NDArray[np.intp]
) -> Array:
    """Steps (k, d) of the k points `moving` of a cluster X (N, d) with residuals Y (N, m)."""
    # Scale by the largest residual, because squares may overflow.
    scale = float(np.abs(Y).max()) or 1.0
    Y, damping = Y / scale, damping[moving, None] / scale / scale
    if Y.shape[1] > len(Y):
        # Coordinates in the span of the residuals, which has at most N dimensions.
        R = np.asarray(np.linalg.qr(np.vstack([Y[1:] - Y[0], Y[:1]]).T, mode="r"))
        Y = R[:, -1] + np.vstack([np.zeros(len(R)), R[:, :-1].T])
    between = X - X[moving, None]
    squared = np.einsum("kjd,kjd->kj", between, between)
    apart = squared > 0
    nearest = np.min(squared, axis=1, initial=np.inf, where=apart)
    # Weights relative to the nearest point's: the fit is the same, and none is infinite.
    relative = np.divide(nearest[:, None], squared, out=np.zeros_like(squared), where=apart)
    weights = relative**gamma
    # (k, d, N) @ (N, m): the fit is linear in the differences of residuals.
    fit = np.linalg.pinv(weights[:, :, None] * between) * weights[:, None, :]
    slopes = (fit @ Y - fit.sum(axis=2)[:, :, None] * Y[moving, None]).transpose(0, 2, 1)
    U, s, Vt = np.linalg.svd(slopes, full_matrices=False)
    along = np.einsum("kmd,km->kd", U, Y[moving])
    bottom = s**2 + damping
    shrunk = np.divide(s * along, bottom, out=np.zeros_like(s), where=bottom > 0)
    return np.asarray(-np.einsum("kde,kd->ke", Vt, shrunk))


def within(x: Array, step: Array) -> Array:
    """The step (d,) from x in the unit cube; across a bound, half of the way to it."""
    bound = np.where(step > 0, 1.0, 0.0)
    crosses = np.abs(step) > np.abs(bound - x)
    return np.where(crosses, (bound - x) / 2, step)
