"""Compiled conversion of a desired acceleration to throttle or brake force (Sec. IV-B, Fig. 3).

Results agree with `Longitudinal.engine_torque` and `EngineMap.throttle` at one speed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.compiling import compiled
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models.engine_map import EngineMap


class PowertrainModel(NamedTuple):
    """Engine and driveline of a controller; names and units of `EngineMap` and `Vehicle`."""

    openings: Array
    speeds: Array
    table: Array
    levers: Array  # engine speed over the car's, gear 1 first [rad/m]
    efficiency: float
    engine_inertia: float
    rolling_mass: float  # of the car and its wheels [kg]
    C_d: float
    C_r: float
    idle_speed: float


class Effort(NamedTuple):
    """Engine torque [Nm], throttle from 0 to 1, and brake force [N] for an acceleration.

    The brake force is in addition to the closed throttle, and negative if the engine must drive.
    """

    torque: float
    throttle: float
    brake: float


def powertrain_model(vehicle: Vehicle, engine: EngineMap) -> PowertrainModel:
    """Return the numbers of a vehicle with an engine map."""
    drive = vehicle.longitudinal
    gears = np.arange(1, len(vehicle.gear_ratios) + 1)
    return PowertrainModel(
        np.array(engine.openings), np.array(engine.speeds), np.array(engine.table),
        drive.engine_speed(1.0, gears), vehicle.efficiency, vehicle.engine_inertia,
        vehicle.mass + vehicle.wheel_inertia / vehicle.wheel_radius**2, vehicle.C_d, vehicle.C_r,
        vehicle.idle_speed,
    )  # fmt: skip


@compiled
def effort(m: PowertrainModel, ax: float, vx: float, gear: int) -> Effort:
    """Return the effort of an acceleration ax [m/s^2] at a speed [m/s] in a gear, without grade."""
    lever = m.levers[gear - 1]
    inertia = m.engine_inertia * lever * ax  # torque that turns the engine faster
    force = m.rolling_mass * ax + m.C_d * vx * vx + m.C_r  # through the gears to the wheels
    loss = m.efficiency if force >= 0 else 1 / m.efficiency
    torque = force / (loss * lever) + inertia

    omega = max(vx * lever, m.idle_speed)
    i = min(max(np.searchsorted(m.speeds, omega, side="right") - 1, 0), m.speeds.size - 2)
    part = min(max((omega - m.speeds[i]) / (m.speeds[i + 1] - m.speeds[i]), 0.0), 1.0)
    closed = (1 - part) * m.table[0, i] + part * m.table[0, i + 1]
    left = closed - inertia  # at the gears with the throttle closed
    drag = left * lever * (m.efficiency if left >= 0 else 1 / m.efficiency)
    throttle, below = 0.0, closed
    for k in range(1, m.openings.size):
        if below >= torque:
            break
        row = (1 - part) * m.table[k, i] + part * m.table[k, i + 1]
        if row > below:
            share = min((torque - below) / (row - below), 1.0)
            throttle = (1 - share) * m.openings[k - 1] + share * m.openings[k]
        below = max(row, below)
    return Effort(torque, throttle, drag - force)
