"""Throttle, brake and gear from a desired speed (Sec. IV-B, Fig. 3)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from miho.validate import settings_at_least
from miho.vehicle.driving.compiling import compiled, record_of
from miho.vehicle.driving.powertrain import Engine, cell, engine_of
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models import Brake, EngineMap
from miho.vehicle.models.engine import RPM


@dataclass(frozen=True, kw_only=True)
class SpeedSettings:
    """Gains and rules of the speed controller.

    Throttle and brake change over if the desired force differs from the force of the closed
    throttle by more than `dead_band`.
    """

    feedback: float = 1.0  # desired acceleration per speed error [1/s]
    integral: float = 0.2  # desired acceleration per integral of the speed error [1/s^2]
    integral_max: float = 1.0  # limit of this acceleration [m/s^2]
    dead_band: float = 150.0  # [N]
    dwell: float = 0.2  # shortest time on one pedal [s]
    shift_up: float = 6400 * RPM  # engine speeds at which the gear changes [rad/s]
    shift_down: float = 3900 * RPM
    shift_dwell: float = 0.5  # shortest time in one gear [s]
    brake_max: float = 20.0  # largest deceleration [m/s^2]

    def __post_init__(self) -> None:
        settings_at_least(self, [field.name for field in fields(self)], 0)
        if self.shift_down >= self.shift_up:
            raise ValueError(
                f"shift_down is {self.shift_down:g} rad/s; expected below shift_up, which is "
                f"{self.shift_up:g} rad/s"
            )


class SpeedState(NamedTuple):
    """State of the controller: pedal and gear, each with the time since its last change [s]."""

    integral: float = 0.0  # of the speed error, as an acceleration [m/s^2]
    braking: bool = False
    since: float = math.inf
    gear: int = 1
    gear_since: float = math.inf


class Pedals(NamedTuple):
    """Throttle from 0 to 1, brake pressure of the front circuit [Pa], and gear from 1."""

    throttle: float
    brake: float
    gear: int


@dataclass(frozen=True)
class SpeedController:
    """Controller from desired acceleration to force, then to throttle or brake pressure.

    `engine` and `brake` are identified models; their inverses are the look-up tables of Fig. 3.
    Drag, rolling resistance and rotating mass of the vehicle are compensated by feed-forward.
    """

    vehicle: Vehicle
    engine: EngineMap
    brake: Brake
    settings: SpeedSettings = SpeedSettings()

    @property
    def lead(self) -> float:
        """Time by which commands precede the plan [s].

        It is the response time of the brakes, and about the spool time of the engine.
        """
        return self.brake.delay + self.brake.tau_rise

    def start(self, vx: float) -> SpeedState:
        """Return the initial state at a speed [m/s], in a suitable gear."""
        gear = 1
        while gear < len(self.vehicle.gear_ratios) and (
            self._engine_speed(vx, gear + 1) > self.settings.shift_down
        ):
            gear += 1
        return SpeedState(gear=gear)

    def command(
        self, state: SpeedState, desired: float, ax: float, vx: float, period: float
    ) -> tuple[Pedals, SpeedState]:
        """Return pedals for a desired speed [m/s] and its rate ax [m/s^2], and the new state.

        vx is the measured speed [m/s], and period the time since the last command [s].
        """
        miss, rules = desired - vx, self.settings
        integral = state.integral + rules.integral * miss * period
        integral = min(max(integral, -rules.integral_max), rules.integral_max)
        a = max(ax + rules.feedback * miss + integral, -rules.brake_max)
        gear, gear_since = self._gear(state, vx, period)
        needed = effort(*self._numbers, a, vx, gear)
        braking, since = self._pedal(state, needed.brake, period)
        throttle, pressure = 0.0, 0.0
        if braking:
            u = self.brake.command(max(needed.brake, 0.0)).u
            pressure = float(self.brake.pressure(u)[0])
        else:
            throttle = needed.throttle
            if (throttle >= 1.0 and miss > 0) or (throttle <= 0.0 and miss < 0):
                integral = state.integral  # anti-windup
        return Pedals(throttle, pressure, gear), SpeedState(
            integral, braking, since, gear, gear_since
        )

    @cached_property
    def _numbers(self) -> tuple[Engine, Any]:
        """Engine and vehicle for compiled code."""
        vehicles = np.array([record_of(vars(self.vehicle))])
        return engine_of(self.vehicle, self.engine), vehicles

    def _engine_speed(self, vx: float, gear: int) -> float:
        return vx * float(self._numbers[0].ratios[gear - 1] / self.vehicle.wheel_radius)

    def _pedal(self, state: SpeedState, excess: float, period: float) -> tuple[bool, float]:
        """Return whether to brake, and the time since the last change [s]."""
        since = state.since + period
        beyond = -excess if state.braking else excess
        if beyond > self.settings.dead_band and since >= self.settings.dwell:
            return not state.braking, 0.0
        return state.braking, since

    def _gear(self, state: SpeedState, vx: float, period: float) -> tuple[int, float]:
        """Return the gear, and the time since the last shift [s]."""
        since = state.gear_since + period
        omega = self._engine_speed(vx, state.gear)
        if since >= self.settings.shift_dwell:
            if omega > self.settings.shift_up and state.gear < len(self.vehicle.gear_ratios):
                return state.gear + 1, 0.0
            if omega < self.settings.shift_down and state.gear > 1:
                return state.gear - 1, 0.0
        return state.gear, since


class Effort(NamedTuple):
    """Engine torque [Nm], throttle from 0 to 1, and brake force [N] for an acceleration.

    The brake force is in addition to the closed throttle, and negative if the engine must drive.
    """

    torque: float
    throttle: float
    brake: float


@compiled
def effort(e: Engine, vehicles: Any, ax: float, vx: float, gear: int) -> Effort:
    """Return the effort of an acceleration ax [m/s^2] at a speed [m/s] in a gear, without grade.

    vehicles (1,) has a record of a `Vehicle`. Results agree with `Longitudinal.engine_torque` and
    `EngineMap.throttle` at one speed.
    """
    v = vehicles[0]
    lever = e.ratios[gear - 1] / v.wheel_radius
    inertia = v.engine_inertia * lever * ax  # torque that turns the engine faster
    rolling_mass = v.mass + v.wheel_inertia / v.wheel_radius**2
    force = rolling_mass * ax + v.C_d * vx * vx + v.C_r  # through the gears to the wheels
    loss = v.efficiency if force >= 0 else 1 / v.efficiency
    torque = force / (loss * lever) + inertia

    omega = max(vx * lever, v.idle_speed)
    # Rows of the map at this speed, from the closed throttle up to the first one that is enough.
    i = cell(e.speeds, omega)
    part = min(max((omega - e.speeds[i]) / (e.speeds[i + 1] - e.speeds[i]), 0.0), 1.0)
    closed = (1 - part) * e.table[0, i] + part * e.table[0, i + 1]
    left = closed - inertia  # at the gears with the throttle closed
    drag = left * lever * (v.efficiency if left >= 0 else 1 / v.efficiency)
    throttle, below = 0.0, closed
    for k in range(1, e.openings.size):
        if below >= torque:
            break
        row = (1 - part) * e.table[k, i] + part * e.table[k, i + 1]
        if row > below:
            share = min((torque - below) / (row - below), 1.0)
            throttle = (1 - share) * e.openings[k - 1] + share * e.openings[k]
        below = max(row, below)
    return Effort(torque, throttle, drag - force)
