"""Steering control by feed-forward of curvature and bank, and feedback of the regulator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.friction import demand
from miho.vehicle.driving.path_tracking import SLOWEST, ErrorEstimator, GainSchedule
from miho.vehicle.driving.track import Projection, Track, TrackPoint
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models.axle import Axle
from miho.vehicle.models.load_scaling import PROPORTIONAL, LoadSensitivity, growth

STEEPEST = 0.15
"""Largest slip angle of an axle's curve [rad]."""


@dataclass(frozen=True, eq=False)
class AxleSlip:
    """Slip angle of an axle as a function of lateral force and load, ISO-W.

    The curve (k,) has rising lateral forces between the two peaks; beyond the peaks the slip is
    constant. At another load, it is stretched about its centre by `growth`.
    """

    load: float  # of both wheels [N]
    force: Array  # [N]
    slip: Array  # [rad]
    centre: float = 0.0  # [rad]
    sensitivity: LoadSensitivity = PROPORTIONAL

    @classmethod
    def of(cls, axle: Axle, load: float, sensitivity: LoadSensitivity = PROPORTIONAL) -> AxleSlip:
        """Return the slip of an axle with curves at this load of both wheels [N]."""
        slip = np.linspace(-STEEPEST, STEEPEST, 601)
        force = axle.force(slip)
        left, right = int(np.argmax(force)), int(np.argmin(force))
        if not load > 0 or left >= right or not (np.diff(force[left : right + 1]) < 0).all():
            raise ValueError(
                f"the axle has a load of {load:g} N and lateral forces of {force[left]:.4g} N at "
                f"{slip[left]:.3g} rad and {force[right]:.4g} N at {slip[right]:.3g} rad; expected "
                "a force that falls with the slip angle between its peaks (ISO-W)"
            )
        part = slice(left, right + 1)
        centre = float(axle.left[-2] + axle.right[-2]) / 2  # Sx
        return cls(load, force[part][::-1], slip[part][::-1], centre, sensitivity)

    def at(self, force: float, load: float, friction: float = 1.0) -> float:
        """Return the slip angle [rad] for a lateral force [N] at a load of the axle [N].

        friction [-] multiplies the peaks of the curve, and leaves its stiffness.
        """
        peak, stiffness = growth(max(load, 1.0) / self.load, self.sensitivity)
        peak = friction * peak
        slip = float(np.interp(force / peak, self.force, self.slip))
        return self.centre + (slip - self.centre) * float(peak / stiffness)

    def peaks(self, load: float, friction: float = 1.0) -> tuple[float, float]:
        """Return the slip angles [rad] of the largest forces to the left and to the right."""
        return self.at(math.inf, load, friction), self.at(-math.inf, load, friction)


class FeedForward(NamedTuple):
    """Steering angle delta of the road wheels [rad] and slip angle vy / vx [rad] in a steady turn.

    The slip angle refers to the centre of gravity.
    """

    steering: float
    slip: float


class SteeringState(NamedTuple):
    """State of the controller.

    past has the feedback parts of the last d commands [rad], the newest first. sent has the whole
    commands, at least one. expected are errors and steering at the next measurement, (5,), as in
    `ErrorEstimator`. Before the first command, sent is empty and expected is None.
    """

    past: tuple[float, ...]
    sent: tuple[float, ...] = ()
    expected: Array | None = None


class TrackingError(NamedTuple):
    """xi of Eq. 13: offset to the left [m] and its rate [m/s], heading error [rad], [rad/s]."""

    e_y: float
    e_y_rate: float
    e_psi: float
    e_psi_rate: float


