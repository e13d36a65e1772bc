"""A driver: plan, controllers and the conditions of a safe stop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from miho.validate import positive
from miho.vehicle.driving.as_printed import PrintedPlanner, PrintedSteering
from miho.vehicle.driving.local_plan import LocalPlanner, NoPathError, Obstacle
from miho.vehicle.driving.plant import Command, Motion
from miho.vehicle.driving.speed_control import SpeedController, SpeedState
from miho.vehicle.driving.steering_control import (
    SteeringController,
    SteeringState,
    TrackingError,
    tracking_error,
)
from miho.vehicle.driving.track import Projection, Track
from miho.vehicle.driving.velocity_planner import VelocityPlan, VelocityPlanner

LOST = 10.0
"""Offset from the line [m] at which a car makes a safe stop."""
SAFE_BRAKE = 6.0
"""Deceleration of a safe stop [m/s^2]."""
TOO_FAST = 0.5
"""Largest excess over the speed at the start of a plan that control can correct [m/s]."""
NEEDED = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "steering")
"""Measurements that the driver needs."""


class SlowZone(NamedTuple):
    """A stretch with a top speed [m/s], for example because of slower traffic.

    `start` and `end` [m] are arc lengths of the line, to which each lap adds its length.
    """

    start: float
    end: float
    top_speed: float


@dataclass(frozen=True)
class Pace:
    """Top speeds of successive laps, with ramps between them, and stretches with a lower one."""

    top_speeds: tuple[float, ...]  # of each lap [m/s]; the last one is used for all further laps
    ramp: float = 1.5  # rate at which the desired speed rises [m/s^2]
    brake_ramp: float = 1.5  # rate at which it falls [m/s^2]
    slow: tuple[SlowZone, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "top_speeds", tuple(self.top_speeds))
        object.__setattr__(self, "slow", tuple(self.slow))
        if not self.top_speeds or not all(0 < v < math.inf for v in self.top_speeds):
            raise ValueError(f"top_speeds is {self.top_speeds}; expected speeds above 0 m/s")
        positive("ramp", self.ramp, "[m/s^2]")
        positive("brake_ramp", self.brake_ramp, "[m/s^2]")
        for zone in self.slow:
            if not (0 <= zone.start < zone.end and 0 < zone.top_speed < math.inf):
                raise ValueError(
                    f"slow zone is {tuple(zone)}; expected a start [m] of at least 0, an end "
                    "beyond it and a top speed above 0 m/s"
                )

    def top(self, laps: int, distance: float) -> float:
        """Return the top speed [m/s] after a number of laps, at a distance over all laps [m]."""
        tops = [self.top_speeds[min(laps, len(self.top_speeds) - 1)]]
        return min(tops + [z.top_speed for z in self.slow if z.start <= distance < z.end])

    def step(self, cap: float, top: float, period: float) -> float:
        """Return the change [m/s] of the desired speed `cap` towards `top` in a period [s]."""
        return min(max(top - cap, -self.brake_ramp * period), self.ramp * period)


@dataclass(frozen=True)
class Sighting:
    """Obstacles, and the distance along the line [m] from which they are seen and avoided."""

    obstacles: tuple[Obstacle, ...]
    distance: float
    local: LocalPlanner
    velocity: VelocityPlanner | PrintedPlanner

    def __post_init__(self) -> None:
        if not self.distance > 0:
            raise ValueError(f"sight is {self.distance}; expected a distance above 0 m, or inf")

    def in_sight(self, line: Track, s: float) -> bool:
        """Return whether the first obstacle is seen from an arc length [m]."""
        return 0 <= (self.obstacles[0].s - s) % line.length <= self.distance

    def replan(self, line: Track, s: float, vx: float) -> VelocityPlan:
        """Return a plan around the obstacles from an arc length [m], at a speed vx [m/s].

        Raises ValueError if there is no such plan, or if the car is too fast for it.
        """
        plan = self.velocity.plan(self.local.path(line, self.obstacles, s))
        v, _ = plan.at(s)
        if vx > v + TOO_FAST:
            raise NoPathError(
                f"at {vx:.1f} m/s, {(self.obstacles[0].s - s) % line.length:.1f} m before the "
                f"obstacle, the car is too fast for the path around it, which allows {v:.1f} m/s"
            )
        return plan


def place(line: Track, motion: Motion, hint: float) -> tuple[Projection, TrackingError]:
    """Return the place of a motion on a line, near an arc length `hint` [m], and its errors."""
    at = line.project(motion.x, motion.y, hint)
    return at, tracking_error(line, at, motion.yaw, motion.vx, motion.vy, motion.yaw_rate)


class DriverState(NamedTuple):
    """State of a driver between commands.

    at and vx are the last position along the line [m] and speed [m/s]; laps and cap [m/s] belong
    to the pace. stopped is the reason for a safe stop, "" during normal driving.
    """

    plan: VelocityPlan
    at: float
    vx: float
    laps: int
    cap: float
    desired: float
    speed: SpeedState
    steering: SteeringState
    command: Command
    planned: bool
    stopped: str


@dataclass(frozen=True)
class Driver:
    """Driver that follows a plan by steering, throttle, brake and gear.

    The driver makes a safe stop if a measurement is not finite, if the offset exceeds 10 m, or if
    there is no path around an obstacle. During a safe stop it follows the line and brakes; missing
    measurements are estimated.

    Parameters
    ----------
    plan : VelocityPlan
        Line and speeds.
    speed : SpeedController
        Controller of throttle, brake and gear.
    steering : SteeringController or PrintedSteering
        Controller of the steering.
    pace : Pace, optional
        Top speeds of the laps.
    sighting : Sighting, optional
        Obstacles and their avoidance.
    live : PrintedPlanner, optional
        Planner that computes the desired speed from each measured motion by the printed equations.
        By default the desired speed is the speed of the plan.
    """

    plan: VelocityPlan
    speed: SpeedController
    steering: SteeringController | PrintedSteering
    pace: Pace | None = None
    sighting: Sighting | None = None
    live: PrintedPlanner | None = None

    @property
    def period(self) -> float:
        """Time from one command to the next [s]."""
        return self.steering.period

    def begin(self, motion: Motion) -> DriverState:
        """Return the initial state of a driver at a motion."""
        speed = self.speed.start(motion.vx)
        at = self.plan.line.project(motion.x, motion.y).s
        command = Command(gear=speed.gear)
        return DriverState(
            self.plan, at=at, vx=motion.vx, laps=0, cap=motion.vx, desired=motion.vx, speed=speed,
            steering=self.steering.initial, command=command, planned=False, stopped="",
        )  # fmt: skip

    def step(self, state: DriverState, motion: Motion) -> tuple[Command, DriverState]:
        """Return the next command for a measured motion, and the new state."""
        # Missing measurements are estimated and cause a safe stop.
        needed = NEEDED if self.live is None else (*NEEDED, "ay")
        unknown = [name for name in needed if not math.isfinite(getattr(motion, name))]
        if unknown:
            motion = self._guessed(state, motion, unknown)
            reason = f"{unknown[0]} is not finite"
            state = state._replace(stopped=state.stopped or reason)
        # Update the plan and its line, then the position on the line.
        state = self._replanned(state, motion.vx)
        at, error = place(state.plan.line, motion, state.at)
        laps = state.laps + (state.at - at.s > state.plan.line.length / 2)
        state = state._replace(at=at.s, laps=laps, vx=motion.vx)
        if abs(at.e) > LOST and not state.stopped:
            state = state._replace(stopped=f"{at.e:.1f} m off the line")
        # Steer also during a safe stop; the pedals follow the desired speed, or brake to a stop.
        steering, remembered = self.steering.command(
            state.steering, state.plan.line, at, error, motion.vx, motion.steering
        )
        state = state._replace(steering=remembered)
        if state.stopped:
            return self._brake(state, steering)
        desired, ax, cap = self._desired(state, motion)
        pedals, speed = self.speed.command(state.speed, desired, ax, motion.vx, self.period)
        command = Command(steering, pedals.throttle, pedals.brake, pedals.gear)
        return command, state._replace(cap=cap, desired=desired, speed=speed, command=command)

    def _guessed(self, state: DriverState, motion: Motion, unknown: Sequence[str]) -> Motion:
        """Return the motion with unknown parts estimated for braking on the line."""
        vx = max(state.vx - SAFE_BRAKE * self.period, 0.0)
        point = state.plan.line.at(state.at + vx * self.period)
        turn = self.steering.feed_forward(vx, float(point.curvature), float(point.bank))
        guess: dict[str, Any] = {
            "x": float(point.x), "y": float(point.y), "yaw": float(point.heading) - turn.slip,
            "vx": vx, "vy": vx * turn.slip, "steering": turn.steering,
            "yaw_rate": vx * float(point.curvature) * math.cos(float(point.bank)), "ay": 0.0,
        }  # fmt: skip
        return motion._replace(**{name: guess[name] for name in unknown})

    def _replanned(self, state: DriverState, vx: float) -> DriverState:
        """Return the state with a plan around the obstacles after they are seen."""
        sighting = self.sighting
        if sighting is None or state.planned or state.stopped:
            return state
        if not sighting.in_sight(self.plan.line, state.at):
            return state
        state = state._replace(planned=True)
        try:
            plan = sighting.replan(self.plan.line, state.at, vx)
        except ValueError as error:
            return state._replace(stopped=str(error))
        return state._replace(plan=plan, at=state.at * plan.line.length / self.plan.line.length)

    def _desired(self, state: DriverState, motion: Motion) -> tuple[float, float, float]:
        """Return the desired speed [m/s], its rate [m/s^2], and the cap of the pace [m/s]."""
        v, _ = state.plan.at(state.at)
        _, ax = state.plan.at(state.at + state.vx * self.speed.lead)
        if self.live is not None:
            point = state.plan.line.at(state.at)
            v, ax = self.live.speed(motion, float(point.curvature), float(point.bank)), 0.0
        if self.pace is None:
            return v, ax, state.cap
        driven = state.laps * state.plan.line.length + state.at
        rise = self.pace.step(state.cap, self.pace.top(state.laps, driven), self.period)
        cap = state.cap + rise
        return (v, ax, cap) if v <= cap else (cap, rise / self.period, cap)

    def _brake(self, state: DriverState, steering: float) -> tuple[Command, DriverState]:
        """Return the command of a safe stop, and the new state."""
        brake = self.speed.brake
        u = brake.command(SAFE_BRAKE * self.speed.vehicle.mass).u
        pressure = float(brake.pressure(u)[0])
        command = Command(steering, 0.0, pressure, state.command.gear)
        return command, state._replace(command=command, desired=0.0)
