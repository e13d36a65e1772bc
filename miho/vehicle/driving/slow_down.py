"""Plans from the present speed of a car that is too fast for its plan, because the grip fell."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.compiling import compiled, part
from miho.vehicle.driving.friction import (
    MOST,
    FrictionCar,
    demand,
    farthest,
    friction_use,
    limits_and_use,
    point_demand,
)
from miho.vehicle.driving.velocity_planner import VelocityPlan

TURNING = 0.985
"""Largest use of friction for turning while the car slows down, so that it can brake at all."""


def slowed_from(
    plan: VelocityPlan, friction: FrictionCar, s: float, v: float, brake: float
) -> VelocityPlan:
    """Return the plan with higher speeds from an arc length, where the car is too fast for it.

    The car has the speed v [m/s] at the arc length s [m]. The speeds fall as fast as the friction,
    the drag and the brakes, with a largest deceleration [m/s^2], allow until they meet the plan.
    The result is the plan itself if the car is not too fast.
    """
    line, start = plan.line, int((s % plan.line.length) / plan.line.step)
    if v <= plan.v[start]:
        return plan
    speeds = plan.v.copy()
    _slow_down(friction, speeds, line.curvature, line.bank, start, v, brake, line.step)
    ax = (np.roll(speeds, -1) ** 2 - speeds**2) / (2 * line.step)
    ax[start - 1] = plan.ax[start - 1]  # the step up to the present speed is no acceleration
    lateral, _ = demand(speeds, line.curvature, line.bank)
    limit, use = limits_and_use(plan.friction, speeds, ax, line.curvature, line.bank)
    return replace(plan, v=speeds, ax=ax, lateral=lateral, limit=limit, use=use)


@compiled
def _slow_down(
    car: FrictionCar, v: Array, curvature: Array, bank: Array, start: int, now: float,
    brake: float, step: float,
) -> None:  # fmt: skip
    """Raise speeds v (n,) in place to a car that slows down from a speed `now` [m/s]."""
    for k in range(v.size - 1):
        i = (start + k) % v.size
        if now <= v[i]:
            break
        v[i] = now
        slowing = _deceleration(car, now, curvature[i], bank[i], brake)
        now = math.sqrt(max(now * now - 2 * slowing * step, 0.0))


@part
def _deceleration(car: FrictionCar, v: float, curvature: float, bank: float, most: float) -> float:
    """Return the largest deceleration [m/s^2] within the friction that turning leaves."""
    lateral, gravity = point_demand(v, curvature, bank)
    turning = friction_use(car, v, 0.0, lateral, gravity)
    if turning > TURNING:
        lateral *= TURNING / turning
    most = min(most + car.C_d * v * v / car.mass, MOST)
    return -farthest(car, v, 0.0, lateral, (-most, lateral), gravity)[0]
