"""Compiled equations of motion of the double track.

The model has a body with three planar degrees of freedom in the plane of the road, four rotating
wheels, slips with relaxation lengths, loads with a lag, steering, engine and brake:

    v_x' = a_x + v_y r + g sin(bank) sin(chi)     I_zz r' = sum of x F_y - y F_x over the wheels
    v_y' = a_y - v_x r + g sin(bank) cos(chi)     I w' = T_drive - R F_x - T_brake - T_rolling
    s' = (v_x cos(chi) - v_y sin(chi)) / (1 - n kappa cos(bank))    chi' = r - kappa cos(bank) s'
    sigma_x k' = (w R - u) - |u| k                sigma_y tan(alpha)' = v - |u| tan(alpha)

a_x and a_y are the forces divided by the mass. u and v are the velocities of a wheel centre along
and across the wheel. chi is the heading relative to the line, and n is the offset from it in the
plane of the road. In this plane, the line has the curvature kappa cos(bank); the road presses on
the car with kappa sin(bank) v^2 (a cone). Rates of the bank and aligning moments of the tires are
neglected. Relaxation: Bernard and Clover, SAE 950311; Pacejka, Tire and Vehicle Dynamics, 3rd ed.,
Ch. 7-8.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from miho.quantities import Array, g
from miho.vehicle.driving.compiled_tire import Tires, wheel_forces, wheel_tire
from miho.vehicle.driving.compiling import part, record_of
from miho.vehicle.driving.load_transfer import LoadTransfer, wheel_loads
from miho.vehicle.driving.powertrain import (
    Engine,
    against,
    braking_torques,
    engine_of,
    engine_speed,
    pressure_rate,
    rear_accelerations,
    torque_rate,
)
from miho.vehicle.driving.road import Road, shape_at
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models import Brake, EngineMap

S, N, CHI, VX, VY, R, AX, AY, DELTA, TORQUE, PRESSURE = range(11)
WHEELS, KAPPA, TAN_ALPHA, SIZE = 11, 15, 19, 23
"""Indices of the state (23,); wheels FL, FR, RL, RR have a speed, a slip ratio and tan(alpha).

