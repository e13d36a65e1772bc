"""The unscented Kalman filter of parameters that drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.online.extended_kalman import walk_variances, with_process_noise
from baselines.online.peer import Peer, PeerMethod
from baselines.online.setup import Setup
from miho.quantities import Array

UNSEEN = 1e12
"""Variance of the noise of a missing output, in variances of the noise."""


@dataclass(frozen=True)
class UnscentedKalman(PeerMethod):
    """Unscented Kalman filter for parameter estimation, with 2 d + 1 points.

    The defaults give all weight to the 2 d outer points, which keeps covariances positive
    definite in any dimension (the cubature filter of Arasaratnam and Haykin, 2009).

    Parameters
    ----------
    drift, drift_of_others : float, optional
        As in `ExtendedKalman`.
    alpha, beta, kappa : float, optional
        Spread of the points, weight of the central point in covariances, and Julier's parameter.

    References
    ----------
    Wan and van der Merwe, The unscented Kalman filter for nonlinear estimation (2000), Eq. 15 and
    Table 3.2 of their chapter in Haykin (ed.), Kalman Filtering and Neural Networks (2001).
    """

    drift: float = 0.03
    drift_of_others: float = 0.1
    alpha: float = 1.0
    beta: float = 0.0
    kappa: float = 0.0

    def run(self, setup: Setup) -> Peer:
        """Return a run that has seen no row."""
        return _UnscentedKalmanRun(setup, self)


class _UnscentedKalmanRun(Peer):
    def __init__(self, setup: Setup, settings: UnscentedKalman) -> None:
        super().__init__(setup)
        self.walk = walk_variances(setup, settings.drift, settings.drift_of_others)
        d = setup.theta.shape[1]
        self.spread = settings.alpha**2 * (d + settings.kappa)
        self.of_mean = np.full(2 * d + 1, 0.5 / self.spread)
        self.of_mean[0] = 1 - d / self.spread
        self.of_covariance = self.of_mean.copy()
        self.of_covariance[0] += 1 - settings.alpha**2 + settings.beta

    def drift(self, seconds: Array) -> None:
        self.covariance = with_process_noise(self.covariance, seconds[:, None] * self.walk)

    def learn(self, x: Array, y: Array) -> None:
        centre = self.theta[:, None]
        reach = np.linalg.cholesky(self.spread * self.covariance).swapaxes(1, 2)
        points = np.concatenate([centre, centre + reach, centre - reach], axis=1)
        inputs = np.broadcast_to(x[:, None], (*points.shape[:2], x.shape[1]))
        outputs, _, variances = self.setup.predicted(points, inputs)
        mean = np.sum(self.of_mean[:, None] * outputs, axis=1)
        away = outputs - mean[:, None]
        weighted = self.of_covariance[:, None] * away
        seen = np.isfinite(y)
        noise = np.where(seen, variances[:, 0], UNSEEN * variances[:, 0])
        S = weighted.swapaxes(1, 2) @ away + noise[:, :, None] * np.eye(y.shape[1])
        cross = (points - centre).swapaxes(1, 2) @ weighted
        gain = np.linalg.solve(S, cross.swapaxes(1, 2)).swapaxes(1, 2)
        residual = np.where(seen, y - mean, 0.0)
        theta = self.theta + (gain @ residual[..., None])[..., 0]
        self.theta = np.minimum(np.maximum(theta, self.setup.low), self.setup.high)
        P = self.covariance - gain @ cross.swapaxes(1, 2)
        self.covariance = (P + P.swapaxes(1, 2)) / 2
