"""Compiled conversion of a desired acceleration to throttle or brake force (Sec. IV-B, Fig. 3).

Results agree with `Longitudinal.engine_torque` and `EngineMap.throttle` at one speed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from miho.vehicle.driving.compiling import compiled
from miho.vehicle.driving.plant_parameters import Engine
from miho.vehicle.driving.powertrain import cell


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

    vehicles (1,) has a record of a `Vehicle`.
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
