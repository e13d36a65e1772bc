"""Path tracking (Sec. IV-C): a linear-quadratic regulator over speed, with feed-forward.

Symbols follow Eq. 13-15 and Rajamani, Vehicle Dynamics and Control (2011), Ch. 2.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

from miho.quantities import Array, g
from miho.validate import positive
from miho.vehicle.driving.plant import Sensors
from miho.vehicle.models.single_track import SingleTrack

SLOWEST = 3.0
"""Speed [m/s] below which slip is not defined well, and the path is followed by geometry."""
SPEEDS = np.geomspace(SLOWEST, 90.0, 32)
"""Speeds [m/s] of the gain schedule, denser at low speed."""
LATERAL, HEADING, YAW, RACK = 3.0, 0.1, 3.0, 0.1
"""Standard deviations of the process noise, white from one command to the next: lateral
acceleration [m/s^2], heading rate [rad/s], yaw acceleration [rad/s^2] and rack rate [rad/s]. The
values are chosen for this package, from errors of the steady feed-forward in a swerve. Without
noise of the heading, the car of CommonRoad leaves its line by 0.34 m instead of 0.26 m."""


@dataclass(frozen=True, kw_only=True)
class LateralModel:
    """Path errors of a single-track car with linear tires (Eq. 13).

        xi = [e_y, e_y', e_psi, e_psi'],   xi' = A xi + B1 delta + B2 psi_des' + B3 sin(bank)

    e_y [m] is the offset of the car to the left of the path, e_psi [rad] the heading relative to
    the path, delta [rad] the steering angle, and psi_des' = vx kappa [rad/s] the yaw rate of the
    path. bank is positive if the left side is lower.

    C_f and C_r [N/rad] are the cornering stiffnesses of the axles, each the sum of both tires
    (Eq. 14, no factor 2). Arrays (k,) hold at rising speeds (k,) [m/s], because downforce increases
    the stiffness of an axle, with linear interpolation and constant extrapolation.
    """

    car: SingleTrack
    C_f: float | Array
    C_r: float | Array
    speeds: Array = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        for name in ("C_f", "C_r"):
            values = np.atleast_1d(getattr(self, name))
            if values.shape != self.speeds.shape or not ((values > 0) & np.isfinite(values)).all():
                raise ValueError(
                    f"{name} is {getattr(self, name)}; expected a positive number [N/rad] for each "
                    f"of {self.speeds.size} speeds"
                )

    def stiffnesses(self, vx: float) -> tuple[float, float]:
        """Return C_f and C_r [N/rad] at a speed [m/s]."""
        front, rear = (
            float(np.interp(vx, self.speeds, np.atleast_1d(C))) for C in (self.C_f, self.C_r)
        )
        return front, rear

    def matrices(self, vx: float) -> tuple[Array, Array, Array, Array]:
        """Return A (4, 4), B1, B2 and B3 (4,) at a speed [m/s] above 0."""
        if not 0 < vx < math.inf:
            raise ValueError(f"vx is {vx}; expected a speed above 0 m/s")
        m, lf, lr, Izz = self.car.mass, self.car.lf, self.car.lr, self.car.Izz
        C_f, C_r = self.stiffnesses(vx)
        total, turn = C_f + C_r, C_f * lf - C_r * lr
        square = C_f * lf**2 + C_r * lr**2
        A = np.array(
            [
                [0, 1, 0, 0],
                [0, -total / (m * vx), total / m, -turn / (m * vx)],
                [0, 0, 0, 1],
                [0, -turn / (Izz * vx), turn / Izz, -square / (Izz * vx)],
            ]
        )
        B1 = np.array([0, C_f / m, 0, C_f * lf / Izz])
        B2 = np.array([0, -turn / (m * vx) - vx, 0, -square / (Izz * vx)])
        return A, B1, B2, np.array([0, g, 0, 0])


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Q = diag(e_y, e_y_rate, e_psi, e_psi_rate) and R = steering of Eq. 15."""

    e_y: float = 1.0
    e_y_rate: float = 0.0
    e_psi: float = 1.0
    e_psi_rate: float = 0.0
    steering: float = 10.0

    def __post_init__(self) -> None:
        state = (self.e_y, self.e_y_rate, self.e_psi, self.e_psi_rate)
        if not all(0 <= w < math.inf for w in state) or self.e_y == 0:
            raise ValueError(f"weights are {state}; expected numbers of at least 0, e_y above 0")
        if not 0 < self.steering < math.inf:
            raise ValueError(f"steering is {self.steering}; expected a weight above 0")

    @property
    def Q(self) -> Array:  # noqa: N802
        """Weights of xi, (4, 4)."""
        return np.diag([self.e_y, self.e_y_rate, self.e_psi, self.e_psi_rate])


