"""Kalman filter of tracking errors, on the model of the path tracker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_are

from miho.quantities import Array
from miho.vehicle.driving.path_tracking import SampledModel, between
from miho.vehicle.driving.sensors import Sensors

LATERAL, HEADING, YAW, RACK = 3.0, 0.1, 3.0, 0.1
"""Standard deviations of the process noise, white from one command to the next: lateral
acceleration [m/s^2], heading rate [rad/s], yaw acceleration [rad/s^2] and rack rate [rad/s]. The
values are chosen for this package, from errors of the steady feed-forward in a swerve. Without
noise of the heading, the car of CommonRoad leaves its line by 0.34 m instead of 0.26 m."""


@dataclass(frozen=True, eq=False)
class ErrorEstimator:
    """Estimator of x = [e_y, e_y', e_psi, e_psi', delta], relative to the steady turn.

    x_next = F x + G u with F (k, 5, 5) and G (k, 5) of `SampledModel`. L (k, 5, 5) are the steady
    gains of the Kalman filter, with measurements of all components of x. The matrices hold at
    rising speeds (k,) [m/s], with linear interpolation and constant extrapolation.

    The filter belongs to the corrected mode. The paper uses measured errors in Eq. 15, but no
    steering rack can follow their noise of 0.2 degrees.
    """

    speeds: Array
    F: Array
    G: Array
    L: Array

    @classmethod
    def of(cls, sampled: SampledModel, noise: Sensors, speeds: Array) -> ErrorEstimator:
        """Return the filter for sensors with this noise, with gains at rising speeds (k,) [m/s]."""
        d, period = sampled.delayed, sampled.period
        W = np.diag([0.0, LATERAL, HEADING, YAW, RACK]) * period
        rows = []
        for vx in speeds:
            F, G = sampled.matrices(float(vx))
            acting = F[:5, 4 + d] if d else G[:5]
            V = _measured(noise, float(vx))
            P = solve_discrete_are(F[:5, :5].T, np.eye(5), W @ W, V)
            rows.append((F[:5, :5], acting, P @ np.linalg.inv(P + V)))
        return cls(np.asarray(speeds, dtype=float), *map(np.array, zip(*rows, strict=True)))

    def correct(self, expected: Array, measured: Array, vx: float) -> Array:
        """Return the estimate (5,) from the expected and the measured x at a speed [m/s]."""
        return np.asarray(expected + between(self.speeds, self.L, vx) @ (measured - expected))

    def predict(self, x: Array, u: float, vx: float) -> Array:
        """Return x (5,) one period later.

        u [rad] is the command that reaches the rack, minus the steering of the steady turn.
        """
        F, G = (between(self.speeds, values, vx) for values in (self.F, self.G))
        return np.asarray(F @ x + G * u)


def _measured(noise: Sensors, vx: float) -> Array:
    """Return the covariance (5, 5) of a measurement of x; yaw noise acts on e_y' and e_psi."""
    stds = (noise.position, noise.vy, noise.yaw, noise.yaw_rate, noise.steering)
    V = np.diag(np.maximum(stds, 1e-6)) ** 2
    yaw = noise.yaw**2
    V[1, 1] += vx * vx * yaw
    V[1, 2] = V[2, 1] = vx * yaw
    return V
