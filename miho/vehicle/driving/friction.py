"""Use of the tires' friction at a speed and acceleration on a curved and banked road.

The half axes of an axle's friction ellipse are the sums of its tires' peaks at their loads. The
lateral forces of the axles balance the yaw moment of a steady turn, so the weaker axle limits the
car. Induced drag and aligning moments of the tires are neglected.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array, g
from miho.vehicle.driving.compiling import compiled, part
from miho.vehicle.driving.grip import Grip
from miho.vehicle.driving.load_transfer import LoadCoefficients, LoadTransfer, wheel_loads
from miho.vehicle.driving.vehicle import Vehicle

BISECTIONS = 40
"""Number of bisections that reduce 100 m/s or m/s^2 to 1e-10."""
MOST = 100.0
"""An acceleration beyond the friction of any car [m/s^2]."""


class Demand(NamedTuple):
    """Demand of a speed on a line, per mass [m/s^2].

    lateral is the demand on the tires along the surface, positive to the left. gravity presses the
    car on the surface.
    """

    lateral: Array
    gravity: Array


def demand(v: ArrayLike, curvature: ArrayLike, bank: ArrayLike) -> Demand:
    """Return the demand at speeds [m/s], plan curvatures [1/m] and banks [rad], broadcast."""
    return Demand(*map(np.asarray, point_demand(np.asarray(v, dtype=float), curvature, bank)))


class FrictionCar(NamedTuple):
    """Numbers of a car for friction limits, in SI units; the arrays are fields of `Grip`."""

    loads: LoadCoefficients
    mass: float
    front: float  # the front axle's share of the lateral force, l_r / L
    brake_front: float  # the front axle's share of the brake force
    C_d: float
    mu: float
    load: Array
    left: Array
    right: Array
    drive: Array
    q_y: Array
    q_x: Array


def friction_car(
    vehicle: Vehicle, grip: Grip, mu: float = 1.0, brake_front: float = 0.5, drag: bool = True
) -> FrictionCar:
    """Return the car for compiled functions, with its drag or without."""
    return FrictionCar(
        LoadTransfer(vehicle).coefficients, vehicle.mass, vehicle.lr / vehicle.wheelbase,
        brake_front, vehicle.C_d if drag else 0.0, mu, grip.load, grip.left, grip.right, grip.drive,
        grip.lateral_sensitivity, grip.longitudinal_sensitivity,
    )  # fmt: skip


@part
def friction_use(car: FrictionCar, v: float, ax: float, lateral: float, gravity: float) -> float:
    """Return the use of the friction ellipse by the worse axle; above 1 exceeds the limit.

    ax is the acceleration along the road [m/s^2]; lateral and gravity are as in `Demand`.
    """
    force = car.mass * ax + car.C_d * v * v  # of all tires
    # The downforce already includes the moment of the drag, so ax alone moves load.
    Fz = wheel_loads(car.loads, v, ax, lateral, gravity)
    peaks = car.left if lateral >= 0 else car.right
    # Half axes of an axle's ellipse are the sums of its tires' peaks at their loads. Its share of
    # the lateral force follows from the yaw moment, and of the longitudinal force from rear-wheel
    # drive or the brake balance.
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
def point_demand(v: Any, curvature: Any, bank: Any) -> tuple[Any, Any]:
    """Return the parts of `Demand` [m/s^2], for numbers or arrays, compiled or not."""
    turning, sine, cosine = v * v * curvature, np.sin(bank), np.cos(bank)
    return turning * cosine - g * sine, g * cosine + turning * sine


@part
def use_on_line(car: FrictionCar, v: float, ax: float, curvature: float, bank: float) -> float:
    """Return the use of the friction ellipse at a curvature [1/m] and bank [rad]."""
    lateral, gravity = point_demand(v, curvature, bank)
    return float(friction_use(car, v, ax, lateral, gravity))


@compiled
def measured_use(car: FrictionCar, v: Array, ax: Array, ay: Array, gravity: Array) -> Array:
    """Return the use of the friction ellipse, (n,), for measured accelerations.

    ax and ay [m/s^2] are as in `miho.vehicle.driving.plant.Motion`. gravity [m/s^2] presses the
    car on the road.
    """
    use = np.empty(v.size)
    for i in range(v.size):
        use[i] = friction_use(car, v[i], ax[i], ay[i], gravity[i])
    return use


@part
def farthest(
    car: FrictionCar, v: float, ax: float, lateral: float, to: tuple[float, float], gravity: float
) -> tuple[float, float]:
    """Return the farthest (ax, lateral) within the friction on the way to another such pair."""
    to_ax, to_lateral = to
    for _ in range(BISECTIONS):
        middle_ax, middle_lateral = (ax + to_ax) / 2, (lateral + to_lateral) / 2
        if friction_use(car, v, middle_ax, middle_lateral, gravity) <= 1:
            ax, lateral = middle_ax, middle_lateral
        else:
            to_ax, to_lateral = middle_ax, middle_lateral
    return ax, lateral


@compiled
def limits_and_use(
    car: FrictionCar, v: Array, ax: Array, curvature: Array, bank: Array
) -> tuple[Array, Array]:
    """Return the limit of the lateral demand [m/s^2] and the use of friction, (n,) each.

    The limit at speeds v [m/s] and accelerations ax [m/s^2] is the largest magnitude, in the
    direction of the demand, with a use of at most 1.
    """
    limit, use = np.empty(v.size), np.empty(v.size)
    for i in range(v.size):
        lateral, gravity = point_demand(v[i], curvature[i], bank[i])
        use[i] = friction_use(car, v[i], ax[i], lateral, gravity)
        most = MOST if lateral >= 0 else -MOST
        limit[i] = abs(farthest(car, v[i], ax[i], 0.0, (ax[i], most), gravity)[1])
    return limit, use