def continuous_gains(model: LateralModel, weights: Weights, vx: float) -> Array:
    """Return K (4,) of delta = -K xi as printed (Eq. 15), in continuous time without delay."""
    A, B1, _, _ = model.matrices(vx)
    P = solve_continuous_are(A, B1[:, None], weights.Q, np.array([[weights.steering]]))
    return np.asarray(B1 @ P / weights.steering)


@dataclass(frozen=True, kw_only=True)
class SteeringActuator:
    """Steering actuator with a dead time and a first-order lag [s]."""

    delay: float
    lag: float

    def __post_init__(self) -> None:
        if not 0 <= self.delay < math.inf or not 0 < self.lag < math.inf:
            raise ValueError(
                f"delay is {self.delay} s and lag is {self.lag} s; expected at least 0 and above 0"
            )


@dataclass(frozen=True, kw_only=True)
class SampledModel:
    """A `LateralModel` with its steering, sampled with a command every period [s].

    z = [xi, delta, u_1, ..., u_d]     delta: angle of the road wheels, u_i: the command i
    z_next = F z + G u                 periods ago, d = delay / period, a whole number
    """

    model: LateralModel
    steering: SteeringActuator
    period: float

    def __post_init__(self) -> None:
        positive("period", self.period, "of seconds")

    @property
    def delayed(self) -> int:
        """Number of periods d of the delay, rounded."""
        return round(self.steering.delay / self.period)

    def matrices(self, vx: float) -> tuple[Array, Array]:
        """Return F (5 + d, 5 + d) and G (5 + d,) at a speed [m/s] above 0, for held commands."""
        A, B1, _, _ = self.model.matrices(vx)
        joint = np.zeros((6, 6))
        joint[:4, :4], joint[:4, 4] = A, B1
        joint[4, 4:] = np.array([-1, 1]) / self.steering.lag
        transition = expm(joint * self.period)
        d = self.delayed
        F, G = np.zeros((5 + d, 5 + d)), np.zeros(5 + d)
        F[:5, :5] = transition[:5, :5]
        if d == 0:
            G[:5] = transition[:5, 5]
        else:
            F[:5, 4 + d] = transition[:5, 5]
            F[6:, 5:-1] = np.eye(d - 1)
            G[5] = 1.0
        return F, G

    def gains(self, weights: Weights, vx: float) -> Array:
        """Return K (5 + d,) of u = -K z that minimizes the sum of Eq. 15 over the samples."""
        F, G = self.matrices(vx)
        Q = np.zeros_like(F)
        Q[:4, :4] = weights.Q
        R = np.array([[weights.steering]])
        P = solve_discrete_are(F, G[:, None], Q, R)
        return np.asarray(G @ P @ F / (weights.steering + G @ P @ G))


@dataclass(frozen=True, eq=False)
class GainSchedule:
    """Gains K (k, 5 + d) at rising speeds (k,) [m/s], with linear interpolation."""

    sampled: SampledModel
    speeds: Array
    K: Array

    @classmethod
    def of(
        cls, sampled: SampledModel, weights: Weights, speeds: Array | None = None
    ) -> GainSchedule:
        """Return the optimal gains at rising speeds [m/s], by default `SPEEDS`."""
        speeds = SPEEDS if speeds is None else np.asarray(speeds, float)
        if speeds.ndim != 1 or speeds.size < 2 or not (np.diff(speeds) > 0).all() or speeds[0] <= 0:
            raise ValueError(f"speeds are {speeds}; expected rising numbers above 0 m/s")
        return cls(sampled, speeds, np.array([sampled.gains(weights, float(v)) for v in speeds]))

    def at(self, vx: float) -> Array:
        """Return K (5 + d,) at a speed [m/s]."""
        return between(self.speeds, self.K, vx)


def between(speeds: Array, values: Array, vx: float) -> Array:
    """Interpolate values (k, ...) at rising speeds (k,) [m/s]; constant beyond the ends."""
    right = min(max(int(np.searchsorted(speeds, vx)), 1), speeds.size - 1)
    low, high = speeds[right - 1], speeds[right]
    part = min(max((vx - low) / (high - low), 0.0), 1.0)
    return np.asarray((1 - part) * values[right - 1] + part * values[right])


@dataclass(frozen=True, eq=False)
class ErrorEstimator:
    """Kalman filter of x = [e_y, e_y', e_psi, e_psi', delta], relative to the steady turn.

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