@dataclass(frozen=True, eq=False)
class SteeringController:
    """Controller u = u_ff - K (z - z_ff) on a line, with the state z of `SampledModel`.

    z_ff is the steady turn at the position of the car, and u_ff is the steering angle of the steady
    turn at its position after delay and lag. The slip follows from the curves of the axles; on a
    bank, weight contributes to the lateral force. The errors and the steering in z are estimates of
    `estimator`, or measurements without it. The command is limited to the rate of the rack. Below
    3 m/s the path is followed by geometry only, without slip. `friction` is the friction of the
    road, relative to the curves [-].
    """

    vehicle: Vehicle
    schedule: GainSchedule
    front: AxleSlip
    rear: AxleSlip
    estimator: ErrorEstimator | None = None
    friction: float = 1.0

    @property
    def period(self) -> float:
        """Time between commands [s]."""
        return self.schedule.sampled.period

    @property
    def initial(self) -> SteeringState:
        """State before the first command."""
        return SteeringState((0.0,) * self.schedule.sampled.delayed)

    def feed_forward(self, vx: float, curvature: float, bank: float) -> FeedForward:
        """Return the steady turn at a speed [m/s], plan curvature [1/m] and bank [rad]."""
        car = self.vehicle
        lateral, gravity = (float(part) for part in demand(vx, curvature, bank))
        force = car.mass * lateral / car.wheelbase
        weight, air = car.mass * gravity / car.wheelbase, vx * vx
        slip_f = self.front.at(force * car.lr, weight * car.lr + car.C_l_front * air, self.friction)
        slip_r = self.rear.at(force * car.lf, weight * car.lf + car.C_l_rear * air, self.friction)
        bend = curvature * math.cos(bank)  # of the path along the surface
        return FeedForward(bend * car.wheelbase + slip_r - slip_f, slip_r + bend * car.lr)

    def command(
        self,
        state: SteeringState,
        line: Track,
        at: Projection,
        error: TrackingError,
        vx: float,
        steering: float,
    ) -> tuple[float, SteeringState]:
        """Return the steering command [rad] and the new state.

        `at` is the position on the line, vx the speed [m/s], and steering the measured angle of the
        wheels [rad].
        """
        if vx < SLOWEST:
            u = self._reachable(state, self._by_geometry(line, at, error))
            return u, _remember(state, 0.0, u, None)
        actuator = self.schedule.sampled.steering
        point = line.at(at.s)
        ahead = line.at(at.s + vx * (actuator.delay + actuator.lag))
        now = self.feed_forward(vx, float(point.curvature), float(point.bank))
        later = self.feed_forward(vx, float(ahead.curvature), float(ahead.bank))
        # The heading error of a steady turn is the negative slip angle.
        steady = np.array([0.0, 0.0, -now.slip, 0.0, now.steering])
        x = np.array([*error, steering]) - steady
        if self.estimator is not None and state.expected is not None:
            x = self.estimator.correct(state.expected - steady, x, vx)
        feedback = -float(self.schedule.at(vx) @ np.array([*x, *state.past]))
        u = self._reachable(
            state, self._below_peak(later.steering + feedback, error, at, point, vx)
        )
        expected = None
        if self.estimator is not None:
            arriving = (u, *state.sent)[: len(state.past) + 1][-1]
            expected = steady + self.estimator.predict(x, arriving - now.steering, vx)
        return u, _remember(state, u - later.steering, u, expected)

    def _below_peak(
        self, u: float, error: TrackingError, at: Projection, point: TrackPoint, vx: float
    ) -> float:
        """Return u [rad] limited to the slip angles of the front axle between its peaks."""
        car = self.vehicle
        along = vx * math.cos(error.e_psi) / (1 - float(point.curvature) * at.e)
        vy = error.e_y_rate - vx * math.sin(error.e_psi)
        turning = float(point.curvature) * math.cos(float(point.bank)) * along
        drift = (vy + car.lf * (error.e_psi_rate + turning)) / vx
        _, gravity = demand(vx, float(point.curvature), float(point.bank))
        load = car.mass * float(gravity) * car.lr / car.wheelbase + car.C_l_front * vx * vx
        left, right = self.front.peaks(load, self.friction)
        return min(max(u, drift - right), drift - left)

    def _reachable(self, state: SteeringState, u: float) -> float:
        """Return u [rad] limited to angles that the rack reaches within a period."""
        largest = self.vehicle.steering_max
        if state.sent:
            turn = self.vehicle.steering_rate * self.schedule.sampled.period
            u = min(max(u, state.sent[0] - turn), state.sent[0] + turn)
        return min(max(u, -largest), largest)

    def _by_geometry(self, line: Track, at: Projection, error: TrackingError) -> float:
        """Return the angle of an arc to the path 6 m ahead (pure pursuit)."""
        reach = 6.0
        bend = float(line.at(at.s + reach / 2).curvature)
        arc = bend - 2 * (error.e_y + reach * error.e_psi) / reach**2
        return math.atan(self.vehicle.wheelbase * arc)


def _remember(
    state: SteeringState, feedback: float, u: float, expected: Array | None
) -> SteeringState:
    """Return the state after a command u [rad] with its feedback part."""
    d = len(state.past)
    return SteeringState((feedback, *state.past)[:d], (u, *state.sent)[: max(d, 1)], expected)


def tracking_error(
    line: Track, at: Projection, yaw: float, vx: float, vy: float, yaw_rate: float
) -> TrackingError:
    """Return the errors of a car at a point of a line, from velocities in the axes of the car."""
    point = line.at(at.s)
    e_psi = math.remainder(yaw - float(point.heading), math.tau)
    along = (vx * math.cos(e_psi) - vy * math.sin(e_psi)) / (1 - float(point.curvature) * at.e)
    sideways = vy * math.cos(e_psi) + vx * math.sin(e_psi)
    turning = float(point.curvature * np.cos(point.bank)) * along
    return TrackingError(at.e, sideways, e_psi, yaw_rate - turning)
