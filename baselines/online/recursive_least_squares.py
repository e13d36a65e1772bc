"""Recursive least squares with forgetting, on the model linearised at the offline estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.online.extended_kalman import kalman_update
from baselines.online.peer import Peer, PeerMethod
from baselines.online.setup import Setup
from miho.quantities import Array


@dataclass(frozen=True)
class RecursiveLeastSquares(PeerMethod):
    """Recursive least squares with exponential forgetting.

    The model is linearised once, at the offline estimate, in the parameters that may jump and in
    those in which it is linear. With a small `reach` only rows with small derivatives by the
    watched parameters count: a tire at small slip, whose force then gives its stiffness, and the
    grip changes in proportion to it.

    Parameters
    ----------
    forgetting : float, optional
        Factor by which the weight of a row falls with each later row.
    reach : float, optional
        Largest derivative by a watched parameter, as a share of the largest one offline, of the
        rows that count.

    References
    ----------
    Ljung, System Identification: Theory for the User (1999), Eq. 11.14. Gustafsson, Slip-based
    tire-road friction estimation, Automatica 33 (1997) (stiffness as a measure of the grip).
    """

    forgetting: float = 0.98
    reach: float = 0.4

    def run(self, setup: Setup) -> Peer:
        """Return a run that has seen no row."""
        return _RecursiveLeastSquaresRun(setup, self)


class _RecursiveLeastSquaresRun(Peer):
    def __init__(self, setup: Setup, settings: RecursiveLeastSquares) -> None:
        super().__init__(setup)
        self.forgetting = settings.forgetting
        linear = {
            name
            for output in setup.system.outputs
            for name, own in zip(output.parameters, output.model.parameters, strict=True)
            if own in output.model.linear
        }
        self.learns = (setup.changes[0] > 0) | np.isin(setup.names, list(linear))
        self.limits = settings.reach * setup.largest_slopes[..., setup.watched]

    def drift(self, seconds: Array) -> None:
        """Forgetting is by rows, not by time."""

    def learn(self, x: Array, y: Array) -> None:
        setup = self.setup
        f, J, r = setup.predicted(setup.theta, x)
        for o in range(y.shape[1]):
            slopes = J[:, o] * self.learns
            moved = np.sum(slopes * (self.theta - setup.theta), axis=-1)
            residual = y[:, o] - f[:, o] - moved
            Pj = (self.covariance @ slopes[..., None])[..., 0]
            information = np.sum(slopes * Pj, axis=-1) / r[:, o]
            within = np.all(np.abs(J[:, o][:, setup.watched]) <= self.limits[:, o], axis=-1)
            # Forgetting without information would let the covariance grow for ever.
            counts = within & (information > 1 - self.forgetting) & np.isfinite(residual)
            forgotten = np.where(counts, self.forgetting, 1.0)
            P = self.covariance / np.where(self.learns, forgotten[:, None], 1.0)[:, None]
            residual = np.where(counts, residual, np.nan)
            self.theta, P = kalman_update(self.theta, P, residual, slopes, r[:, o], setup)
            self.covariance = (P + P.swapaxes(1, 2)) / 2
