"""How near to their limits the tires are, at a speed and acceleration on a bend and a bank.

An axle's friction ellipse has as half axes the sums of its tires' peaks at the loads they carry;
the lateral force of an axle is the one that balances the yaw moment of a steady turn, so that the
weaker axle is the limit of both. Induced drag and the tires' aligning moments are left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miho.driving.compiling import compiled, part
from miho.driving.grip import Grip
from miho.driving.load_transfer import LoadCoefficients, LoadTransfer, wheel_loads
from miho.driving.vehicle import Vehicle
from miho.quantities import Array, g

BISECTIONS = 40
"""Halvings of 100 m/s or m/s^2 that leave 1e-10."""


class Demand(NamedTuple):
    """What a speed on a line asks of the car, per mass [m/s^2].

    lateral: of the tires, along the surface and positive to the left; gravity: pressing the car
    on the surface.
    """

    lateral: Array
    gravity: Array


def demand(v: ArrayLike, curvature: ArrayLike, bank: ArrayLike) -> Demand:
    """The demand at speeds [m/s] on curvatures [1/m] in the plan and banks [rad]; broadcast."""
    turning = np.asarray(v, dtype=float) ** 2 * curvature
    return Demand(
        np.asarray(turning * np.cos(bank) - g * np.sin(bank)),
        np.asarray(g * np.cos(bank) + turning * np.sin(bank)),
    )


class FrictionCar(NamedTuple):
    """What the limits depend on, in SI units; the arrays are those of `Grip`."""

    loads: LoadCoefficients
    mass: float
    front: float  # the front axle's share of the lateral force, l_r / L
    brake_front: float  # the front axle's share of the brake force
    C_d: float
    C_r: float
    mu: float
    load: Array
    left: Array
    right: Array
    drive: Array
    q_y: Array
    q_x: Array


def friction_car(
    vehicle: Vehicle, grip: Grip, mu: float = 1.0, brake_front: float = 0.5, rolling: bool = True
) -> FrictionCar:
    """The compiled functions' car; drag and rolling resistance are left out unless `rolling`."""
    return FrictionCar(
        LoadTransfer(vehicle).coefficients, vehicle.mass, vehicle.lr / vehicle.wheelbase,
        brake_front, vehicle.C_d if rolling else 0.0, vehicle.C_r if rolling else 0.0, mu,
        grip.load, grip.left, grip.right, grip.drive, grip.lateral_sensitivity,
        grip.longitudinal_sensitivity,
    )  # fmt: skip


@part
def friction_use(car: FrictionCar, v: float, ax: float, lateral: float, gravity: float) -> float:
    """Use of the friction ellipse by the worse axle; above 1 it is beyond its limit.

    ax: acceleration [m/s^2] along the road; lateral, gravity: as in `Demand`.
    """
    force = car.mass * ax + car.C_d * v * v + car.C_r  # at the ground
    Fz = wheel_loads(car.loads, v, force / car.mass, lateral, gravity)
    peaks = car.left if lateral >= 0 else car.right
    # The ellipse of an axle: its half axes are the sums of both tires' peaks at their loads, and
    # the axle takes a share of the lateral force by the yaw moment, of the longitudinal force as
    # the rear drives, or as the brake is balanced.
    worst = 0.0
    for axle in range(2):
        most_y, most_x = 1e-9, 1e-9
        for i in range(2 * axle, 2 * axle + 2):
            ratio = Fz[i] / car.load[i]
            most_y += car.mu * ratio * peaks[i] * max(1 + car.q_y[i] * (ratio - 1), 0.0)
            most_x += car.mu * ratio * car.drive[i] * max(1 + car.q_x[i] * (ratio - 1), 0.0)
        share_y = car.front if axle == 0 else 1 - car.front
        share_x = float(axle)
        if force < 0:
            share_x = car.brake_front if axle == 0 else 1 - car.brake_front
        use_y, use_x = share_y * car.mass * lateral / most_y, share_x * force / most_x
        worst = max(worst, math.sqrt(use_y * use_y + use_x * use_x))
    return worst


@part
def point_demand(v: float, curvature: float, bank: float) -> tuple[float, float]:
    """Lateral demand and gravity of `Demand` [m/s^2] at a single point, for compiled code."""
    turning = v * v * curvature
    lateral = turning * math.cos(bank) - g * math.sin(bank)
    return lateral, g * math.cos(bank) + turning * math.sin(bank)


@part
def use_on_line(car: FrictionCar, v: float, ax: float, curvature: float, bank: float) -> float:
    """Use of the friction ellipse at a point of a line, by curvature [1/m] and bank [rad]."""
    lateral, gravity = point_demand(v, curvature, bank)
    return float(friction_use(car, v, ax, lateral, gravity))


@compiled
def measured_use(car: FrictionCar, v: Array, ax: Array, ay: Array, gravity: Array) -> Array:
    """Use of the friction ellipse, (n,), by a car whose accelerations were measured.

    ax and ay [m/s^2] as in `miho.driving.plant.Motion`, drag among the forces; gravity [m/s^2]
    presses the car on the road.
    """
    use = np.empty(v.size)
    for i in range(v.size):
        use[i] = friction_use(car, v[i], ax[i] - car.C_r / car.mass, ay[i], gravity[i])
    return use


@compiled
def limits_and_use(
    car: FrictionCar, v: Array, ax: Array, curvature: Array, bank: Array
) -> tuple[Array, Array]:
    """The limit of the lateral demand [m/s^2] and the use of friction at each point, (n,) each.

    At speeds v [m/s] and accelerations ax [m/s^2]. The limit is the largest magnitude, in the
    direction in which the demand acts, that keeps the use at 1 or below.
    """
    limit, use = np.empty(v.size), np.empty(v.size)
    for i in range(v.size):
        lateral, gravity = point_demand(v[i], curvature[i], bank[i])
        use[i] = friction_use(car, v[i], ax[i], lateral, gravity)
        sign = 1.0 if lateral >= 0 else -1.0
        low, high = 0.0, 100.0
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            if friction_use(car, v[i], ax[i], sign * middle, gravity) <= 1:
                low = middle
            else:
                high = middle
        limit[i] = low
    return limit, use
