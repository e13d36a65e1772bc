"""The particle filter of parameters that drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.online.extended_kalman import walk_variances
from baselines.online.peer import Peer, PeerMethod
from baselines.online.setup import Setup
from miho.quantities import Array

FLOOR = 1e-6
"""Least likelihood of a row in relation to a perfect one, so that none kills all."""


@dataclass(frozen=True)
class Particles(PeerMethod):
    """Bootstrap particle filter with systematic resampling; each parameter is a random walk.

    Parameters
    ----------
    size : int, optional
        Number of particles.
    drift, drift_of_others : float, optional
        As in `ExtendedKalman`.
    seed : int, optional
        Seed of the particles.

    References
    ----------
    Gordon, Salmond and Smith, IEE Proceedings F 140 (1993). Douc and Cappe, Comparison of
    resampling schemes for particle filtering (2005), Sec. 3 (systematic resampling).
    """

    size: int = 2000
    drift: float = 0.1
    drift_of_others: float = 0.1
    seed: int = 2

    def run(self, setup: Setup) -> Peer:
        """Return a run that has seen no row."""
        return _ParticlesRun(setup, self)


class _ParticlesRun(Peer):
    """Particles are the second axis: (S, n, d), with weights (S, n)."""

    def __init__(self, setup: Setup, settings: Particles) -> None:
        super().__init__(setup)
        self.rng = np.random.default_rng(settings.seed)
        self.walk = np.sqrt(walk_variances(setup, settings.drift, settings.drift_of_others))
        S, d = setup.theta.shape
        normal = self.rng.standard_normal((S, settings.size, d))
        self.thetas = setup.theta[:, None] + setup.deviations[:, None] * normal
        np.clip(self.thetas, setup.low, setup.high, out=self.thetas)
        self.weights = np.full((S, settings.size), 1 / settings.size)

    def drift(self, seconds: Array) -> None:
        normal = self.rng.standard_normal(self.thetas.shape)
        self.thetas += (np.sqrt(seconds)[:, None] * self.walk)[:, None] * normal
        np.clip(self.thetas, self.setup.low, self.setup.high, out=self.thetas)

    def learn(self, x: Array, y: Array) -> None:
        variances = self.setup.predicted(self.theta, x).variances
        errors = self.setup.outputs(self.thetas, x) - y[..., None]
        squares = np.nansum(errors**2 / variances[..., None], axis=1)
        self.weights = self.weights * (np.exp(-0.5 * squares) + FLOOR)
        self.weights /= self.weights.sum(axis=1, keepdims=True)
        self.theta = (self.weights[:, None] @ self.thetas)[:, 0]
        away = self.thetas - self.theta[:, None]
        self.covariance = (away * self.weights[..., None]).swapaxes(1, 2) @ away
        few = 1 / np.sum(self.weights**2, axis=1) < self.weights.shape[1] / 2
        for k in np.flatnonzero(few):
            self._resample(int(k))

    def _resample(self, k: int) -> None:
        """Draw particles in proportion to their weights, at equal distances from a random start."""
        n = self.weights.shape[1]
        places = (np.arange(n) + self.rng.random()) / n
        chosen = np.minimum(np.searchsorted(np.cumsum(self.weights[k]), places), n - 1)
        self.thetas[k] = self.thetas[k][chosen]
        self.weights[k] = 1 / n
