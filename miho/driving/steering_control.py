"""The steering command: feed-forward of curvature and bank, and the regulator's feedback."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from miho.driving.error_estimator import ErrorEstimator
from miho.driving.friction import demand
from miho.driving.path_tracking import SLOWEST, GainSchedule
from miho.driving.track import Projection, Track
from miho.driving.vehicle import Vehicle
from miho.models.axle import Axle
from miho.models.load_scaling import PROPORTIONAL, LoadSensitivity, growth
from miho.quantities import Array

STEEPEST = 0.15
"""Slip angle [rad] up to which an axle's curve is looked at."""


@dataclass(frozen=True, eq=False)
class AxleSlip:
    """The slip angle [rad] that gives an axle's lateral force, ISO-W, from its curve at a load.

    force (k,) rising [N] and slip (k,) [rad]: the part of the curve between its two peaks; beyond
    the peaks the slip stays there. load [N]: of the axle, both wheels. At another load the curve
    is stretched about its centre [rad] by `growth`; without sensitivity it grows in proportion.
    """

    load: float
    force: Array
    slip: Array
    centre: float = 0.0
    sensitivity: LoadSensitivity = PROPORTIONAL

    @classmethod
    def of(cls, axle: Axle, load: float, sensitivity: LoadSensitivity = PROPORTIONAL) -> AxleSlip:
        """The slip of an axle whose tires' curves hold at this load of both [N]."""
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

    def at(self, force: float, load: float) -> float:
        """The slip angle [rad] for a lateral force at a load of the axle [N]."""
        peak, stiffness = growth(max(load, 1.0) / self.load, self.sensitivity)
        slip = float(np.interp(force / peak, self.force, self.slip))
        return self.centre + (slip - self.centre) * float(peak / stiffness)


class FeedForward(NamedTuple):
    """A steady turn: the steering angle delta of the road wheels and the slip angle of the car at
    its centre of gravity, vy / vx [rad]."""

    steering: float
    slip: float


class SteeringState(NamedTuple):
    """What the controller remembers.

    past: the feedback parts of the last commands [rad], the newest first, (d,); sent: the whole
    commands likewise, at least one; expected: errors and steering at the next measurement, (5,), as
    `ErrorEstimator` has them. sent is empty and expected is None before the first command.
    """

    past: tuple[float, ...]
    sent: tuple[float, ...] = ()
    expected: Array | None = None


class TrackingError(NamedTuple):
    """xi of Eq. 13: how far left of the path [m], its rate [m/s], the heading's [rad], [rad/s]."""

    e_y: float
    e_y_rate: float
    e_psi: float
    e_psi_rate: float


@dataclass(frozen=True, eq=False)
class SteeringController:
    """u = u_ff - K (z - z_ff) on a line, with the state z of `SampledModel`.

    z_ff is the steady turn where the car is, and u_ff the angle of the one where it will be once
    delay and lag have passed; the axles' curves give the slip that it takes, on a bank less the
    part of the turn that weight does. The errors and the steering in z are estimates where there
    is an estimator, else as measured. The command never turns faster than the rack. Below 3 m/s
    there is no slip to speak of, and the path is followed by geometry alone.
    """

    vehicle: Vehicle
    schedule: GainSchedule
    front: AxleSlip
    rear: AxleSlip
    estimator: ErrorEstimator | None = None

    @property
    def period(self) -> float:
        """Time from one command to the next [s]."""
        return self.schedule.sampled.period

    @property
    def initial(self) -> SteeringState:
        """The state of a controller that has done nothing yet."""
        return SteeringState((0.0,) * self.schedule.sampled.delayed)

    def feed_forward(self, vx: float, curvature: float, bank: float) -> FeedForward:
        """What a steady turn asks at a speed [m/s], a curvature in the plan [1/m] and a bank."""
        car = self.vehicle
        lateral, gravity = (float(part) for part in demand(vx, curvature, bank))
        force = car.mass * lateral / car.wheelbase
        weight, air = car.mass * gravity / car.wheelbase, vx * vx
        slip_f = self.front.at(force * car.lr, weight * car.lr + car.C_l_front * air)
        slip_r = self.rear.at(force * car.lf, weight * car.lf + car.C_l_rear * air)
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
        """The steering command [rad] and the state after it.

        at: where the car is on the line; vx [m/s]; steering: measured angle of the wheels [rad].
        """
        if vx < SLOWEST:
            u = self._reachable(state, self._by_geometry(line, at, error))
            return u, _remember(state, 0.0, u, None)
        actuator = self.schedule.sampled.steering
        point = line.at(at.s)
        ahead = line.at(at.s + vx * (actuator.delay + actuator.lag))
        now = self.feed_forward(vx, float(point.curvature), float(point.bank))
        later = self.feed_forward(vx, float(ahead.curvature), float(ahead.bank))
        # A car that slips outward points into the turn.
        steady = np.array([0.0, 0.0, -now.slip, 0.0, now.steering])
        x = np.array([*error, steering]) - steady
        if self.estimator is not None and state.expected is not None:
            x = self.estimator.correct(state.expected - steady, x, vx)
        feedback = -float(self.schedule.at(vx) @ np.array([*x, *state.past]))
        u = self._reachable(state, later.steering + feedback)
        expected = None
        if self.estimator is not None:
            arriving = (u, *state.sent)[: len(state.past) + 1][-1]
            expected = steady + self.estimator.predict(x, arriving - now.steering, vx)
        return u, _remember(state, u - later.steering, u, expected)

    def _reachable(self, state: SteeringState, u: float) -> float:
        """The command [rad] nearest to u that the rack reaches from the last one in a period."""
        largest = self.vehicle.steering_max
        if state.sent:
            turn = self.vehicle.steering_rate * self.schedule.sampled.period
            u = min(max(u, state.sent[0] - turn), state.sent[0] + turn)
        return min(max(u, -largest), largest)

    def _by_geometry(self, line: Track, at: Projection, error: TrackingError) -> float:
        """The angle of an arc through the path 6 m ahead (pure pursuit)."""
        reach = 6.0
        bend = float(line.at(at.s + reach / 2).curvature)
        arc = bend - 2 * (error.e_y + reach * error.e_psi) / reach**2
        return math.atan(self.vehicle.wheelbase * arc)


def _remember(
    state: SteeringState, feedback: float, u: float, expected: Array | None
) -> SteeringState:
    """The state after one more command u [rad], of which a part is feedback."""
    d = len(state.past)
    return SteeringState((feedback, *state.past)[:d], (u, *state.sent)[: max(d, 1)], expected)


def tracking_error(
    line: Track, at: Projection, yaw: float, vx: float, vy: float, yaw_rate: float
) -> TrackingError:
    """The errors of a car at a point of a line; velocities [m/s], [rad/s] about its own axes."""
    point = line.at(at.s)
    e_psi = math.remainder(yaw - float(point.heading), math.tau)
    along = (vx * math.cos(e_psi) - vy * math.sin(e_psi)) / (1 - float(point.curvature) * at.e)
    sideways = vy * math.cos(e_psi) + vx * math.sin(e_psi)
    turning = float(point.curvature * np.cos(point.bank)) * along
    return TrackingError(at.e, sideways, e_psi, yaw_rate - turning)
