"""Interacting multiple models: a quiet and a quick filter, plain or with guards."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from baselines.online.alarms import WIDER, Detector, LevelAlarm
from baselines.online.extended_kalman import kalman_update, walk_variances, with_process_noise
from baselines.online.peer import Peer, PeerMethod
from baselines.online.setup import TEACHING, Setup
from miho.quantities import Array

OUTLIERS = 0.02
"""Share of outliers."""
LONGEST_GAP = 1.0
"""Longest time that passes between two rows, with guards [s]."""


@dataclass(frozen=True)
class InteractingModels(PeerMethod):
    """Interacting multiple models (IMM) of extended Kalman filters with different drifts.

    Parameters
    ----------
    drifts : tuple of float, optional
        Drift of the watched parameters in each mode, as in `ExtendedKalman`.
    drift_of_others : float, optional
        As in `ExtendedKalman`, in all modes.
    to_quick, to_quiet : float, optional
        Probability in a row of a change from one mode to the next one, and back.
    guards : bool, optional
        Whether the filters have the guards of MIHO's tracker: a mixture with outliers as
        likelihood; a value that repeats exactly is skipped; a row with a small derivative by a
        watched parameter does not change it (Schmidt's consider filter); gaps of time are limited.
    resets : bool, optional
        Whether an alarm adds the variance of a jump to the covariances.
    detector : Detector, optional
        The alarm.

    References
    ----------
    Blom and Bar-Shalom, The interacting multiple model algorithm for systems with Markovian
    switching coefficients, IEEE Trans. Automatic Control 33 (1988).
    """

    drifts: tuple[float, ...] = (0.01, 0.1)
    drift_of_others: float = 0.1
    to_quick: float = 1e-3
    to_quiet: float = 0.1
    guards: bool = False
    resets: bool = False
    detector: Detector = field(default_factory=LevelAlarm)

    def __post_init__(self) -> None:
        object.__setattr__(self, "drifts", tuple(self.drifts))

    def run(self, setup: Setup) -> Peer:
        """Return a run that has seen no row."""
        return _InteractingModelsRun(setup, self)


class _InteractingModelsRun(Peer):
    """Modes are the second axis: estimates (S, N, d), covariances (S, N, d, d), shares (S, N)."""

    def __init__(self, setup: Setup, settings: InteractingModels) -> None:
        super().__init__(setup, settings.detector, skips_repeats=settings.guards)
        self.guards, self.resets = settings.guards, settings.resets
        modes = len(settings.drifts)
        others = settings.drift_of_others
        self.walks = np.stack([walk_variances(setup, q, others) for q in settings.drifts], axis=1)
        self.transitions = transitions(modes, settings.to_quick, settings.to_quiet)
        self.shares = np.full((len(setup.theta), modes), 0.01 / max(1, modes - 1))
        self.shares[:, 0] = 1.0 if modes == 1 else 0.99
        self.thetas = np.repeat(setup.theta[:, None], modes, axis=1)
        self.covariances = np.repeat(setup.covariance[:, None], modes, axis=1)
        self.least_slopes = TEACHING * setup.largest_slopes * (setup.changes > 0)[:, None]

    def drift(self, seconds: Array) -> None:
        if self.guards:
            seconds = np.minimum(seconds, LONGEST_GAP)
        if self.shares.shape[1] > 1:
            self._mix()
        variances = seconds[:, None, None] * self.walks
        if self.resets:
            variances += (self.watch.fired[:, None] * self.setup.changes**2)[:, None]
        self.covariances = with_process_noise(self.covariances, variances)

    def _mix(self) -> None:
        """Mix the modes; the shares become the predicted ones (Eq. 7 to 9)."""
        joint = self.shares[:, :, None] * self.transitions  # from mode i to mode j
        self.shares = joint.sum(axis=1)
        weights = joint / self.shares[:, None]
        means = weights.swapaxes(1, 2) @ self.thetas
        away = self.thetas[:, :, None] - means[:, None]
        spread = (weights[..., None] * away)[..., :, None] * away[..., None, :]
        d = away.shape[-1]
        flat = self.covariances.reshape(*self.shares.shape, d * d)
        mixed = (weights.swapaxes(1, 2) @ flat).reshape(self.covariances.shape)
        self.thetas, self.covariances = means, mixed + spread.sum(axis=1)

    def learn(self, x: Array, y: Array) -> None:
        inputs = np.broadcast_to(x[:, None], (*self.shares.shape, x.shape[1]))
        f, J, r = self.setup.predicted(self.thetas, inputs)
        start, log_likelihood = self.thetas, np.zeros(self.shares.shape)
        for o in range(y.shape[1]):
            j = J[:, :, o]
            e = y[:, None, o] - f[:, :, o] - np.sum(j * (self.thetas - start), axis=-1)
            S = np.sum(j * (self.covariances @ j[..., None])[..., 0], axis=-1) + r[:, :, o]
            log_likelihood += self._learn(e, j, r[:, :, o], S, self.least_slopes[:, None, o])
        log_likelihood -= log_likelihood.max(axis=1, keepdims=True)
        self._combine(self.shares * (np.exp(log_likelihood) + 1e-12))

    def _learn(self, e: Array, j: Array, r: Array, S: Array, least: Array) -> Array:
        """Update the modes by residuals of one output; returns their log likelihoods (S, N)."""
        seen = np.isfinite(e)
        square = np.where(seen, e, 0.0) ** 2
        if not self.guards:
            state = kalman_update(self.thetas, self.covariances, e, j, r, self.setup)
            self.thetas, self.covariances = state
            return np.where(seen, -0.5 * (square / S + np.log(S)), 0.0)
        wide = S + WIDER**2 * r
        inlier = (1 - OUTLIERS) * np.exp(-0.5 * square / S) / np.sqrt(S)
        outlier = OUTLIERS * np.exp(-0.5 * square / wide) / np.sqrt(wide)
        total = inlier + outlier + 1e-300
        noise = r + S * (1 / np.maximum(inlier / total, 1e-6) - 1)
        state = consider_update(
            self.thetas, self.covariances, e, j, noise, np.abs(j) >= least, self.setup
        )
        self.thetas, self.covariances = state
        return np.where(seen, np.log(total), 0.0)

    def _combine(self, weights: Array) -> None:
        """Set shares, estimate and covariance of the mixture (Eq. 12 to 14)."""
        self.shares = weights / weights.sum(axis=1, keepdims=True)
        self.probability = self.shares[:, 1:].sum(axis=1)
        self.theta = (self.shares[:, None] @ self.thetas)[:, 0]
        away = self.thetas - self.theta[:, None]
        d = away.shape[-1]
        flat = self.covariances.reshape(*self.shares.shape, d * d)
        mean = (self.shares[:, None] @ flat).reshape(-1, d, d)
        self.covariance = mean + (away * self.shares[..., None]).swapaxes(1, 2) @ away


def transitions(modes: int, to_next: float, back: float) -> Array:
    """Return the probability of a change from each mode (row) to each other one (column).

    `to_next` and `back` are the probabilities, in a row of data, of a change from a mode to the
    next one, and back.
    """
    matrix = np.zeros((modes, modes))
    for k in range(modes - 1):
        matrix[k, k + 1], matrix[k + 1, k] = to_next, back
    return matrix + np.diag(1 - matrix.sum(axis=1))


def consider_update(
    theta: Array,
    P: Array,
    residual: Array,
    slopes: Array,
    variance: Array,
    taught: NDArray[np.bool_],
    setup: Setup,
) -> tuple[Array, Array]:
    """Return the update that changes only the taught parameters (..., d), in Joseph's form.

    The other arguments and the results are as for `kalman_update`; see Simon, Optimal State
    Estimation (2006), Sec. 10.4 (reduced-order and consider filtering).
    """
    Pj = (P @ slopes[..., None])[..., 0]
    S = np.sum(slopes * Pj, axis=-1) + variance
    seen = np.isfinite(residual)
    gain = Pj * (seen / S)[..., None] * taught
    theta = theta + gain * np.where(seen, residual, 0.0)[..., None]
    theta = np.minimum(np.maximum(theta, setup.low), setup.high)
    cross = gain[..., :, None] * Pj[..., None, :]
    own = (S[..., None] * gain)[..., :, None] * gain[..., None, :]
    return theta, P + own - cross - cross.swapaxes(-1, -2)
