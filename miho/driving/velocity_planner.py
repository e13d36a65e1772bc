"""Velocity plans (Sec. IV-A): the fastest that tires, engine and brakes allow on a closed line.

Eq. 10-12, corrected: load sensitivity instead of the load ratio alone, load transfer by the
lateral acceleration of the steady turn, the limit of each axle, banking, downforce, the friction
ellipse, and braking ahead. `velocity_as_printed` has the equations as they are printed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from miho.driving.compiling import compiled, part
from miho.driving.friction import (
    BISECTIONS,
    FrictionCar,
    demand,
    friction_car,
    limits_and_use,
    use_on_line,
)
from miho.driving.grip import Grip
from miho.driving.track import Track
from miho.driving.vehicle import Vehicle
from miho.models.brake import Brake
from miho.models.engine_map import EngineMap
from miho.quantities import Array
from miho.validate import positive_settings

SCAN = 2.0
"""Step [m/s] in which the lateral limit is looked for before it is bisected."""


@dataclass(frozen=True, eq=False)
class VelocityPlan:
    """Speeds v [m/s] at the arc lengths s [m] of a line, and what they ask of the car, (n,) each.

    ax [m/s^2]: from each point to the next, at which the speed's square is linear between them.
    lateral: as in `Demand`; limit: the largest magnitude of it at this speed and ax that leaves
    the tires' friction as planned, in the direction in which it acts. use: of the friction
    ellipse of the worse axle, 1 at its limit. friction: the limits, as they are planned with.
    """

    line: Track
    v: Array
    ax: Array
    lateral: Array
    limit: Array
    use: Array
    friction: FrictionCar

    def at(self, s: float) -> tuple[float, float]:
        """Speed [m/s] and acceleration [m/s^2] at an arc length [m], beyond a lap too."""
        steps = (s % self.line.length) / self.line.step
        i = min(int(steps), self.v.size - 1)
        v = float(self.v[i])
        ax = float(self.ax[i])
        return math.sqrt(max(v * v + 2 * ax * (steps - i) * self.line.step, 0.0)), ax

    @property
    def lap_time(self) -> float:
        """Time of a lap [s]."""
        following = np.roll(self.v, -1)
        return float(np.sum(2 * self.line.step / (self.v + following)))


class _Powers(NamedTuple):
    """Accelerations [m/s^2] over speeds [m/s]: most by the engine, least by the brakes."""

    speeds: Array
    most: Array
    least: Array


@dataclass(frozen=True)
class VelocityPlanner:
    """Plans for a car with what is known of its tires, engine and brakes.

    mu [-]: the performance factor of Eq. 10, which scales all tire forces. top_speed [m/s] is
    never exceeded. brake_share [-] of the largest brake force may be planned with. reserve [-]:
    the share of the tires' forces within mu that the speeds leave to the controllers, because a
    car that is brought into a turn, or into braking, overshoots the steady values of the plan.
    engine None leaves drive and drag out, brake None the brake's own limit: then tires alone count.
    """

    vehicle: Vehicle
    grip: Grip
    engine: EngineMap | None = None
    brake: Brake | None = None
    mu: float = 1.0
    top_speed: float = 90.0
    brake_share: float = 0.9
    reserve: float = 0.0

    def __post_init__(self) -> None:
        positive_settings(self, ("mu", "top_speed", "brake_share"))
        if not 0 <= self.reserve < 1:
            raise ValueError(f"reserve is {self.reserve:g}; expected at least 0 and below 1")

    @property
    def friction(self) -> FrictionCar:
        """The tires' limits with the performance factor mu, the reserve included."""
        share = 0.5 if self.brake is None else front_share(self.brake)
        return friction_car(self.vehicle, self.grip, self.mu, share, self.engine is not None)

    @property
    def _planned(self) -> FrictionCar:
        """The limits that the speeds keep to."""
        return self.friction._replace(mu=self.mu * (1 - self.reserve))

    def plan(self, line: Track) -> VelocityPlan:
        """The fastest plan for laps of a closed line; raises ValueError where no speed is safe."""
        limits = self.lateral_limits(line)
        if not (limits > 0).all():
            i = int(np.argmin(limits))
            raise ValueError(
                f"no speed holds the car on {line.name} at s = {line.s[i]:.1f} m, where the "
                f"curvature is {line.curvature[i]:.4g} 1/m and the bank {line.bank[i]:.4g} rad; "
                f"expected more grip than a performance factor of {self.mu:g} gives"
            )
        v = _passes(self._planned, self._powers(), line.curvature, line.bank, limits, line.step)
        ax = (np.roll(v, -1) ** 2 - v**2) / (2 * line.step)
        lateral, _ = demand(v, line.curvature, line.bank)
        limit, use = limits_and_use(self.friction, v, ax, line.curvature, line.bank)
        return VelocityPlan(line, v, ax, lateral, limit, use, self.friction)

    def lateral_limits(self, line: Track) -> Array:
        """Largest speeds (n,) [m/s] that can be kept at each point of a line; 0 where none can."""
        highest = self._highest(self._powers())
        return np.asarray(_lateral_limits(self._planned, line.curvature, line.bank, highest))

    def _powers(self) -> _Powers:
        speeds = np.arange(1.0, self.top_speed + 2.0)
        most, least = np.full(speeds.size, np.inf), np.full(speeds.size, -np.inf)
        if self.engine is not None:
            most = full_throttle(self.vehicle, self.engine, speeds)
        if self.brake is not None:
            drag = self.friction.C_d * speeds**2 + self.friction.C_r
            least = -(self.brake_share * self.brake.largest_force + drag) / self.vehicle.mass
        return _Powers(speeds, most, least)

    def _highest(self, powers: _Powers) -> float:
        """The top speed, or where the engine no longer keeps it."""
        weak = powers.most < 0
        if weak[0]:
            raise ValueError(
                f"the engine accelerates the car by {powers.most[0]:.3g} m/s^2 at 1 m/s; expected "
                "one that drives it"
            )
        return min(
            self.top_speed, float(powers.speeds[np.argmax(weak) - 1]) if weak.any() else np.inf
        )