AX and AY are the lagged accelerations of the loads.
"""

SLOW = 2.0
"""Speed [m/s] below which slips are damped; a car at rest would oscillate without damping."""
DAMPING = 0.05
"""Additional slip per sliding speed at low speed [s/m]; Pacejka, Ch. 8.6."""
LARGEST_SLIP = 1.5
"""Largest slip ratio and tan(alpha), far beyond the peaks of the forces."""


class Car(NamedTuple):
    """All numbers of a car, without the road.

    Except for the engine, fields are arrays of records with the fields of the named class, (1,),
    and (4,) for the tires, because compiled code takes arrays by reference.
    """

    engine: Engine
    vehicle: Any  # Vehicle
    brake: Any  # Brake
    loads: Any  # LoadCoefficients
    tires: Any  # `wheel_tire`


def car_of(vehicle: Vehicle, tires: Tires, engine: EngineMap, brake: Brake) -> Car:
    """Return the numbers of a car."""
    inclinations = (vehicle.inclination_front,) * 2 + (vehicle.inclination_rear,) * 2
    return Car(
        engine_of(vehicle, engine),
        np.array([record_of(vars(vehicle))]),
        np.array([record_of(vars(brake))]),
        np.array([record_of(LoadTransfer(vehicle).coefficients._asdict())]),
        np.array(list(map(wheel_tire, tires, inclinations))),
    )


@part
def derivative(
    car: Car, road: Road, gear: int, closed: bool, inputs: tuple[float, float, float],
    y: Array, dy: Array,
) -> tuple[float, float]:  # fmt: skip
    """Write the rates of the state y (23,) to dy, and return a_x and a_y [m/s^2].

    gear is the engaged gear, 0 for neutral; closed is false during a shift. inputs are the delayed
    steering [rad], throttle and brake pressure [Pa].
    """
    v = car.vehicle[0]
    fx, fy, moment = _wheels(car, road, gear, closed, y, dy)
    ax = (fx - v.C_d * y[VX] * abs(y[VX])) / v.mass
    ay = fy / v.mass

    curvature, bank = shape_at(road, y[S])
    sine, cosine = math.sin(y[CHI]), math.cos(y[CHI])
    lean, level = math.sin(bank), math.cos(bank)
    dy[S] = (y[VX] * cosine - y[VY] * sine) / max(1 - y[N] * curvature * level, 0.1)
    dy[N] = y[VX] * sine + y[VY] * cosine
    dy[CHI] = y[R] - curvature * level * dy[S]
    dy[VX] = ax + y[VY] * y[R] + g * lean * sine
    dy[VY] = ay - y[VX] * y[R] + g * lean * cosine
    dy[R] = moment / v.Izz
    dy[AX] = (ax - y[AX]) / v.load_lag
    dy[AY] = (ay - y[AY]) / v.load_lag

    steering, throttle, brake = inputs
    steering = min(max(steering, -v.steering_max), v.steering_max)
    turning = (steering - y[DELTA]) / v.steering_lag
    dy[DELTA] = min(max(turning, -v.steering_rate), v.steering_rate)
    mean = (y[WHEELS + 2] + y[WHEELS + 3]) / 2
    omega, _ = engine_speed(car.engine, v, gear, closed, mean)
    # During a shift the ignition is cut, and the turbo keeps its speed.
    dy[TORQUE] = torque_rate(car.engine, v, y[TORQUE], omega, throttle) if closed else 0.0
    dy[PRESSURE] = pressure_rate(car.brake[0], y[PRESSURE], brake)
    return ax, ay


@part
def loads_of(car: Car, road: Road, y: Array) -> tuple[float, float, float, float]:
    """Return the loads of the wheels [N]."""
    curvature, bank = shape_at(road, y[S])
    along = y[VX] * math.cos(y[CHI]) - y[VY] * math.sin(y[CHI])
    turning = curvature * along / max(1 - y[N] * curvature * math.cos(bank), 0.1)
    gravity = g * math.cos(bank) + along * turning * math.sin(bank)
    fl, fr, rl, rr = wheel_loads(car.loads[0], y[VX], y[AX], y[AY], gravity)
    return fl, fr, rl, rr


@part
def _wheels(
    car: Car, road: Road, gear: int, closed: bool, y: Array, dy: Array
) -> tuple[float, float, float]:
    """Return the tire forces on the body along x and y [N] and the moment about z [Nm].

    The function also writes the rates of the wheels and their slips.
    """
    v = car.vehicle[0]
    loads = loads_of(car, road, y)
    on_front, on_rear = braking_torques(v, car.brake[0], y[PRESSURE])
    sine, cosine = math.sin(y[DELTA]), math.cos(y[DELTA])
    fx = fy = moment = 0.0
    rear = (0.0, 0.0)
    for i in range(4):
        front = i < 2
        side = 1.0 if i % 2 == 0 else -1.0
        # Position of the wheel, and velocity along and across it.
        px = v.lf if front else -v.lr
        py = side * (v.track_front if front else v.track_rear) / 2
        sin_d, cos_d = (sine, cosine) if front else (0.0, 1.0)
        vx, vy = y[VX] - y[R] * py, y[VY] + y[R] * px
        along, across = vx * cos_d + vy * sin_d, vy * cos_d - vx * sin_d
        omega = y[WHEELS + i]
        radius = v.wheel_radius_front if front else v.wheel_radius
        # Slips with relaxation, and with damping near standstill.
        sliding = omega * radius - along
        dy[KAPPA + i] = _slip_rate(y[KAPPA + i], sliding, along, v.relaxation_x)
        dy[TAN_ALPHA + i] = _slip_rate(y[TAN_ALPHA + i], across, along, v.relaxation_y)
        damping = _damping(along)
        kappa = y[KAPPA + i] + damping * sliding
        alpha = math.atan(y[TAN_ALPHA + i] + damping * across)
        # Forces of the tire, and torque on the wheel.
        long, lat = wheel_forces(car.tires[i], loads[i], kappa, alpha, along, road.friction)
        torque = against(on_front if front else on_rear, omega) - radius * long
        if front:
            dy[WHEELS + i] = torque / (v.wheel_inertia / 4)
        else:
            rear = (torque, 0.0) if i == 2 else (rear[0], torque)
        # Sum over the wheels.
        wheel_x, wheel_y = long * cos_d - lat * sin_d, long * sin_d + lat * cos_d
        fx += wheel_x
        fy += wheel_y
        moment += px * wheel_y - py * wheel_x
    dy[WHEELS + 2], dy[WHEELS + 3] = rear_accelerations(
        car.engine, v, gear, closed, y[TORQUE], y[WHEELS + 2], y[WHEELS + 3], rear
    )
    return fx, fy, moment


@part
def _slip_rate(slip: float, sliding: float, along: float, relaxation: float) -> float:
    rate: float = (sliding - abs(along) * slip) / relaxation
    return 0.0 if abs(slip) >= LARGEST_SLIP and rate * slip > 0 else rate


@part
def _damping(along: float) -> float:
    if abs(along) >= SLOW:
        return 0.0
    return DAMPING * (1 + math.cos(math.pi * along / SLOW)) / 2
