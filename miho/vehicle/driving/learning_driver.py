"""A driver whose plan and steering follow the friction of the road."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace

import numpy as np

from miho.quantities import Array
from miho.vehicle.driving.compiling import compiled, part
from miho.vehicle.driving.driver import Driver, DriverState
from miho.vehicle.driving.friction import (
    MOST,
    FrictionCar,
    demand,
    farthest,
    friction_use,
    limits_and_use,
    point_demand,
)
from miho.vehicle.driving.plant import Command, Motion
from miho.vehicle.driving.steering_control import SteeringController
from miho.vehicle.driving.velocity_planner import VelocityPlan, VelocityPlanner

STEP = 0.01
"""Step of the friction for which plans are made [-]."""
TURNING = 0.985
"""Largest use of friction for turning while the car slows down, so that it can brake at all."""
LEAST = 0.2
"""Least friction for which plans are made [-]."""


class FrictionSource(ABC):
    """A source of the present friction of the road, relative to the known car."""

    @abstractmethod
    def friction(self, motion: Motion, curvature: float, bank: float) -> float:
        """Return the present friction [-], relative to the known car; NaN keeps the plan.

        The driver calls this once for each command, with the measured motion, and the curvature
        [1/m] and bank [rad] of the line at the car.
        """


@dataclass(frozen=True, eq=False)
class LearningDriver:
    """Driver with a plan for the friction that a source reports.

    A plan belongs to a whole step of the friction. It changes if the reported friction differs by
    more than one step from the friction of the present plan. If the car is too fast for a new
    plan, the plan begins at the present speed, and the car slows down with the reserve of the
    planner for the entry of a turn.

    Parameters
    ----------
    driver : Driver
        Driver for a friction of 1.
    planner : VelocityPlanner
        Planner for a friction of 1.
    source : FrictionSource
        Source of the friction.
    """

    driver: Driver
    planner: VelocityPlanner
    source: FrictionSource
    known: dict[float, Driver] = field(default_factory=dict, init=False, repr=False)

    @property
    def plan(self) -> VelocityPlan:
        """Plan for a friction of 1."""
        return self.driver.plan

    @property
    def period(self) -> float:
        """Time from one command to the next [s]."""
        return self.driver.period

    def begin(self, motion: Motion) -> DriverState:
        """Return the initial state of the driver at a motion."""
        return self.driver.begin(motion)

    def step(self, state: DriverState, motion: Motion) -> tuple[Command, DriverState]:
        """Return the next command for a measured motion, and the new state, perhaps replanned."""
        point = state.plan.line.at(state.at)
        now = self.source.friction(motion, float(point.curvature), float(point.bank))
        planned = state.plan.friction.mu / self.planner.mu
        changed = math.isfinite(now) and abs(now - planned) > STEP
        if changed:
            planned = max(STEP * round(now / STEP), LEAST)
        knowing = self._knowing(planned)
        if changed or state.plan is not knowing.plan:
            reserve = self.planner.entry_reserve
            friction = knowing.plan.friction._replace(mu=planned * (1 - reserve))
            brake = -self.planner.slowest_rate
            plan = slowed_from(knowing.plan, friction, state.at, motion.vx, brake)
            if changed or plan is knowing.plan:
                state = state._replace(plan=plan)
        return knowing.step(state, motion)

    def _knowing(self, friction: float) -> Driver:
        """Return the driver who knows a friction."""
        key = round(friction / STEP)
        if key not in self.known:
            planner = replace(self.planner, mu=self.planner.mu * friction)
            steering = self.driver.steering
            if isinstance(steering, SteeringController):  # the printed one knows no friction
                steering = replace(steering, friction=friction)
            plan = self.plan if friction == 1.0 else planner.plan(self.plan.line)
            self.known[key] = replace(self.driver, plan=plan, steering=steering)
        return self.known[key]


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
