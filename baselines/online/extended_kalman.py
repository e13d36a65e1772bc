"""The extended Kalman filter of parameters that drift."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from baselines.online.alarms import ChangePointAlarm, Detector, LevelAlarm
from baselines.online.peer import Peer, PeerMethod
from baselines.online.setup import Setup
from miho.online import OnlineMethod
from miho.quantities import Array


@dataclass(frozen=True)
class ExtendedKalman(PeerMethod):
    """Extended Kalman filter; each parameter is a random walk, linearised in each row.

    Parameters
    ----------
    drift : float, optional
        Standard deviation of the walk of a parameter that may jump, as a share of its value, in
        one second.
    drift_of_others : float, optional
        The same for other parameters, in standard deviations of the offline estimate.
    resets : bool, optional
        Whether an alarm adds the variance of a jump to the covariance.
    detector : Detector, optional
        The alarm.

    References
    ----------
    Ljung, Asymptotic behavior of the extended Kalman filter as a parameter estimator for linear
    systems, IEEE Trans. Automatic Control 24 (1979). Simon, Optimal State Estimation (2006),
    Eq. 13.14 to 13.18. Gustafsson, Slip-based tire-road friction estimation, Automatica 33 (1997)
    (a change detector that resets the filter).
    """

    drift: float = 0.03
    drift_of_others: float = 0.1
    resets: bool = False
    detector: Detector = field(default_factory=LevelAlarm)

    def run(self, setup: Setup) -> Peer:
        """Return a run that has seen no row."""
        return _ExtendedKalmanRun(setup, self)


def change_point_filter(
    drift: float = 0.01, drift_of_others: float = 0.01, threshold: float = 3.0, hold: float = 1.5
) -> OnlineMethod:
    """Return an extended Kalman filter that a Bayesian change point resets.

    Parameters
    ----------
    drift, drift_of_others : float, optional
        As for `ExtendedKalman`.
    threshold, hold : float, optional
        As for `ChangePointAlarm`.

    Returns
    -------
    ExtendedKalman
        The filter.
    """
    return ExtendedKalman(drift, drift_of_others, True, ChangePointAlarm(threshold, hold=hold))


class _ExtendedKalmanRun(Peer):
    def __init__(self, setup: Setup, settings: ExtendedKalman) -> None:
        super().__init__(setup, settings.detector)
        self.walk = walk_variances(setup, settings.drift, settings.drift_of_others)
        self.resets = settings.resets

    def drift(self, seconds: Array) -> None:
        variances = seconds[:, None] * self.walk
        if self.resets:
            variances += self.watch.fired[:, None] * self.setup.changes**2
        self.covariance = with_process_noise(self.covariance, variances)

    def learn(self, x: Array, y: Array) -> None:
        f, J, r = self.setup.predicted(self.theta, x)
        start = self.theta
        for o in range(y.shape[1]):
            moved = np.sum(J[:, o] * (self.theta - start), axis=-1)
            residual = y[:, o] - f[:, o] - moved
            self.theta, self.covariance = kalman_update(
                self.theta, self.covariance, residual, J[:, o], r[:, o], self.setup
            )


def walk_variances(setup: Setup, drift: float, drift_of_others: float) -> Array:
    """Return the variances (S, d) that random walks gain in a second.

    The drifts are as for `ExtendedKalman`.
    """
    share = np.where(setup.changes > 0, drift, drift_of_others)
    return np.asarray((share * setup.sizes) ** 2)


def with_process_noise(P: Array, variances: Array) -> Array:
    """Return covariances (..., d, d) to which variances (..., d) are added."""
    P = P.copy()
    places = np.arange(P.shape[-1])
    P[..., places, places] += variances
    return P


def kalman_update(
    theta: Array, P: Array, residual: Array, slopes: Array, variance: Array, setup: Setup
) -> tuple[Array, Array]:
    """Return estimates (..., d) and covariances (..., d, d) after one output.

    `residual` (...) is the measured minus the predicted output; NaN is skipped. `slopes` (..., d)
    are the derivatives of the output, `variance` (...) is the variance of its noise, and `setup`
    has the bounds.
    """
    Pj = (P @ slopes[..., None])[..., 0]
    seen = np.isfinite(residual)
    gain = Pj * (seen / (np.sum(slopes * Pj, axis=-1) + variance))[..., None]
    theta = theta + gain * np.where(seen, residual, 0.0)[..., None]
    theta = np.minimum(np.maximum(theta, setup.low), setup.high)
    return theta, P - gain[..., :, None] * Pj[..., None, :]