def full_throttle(vehicle: Vehicle, engine: EngineMap, speeds: Array) -> Array:
    """Largest acceleration [m/s^2] of the engine in its best gear at speeds (n,) [m/s]."""
    drive = vehicle.longitudinal
    best = np.full(speeds.shape, -np.inf)
    for gear in range(1, len(vehicle.gear_ratios) + 1):
        omega = drive.engine_speed(speeds, gear)
        usable = omega <= vehicle.engine_speed_max
        torque = engine.torque(np.maximum(omega, vehicle.idle_speed), 1.0)
        best = np.where(usable, np.maximum(best, drive.acceleration(torque, speeds, gear)), best)
    return np.where(np.isfinite(best), best, -np.inf)


def front_share(brake: Brake) -> float:
    """The front axle's share of a large brake force [-]."""
    front, rear = brake.pressure(brake.u1)
    at_front = brake.K_front * max(float(front) - brake.P0_front, 0.0) / brake.radius_front
    at_rear = brake.K_rear * max(float(rear) - brake.P0_rear, 0.0) / brake.radius_rear
    return at_front / (at_front + at_rear)


@compiled
def _lateral_limits(car: FrictionCar, curvature: Array, bank: Array, highest: float) -> Array:
    """Largest speeds (n,) that can be kept in a turn, with all below them down to a least one.

    0 where there is none: too steep or too tight for the grip.
    """
    limits = np.zeros(curvature.size)
    for i in range(curvature.size):
        if i and curvature[i] == curvature[i - 1] and bank[i] == bank[i - 1]:
            limits[i] = limits[i - 1]
            continue
        # A scan finds the last speed that holds before one that does not: on a steep bank slow
        # speeds may not hold either. Bisection between the two gives the limit.
        good, v = 0.0, 0.0
        while v < highest:
            v = min(v + SCAN, highest)
            if use_on_line(car, v, 0.0, curvature[i], bank[i]) <= 1:
                good = v
            elif good > 0:
                break
        bad = v
        if good < bad and good > 0:
            for _ in range(BISECTIONS):
                middle = (good + bad) / 2
                if use_on_line(car, middle, 0.0, curvature[i], bank[i]) <= 1:
                    good = middle
                else:
                    bad = middle
        limits[i] = good
    return limits


@compiled
def _passes(
    car: FrictionCar, powers: _Powers, curvature: Array, bank: Array, limits: Array, step: float
) -> Array:
    """Speeds (n,) below the limits that engine, brakes and tires can go through in turn."""
    # Both passes begin where the limit is lowest: no acceleration or braking reaches beyond it.
    n, start = limits.size, np.argmin(limits)
    v = limits.copy()
    # Forwards: from point i to the next one, j, the car gains no more speed than it can.
    for k in range(n):
        i, j = (start + k) % n, (start + k + 1) % n
        needed = (v[j] * v[j] - v[i] * v[i]) / (2 * step)
        engine = np.interp(v[i], powers.speeds, powers.most)
        if needed > 0:
            ax = _largest(car, v[i], min(needed, max(engine, 0.0)), curvature[i], bank[i])
            v[j] = min(v[j], math.sqrt(v[i] * v[i] + 2 * ax * step))
    # Backwards: it enters each step no faster than it can slow down in it.
    for k in range(n):
        i, j = (start - k - 1) % n, (start - k) % n
        if v[i] > v[j]:
            v[i] = _entry(car, powers, v[i], v[j], curvature[i], bank[i], step)
    return v


@part
def _largest(car: FrictionCar, v: float, highest: float, curvature: float, bank: float) -> float:
    """The largest acceleration [m/s^2] from 0 to `highest` that the tires bear."""
    if use_on_line(car, v, highest, curvature, bank) <= 1:
        return highest
    good, bad = 0.0, highest
    for _ in range(BISECTIONS):
        middle = (good + bad) / 2
        if use_on_line(car, v, middle, curvature, bank) <= 1:
            good = middle
        else:
            bad = middle
    return good


@part
def _entry(
    car: FrictionCar,
    powers: _Powers,
    v: float,
    after: float,
    curvature: float,
    bank: float,
    step: float,
) -> float:
    """The highest speed up to v from which the car can slow down to `after` in a step."""
    if _can_slow(car, powers, v, after, curvature, bank, step):
        return v
    good, bad = after, v
    for _ in range(BISECTIONS):
        middle = (good + bad) / 2
        if _can_slow(car, powers, middle, after, curvature, bank, step):
            good = middle
        else:
            bad = middle
    return good


@part
def _can_slow(
    car: FrictionCar,
    powers: _Powers,
    v: float,
    after: float,
    curvature: float,
    bank: float,
    step: float,
) -> bool:
    ax = (after * after - v * v) / (2 * step)
    if ax < np.interp(v, powers.speeds, powers.least):
        return False
    return bool(use_on_line(car, v, ax, curvature, bank) <= 1)
