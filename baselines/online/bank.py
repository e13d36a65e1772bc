"""A bank of fixed configurations, of which the best on the newest rows is the estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.online.peer import Peer, PeerMethod
from baselines.online.setup import Setup
from miho.quantities import Array


@dataclass(frozen=True)
class Bank(PeerMethod):
    """Fixed random configurations; the one with the least squares on a window is the estimate.

    Parameters that may jump are uniform from 0.3 to 1.3 of their offline value, others are normal
    around it. There is no covariance.

    Parameters
    ----------
    size : int, optional
        Number of configurations.
    rows : int, optional
        Length of the window.
    seed : int, optional
        Seed of the configurations.

    References
    ----------
    Bank of 10,000 random tires: "LLA-MPC: Fast adaptive control for autonomous racing" (2025),
    look-back window of the model errors.
    """

    size: int = 10_000
    rows: int = 20
    seed: int = 1

    def run(self, setup: Setup) -> Peer:
        """Return a run that has seen no row."""
        return _BankRun(setup, self)


class _BankRun(Peer):
    def __init__(self, setup: Setup, settings: Bank) -> None:
        super().__init__(setup)
        rng = np.random.default_rng(settings.seed)
        S, d = setup.theta.shape
        normal = rng.standard_normal((settings.size, d))
        uniform = rng.uniform(0.3, 1.3, (settings.size, d))
        thetas = np.where(
            setup.changes[:, None] > 0,
            setup.theta[:, None] * uniform,
            setup.theta[:, None] + setup.deviations[:, None] * normal,
        )
        self.thetas = np.clip(thetas, setup.low, setup.high)
        self.squares = np.zeros((settings.rows, S, settings.size))
        self.total = np.zeros((S, settings.size))
        self.used = 0
        self.covariance = np.full_like(self.covariance, np.nan)

    def drift(self, seconds: Array) -> None:
        """The configurations are fixed."""

    def learn(self, x: Array, y: Array) -> None:
        errors = (self.setup.outputs(self.thetas, x) - y[..., None]).swapaxes(1, 2)
        errors /= self.setup.system.sigma
        place = self.used % len(self.squares)
        self.total -= self.squares[place]
        self.squares[place] = np.nansum(errors**2, axis=2)
        self.total += self.squares[place]
        self.used += 1
        best = np.argmin(self.total, axis=1)
        self.theta = self.thetas[np.arange(len(best)), best]
