"""Parameters of a simulated car for compiled code."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.compiled_tire import wheel_tire
from miho.vehicle.driving.load_transfer import LoadTransfer
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models.brake import Brake
from miho.vehicle.models.engine_map import EngineMap
from miho.vehicle.models.magic_formula import MagicFormula

Tires = tuple[MagicFormula, MagicFormula, MagicFormula, MagicFormula]
"""Tires front left, front right, rear left, rear right, never mirrored."""


class Chassis(NamedTuple):
    """Body, aerodynamics and suspension, with names and units of `Vehicle`."""

    mass: float
    lf: float
    lr: float
    Izz: float
    half_track_front: float
    half_track_rear: float
    radius_front: float
    radius_rear: float
    C_d: float
    rolling_torque_front: float  # of one wheel [Nm]
    rolling_torque_rear: float
    load_lag: float
    relaxation_x: float
    relaxation_y: float
    steering_lag: float
    steering_rate: float
    steering_max: float


class Engine(NamedTuple):
    """Engine with names and units of `EngineMap`; ratios are engine turns per wheel turn [-]."""

    openings: Array
    speeds: Array
    table: Array
    ratios: Array


class Driveline(NamedTuple):
    """Driveline with names and units of `Vehicle`."""

    efficiency: float
    engine_inertia: float
    wheel_inertia: float  # of one wheel
    idle_speed: float
    engine_speed_max: float
    spool_rise: float
    spool_fall: float
    shift_time: float
    differential_damping: float


class Brakes(NamedTuple):
    """Brakes with names and units of `Brake`; gains are for one wheel."""

    P_max: float
    K_front: float
    P0_front: float
    K_rear: float
    P0_rear: float
    rear: float  # pressure of the rear circuit over that of the front
    tau_rise: float
    tau_fall: float


class Car(NamedTuple):
    """All parameters of the dynamics of a car, without the road.

    Except for the engine, fields are structured arrays (1,) with the fields of the named class, and
    (4,) for the tires, because compiled code takes arrays by reference.
    """

    engine: Engine
    chassis: Any  # Chassis
    driveline: Any  # Driveline
    brakes: Any  # Brakes
    loads: Any  # LoadCoefficients
    tires: Any  # WheelTire


def car_of(vehicle: Vehicle, tires: Tires, engine: EngineMap, brake: Brake) -> Car:
    """Return the parameters of a car for compiled code."""
    inclinations = (vehicle.inclination_front,) * 2 + (vehicle.inclination_rear,) * 2
    ratios = np.array(vehicle.gear_ratios, dtype=float) * vehicle.final_drive
    return Car(
        Engine(engine.openings.copy(), engine.speeds.copy(), engine.table.copy(), ratios),
        _records(_chassis(vehicle)),
        _records(_driveline(vehicle)),
        _records(_brakes(brake)),
        _records(LoadTransfer(vehicle).coefficients),
        _records(*map(wheel_tire, tires, inclinations)),
    )


def _records(*rows: Any) -> Any:
    """Convert named tuples of one class, with numbers and tuples, to a structured array."""
    first = rows[0]._asdict()
    dtype = [(name, np.float64, np.shape(value)) for name, value in first.items()]
    return np.array([tuple(row) for row in rows], dtype=dtype)


def _chassis(v: Vehicle) -> Chassis:
    # Rolling resistance is distributed as the weight.
    on_front, on_rear = v.C_r * v.lr / v.wheelbase / 2, v.C_r * v.lf / v.wheelbase / 2
    return Chassis(
        mass=v.mass,
        lf=v.lf,
        lr=v.lr,
        Izz=v.Izz,
        half_track_front=v.track_front / 2,
        half_track_rear=v.track_rear / 2,
        radius_front=v.wheel_radius_front,
        radius_rear=v.wheel_radius,
        C_d=v.C_d,
        rolling_torque_front=on_front * v.wheel_radius_front,
        rolling_torque_rear=on_rear * v.wheel_radius,
        load_lag=v.load_lag,
        relaxation_x=v.relaxation_x,
        relaxation_y=v.relaxation_y,
        steering_lag=v.steering_lag,
        steering_rate=v.steering_rate,
        steering_max=v.steering_max,
    )


def _driveline(v: Vehicle) -> Driveline:
    return Driveline(
        efficiency=v.efficiency,
        engine_inertia=v.engine_inertia,
        wheel_inertia=v.wheel_inertia / 4,
        idle_speed=v.idle_speed,
        engine_speed_max=v.engine_speed_max,
        spool_rise=v.spool_rise,
        spool_fall=v.spool_fall,
        shift_time=v.shift_time,
        differential_damping=v.differential_damping,
    )


def _brakes(b: Brake) -> Brakes:
    return Brakes(
        P_max=b.P_max,
        K_front=b.K_front / 2,
        P0_front=b.P0_front,
        K_rear=b.K_rear / 2,
        P0_rear=b.P0_rear,
        rear=(1 - b.bias) / b.bias,
        tau_rise=b.tau_rise,
        tau_fall=b.tau_fall,
    )
