"""Compiled engine, clutch, gears, differential and brakes of a simulated car."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.compiling import part
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models import Brake, EngineMap

CUT = 20.0
"""Range above the largest engine speed over which the limiter closes the throttle [rad/s]."""
STICTION = 1.0
"""Wheel speed [rad/s] below which braking torques fade, so that the wheel comes to rest."""


class Engine(NamedTuple):
    """Engine with names and units of `EngineMap`; ratios are engine turns per wheel turn [-]."""

    openings: Array
    speeds: Array
    table: Array
    ratios: Array


def engine_of(vehicle: Vehicle, engine: EngineMap) -> Engine:
    """Return an engine with the gears of a vehicle."""
    ratios = np.array(vehicle.gear_ratios, dtype=float) * vehicle.final_drive
    return Engine(engine.openings.copy(), engine.speeds.copy(), engine.table.copy(), ratios)


@part
def map_torque(e: Engine, omega: float, throttle: float) -> float:
    """Return the torque [Nm] at an engine speed [rad/s] and an opening, as `EngineMap.torque`."""
    i = cell(e.speeds, omega)
    k = cell(e.openings, throttle)
    right = (omega - e.speeds[i]) / (e.speeds[i + 1] - e.speeds[i])
    up = (throttle - e.openings[k]) / (e.openings[k + 1] - e.openings[k])
    right, up = min(max(right, 0.0), 1.0), min(max(up, 0.0), 1.0)
    low = (1 - right) * e.table[k, i] + right * e.table[k, i + 1]
    high = (1 - right) * e.table[k + 1, i] + right * e.table[k + 1, i + 1]
    torque: float = (1 - up) * low + up * high
    return torque


@part
def cell(axis: Array, at: float) -> int:
    """Return the cell of a rising axis with a point, the first or last one beyond the ends."""
    low, high = 0, axis.size - 2
    while low < high:
        middle = (low + high + 1) // 2
        if axis[middle] <= at:
            low = middle
        else:
            high = middle - 1
    return low


@part
def engine_speed(e: Engine, v: Vehicle, gear: int, closed: bool, rear: float) -> tuple[float, bool]:
    """Return the engine speed [rad/s], and whether the clutch locks it to the rear wheels.

    Below the idle speed, the clutch slips and the engine keeps the idle speed.
    """
    if gear == 0:
        return v.idle_speed, False
    locked = e.ratios[gear - 1] * rear
    return max(locked, v.idle_speed), closed and locked >= v.idle_speed


@part
def torque_rate(e: Engine, v: Vehicle, torque: float, omega: float, throttle: float) -> float:
    """Return the rate of the engine torque [Nm/s], which follows the map with a lag."""
    allowed = min(max((v.engine_speed_max + CUT - omega) / CUT, 0.0), 1.0)
    steady = map_torque(e, omega, throttle * allowed)
    rate: float = (steady - torque) / (v.spool_rise if steady > torque else v.spool_fall)
    return rate


@part
def rear_accelerations(
    e: Engine,
    v: Vehicle,
    gear: int,
    closed: bool,
    torque: float,
    left: float,
    right: float,
    outer: tuple[float, float],
) -> tuple[float, float]:
    """Return the accelerations of the rear wheels [rad/s^2] at speeds left and right [rad/s].

    torque is the engine torque [Nm], and outer the torque of tire and brake on each wheel [Nm].
    Gears and engine inertia act on the mean of both wheels, as in `Longitudinal`.
    """
    I = v.wheel_inertia / 4  # noqa: E741
    total = outer[0] + outer[1]
    mean = total / (2 * I)
    _, locked = engine_speed(e, v, gear, closed, (left + right) / 2)
    if locked:
        ratio = e.ratios[gear - 1]
        drives = torque >= v.engine_inertia * ratio * mean
        lever = ratio * (v.efficiency if drives else 1 / v.efficiency)
        mean = (total + lever * torque) / (2 * I + lever * v.engine_inertia * ratio)
    elif closed and gear > 0:
        mean += e.ratios[gear - 1] * v.efficiency * max(torque, 0.0) / (2 * I)
    through_gears = 2 * I * mean - total
    across = v.differential_damping * (left - right)
    return (
        (outer[0] + through_gears / 2 - across) / I,
        (outer[1] + through_gears / 2 + across) / I,
    )


@part
def braking_torques(v: Vehicle, b: Brake, pressure: float) -> tuple[float, float]:
    """Return the torques that slow a front and a rear wheel [Nm] at a front pressure [Pa].

    Rolling resistance is distributed as the weight.
    """
    front = b.K_front / 2 * max(pressure - b.P0_front, 0.0)
    rear = b.K_rear / 2 * max(pressure * ((1 - b.bias) / b.bias) - b.P0_rear, 0.0)
    front += v.C_r * v.lr / (v.lf + v.lr) / 2 * v.wheel_radius_front
    rear += v.C_r * v.lf / (v.lf + v.lr) / 2 * v.wheel_radius
    return front, rear


@part
def pressure_rate(b: Brake, pressure: float, command: float) -> float:
    """Return the rate of the pressure [Pa/s] towards the command, which is limited to P_max."""
    target = min(command, b.P_max)
    rate: float = (target - pressure) / (b.tau_rise if target > pressure else b.tau_fall)
    return rate


@part
def against(torque: float, omega: float) -> float:
    """Return a braking torque [Nm] with the sign opposite to the wheel speed [rad/s]."""
    signed: float = -torque * min(max(omega / STICTION, -1.0), 1.0)
    return signed
