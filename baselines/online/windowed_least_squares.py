"""Levenberg-Marquardt with a warm start on the newest rows, or on all rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.online.peer import Peer, PeerMethod
from baselines.online.setup import Setup
from miho.quantities import Array

CLOSE = 1e-4
"""Steps below this share of the sizes of the parameters end the iterations."""
GROWTH = 1024
"""Number of rows by which the storage of all rows grows."""


@dataclass(frozen=True)
class WindowedLeastSquares(PeerMethod):
    """Levenberg-Marquardt on a window of rows, from the estimate of the row before.

    The offline estimate is a prior; parameters that may jump may be away from it by a jump.

    Parameters
    ----------
    rows : int or None, optional
        Length of the window; None stands for all rows.
    iterations : int, optional
        Largest number of iterations; 1 gives the real-time iteration, 20 converges.
    huber : float, optional
        Residuals above this number of standard deviations count linearly.
    every : int, optional
        A fit is made after each such number of rows.

    References
    ----------
    Marquardt, J. SIAM 11 (1963). Diehl, Bock and Schloeder, A real-time iteration scheme, SIAM J.
    Control Optim. 43 (2005) (one iteration per row). Huber, Robust Statistics (1981), Sec. 7.8.
    """

    rows: int | None = 100
    iterations: int = 1
    huber: float = 2.5
    every: int = 1

    def run(self, setup: Setup) -> Peer:
        """Return a run that has seen no row."""
        return _WindowedLeastSquaresRun(setup, self)


class _WindowedLeastSquaresRun(Peer):
    def __init__(self, setup: Setup, settings: WindowedLeastSquares) -> None:
        super().__init__(setup)
        self.settings = settings
        self.anchor = 1 / (setup.deviations**2 + setup.changes**2)
        self.damping = np.zeros(len(setup.theta))
        length = settings.rows or GROWTH
        self.X = np.empty((len(setup.theta), length, len(setup.columns)))
        self.Y = np.empty((len(setup.theta), length, len(setup.system.outputs)))
        self.taken = 0

    def drift(self, seconds: Array) -> None:
        """The window forgets by rows, not by time."""

    def learn(self, x: Array, y: Array) -> None:
        length = self.X.shape[1]
        if self.settings.rows is None and self.taken == length:
            self.X = np.concatenate([self.X, np.empty_like(self.X)], axis=1)
            self.Y = np.concatenate([self.Y, np.empty_like(self.Y)], axis=1)
            length *= 2
        self.X[:, self.taken % length], self.Y[:, self.taken % length] = x, y
        self.taken += 1
        if self.taken % self.settings.every == 0:
            count = min(self.taken, length)
            self._fit(self.X[:, :count], self.Y[:, :count])

    def _fit(self, X: Array, Y: Array) -> None:
        """Marquardt's iterations: a step that lowers the loss is taken, else the damping grows."""
        loss, A, b = self._equations(self.theta, X, Y)
        diagonal, ended = np.eye(b.shape[1]), np.zeros(len(b), dtype=bool)
        for _ in range(self.settings.iterations):
            damped = A * (1 + self.damping[:, None, None] * diagonal)
            step = np.linalg.solve(damped, b[..., None])[..., 0]
            theta = np.clip(self.theta + step, self.setup.low, self.setup.high)
            trial = self._equations(theta, X, Y)
            better = (trial[0] <= loss) & ~ended
            self.theta = np.where(better[:, None], theta, self.theta)
            loss = np.where(better, trial[0], loss)
            A = np.where(better[:, None, None], trial[1], A)
            b = np.where(better[:, None], trial[2], b)
            smaller = np.where(self.damping > 1e-6, self.damping / 10, 0.0)
            larger = np.where(ended, self.damping, np.maximum(10 * self.damping, 1e-3))
            self.damping = np.where(better, smaller, larger)
            ended |= better & np.all(np.abs(step) < CLOSE * self.setup.sizes, axis=1)
            if ended.all():
                break
        self.covariance = np.asarray(np.linalg.inv(A), dtype=float)

    def _equations(self, theta: Array, X: Array, Y: Array) -> tuple[Array, Array, Array]:
        """Return the loss (S,), and matrix and right-hand side of the normal equations."""
        thetas = np.broadcast_to(theta[:, None], (*X.shape[:2], theta.shape[1]))
        f, J, r = self.setup.predicted(thetas, X)
        sigma, huber = np.sqrt(r), self.settings.huber
        e = np.where(np.isfinite(Y), (Y - f) / sigma, 0.0)
        size = np.abs(e)
        weights = np.minimum(1.0, huber / np.maximum(size, huber)) * np.isfinite(Y)
        S, d = theta.shape
        slopes = (J / sigma[..., None]).reshape(S, -1, d)
        weighted = (slopes * weights.reshape(S, -1, 1)).swapaxes(1, 2)
        move = self.setup.theta - theta
        A = weighted @ slopes + self.anchor[:, None] * np.eye(d)
        b = (weighted @ e.reshape(S, -1, 1))[..., 0] + self.anchor * move
        losses = np.where(size < huber, e**2 / 2, huber * (size - huber / 2))
        return losses.sum(axis=(1, 2)) + 0.5 * np.sum(self.anchor * move**2, axis=1), A, b
