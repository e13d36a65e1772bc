"""Velocity plans (Sec. IV-A): the largest speeds on a closed line for tires, engine and brakes.

Eq. 10-12 are corrected by load sensitivity in addition to the load ratio, load transfer from the
lateral acceleration of the steady turn, limits of each axle, banking, downforce, the friction
ellipse, and braking ahead of turns. `velocity_as_printed` has the printed equations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array
from miho.validate import positive_settings
from miho.vehicle.driving.compiling import compiled, part
from miho.vehicle.driving.friction import (
    BISECTIONS,
    FrictionCar,
    demand,
    farthest,
    friction_car,
    friction_use,
    limits_and_use,
    point_demand,
    use_on_line,
)
from miho.vehicle.driving.grip import Grip
from miho.vehicle.driving.track import Track
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models import Brake, EngineMap

SCAN = 2.0
"""Step of the search for the lateral limit before bisection [m/s]."""
ENTRY = 60.0
"""Distance over which the curvature doubles at the entry of a turn [m], about one second."""


@dataclass(frozen=True, eq=False)
class VelocityPlan:
    """Speeds at the n points of a line, with their demand on the car; arrays are (n,).

    The limit of the lateral demand is its largest magnitude in the same direction within the
    planned friction, at this speed and acceleration.
    """

    line: Track
    v: Array  # speed [m/s]
    ax: Array  # constant acceleration from each point to the next one [m/s^2]
    lateral: Array  # as in `Demand` [m/s^2]
    limit: Array  # [m/s^2]
    use: Array  # of the friction ellipse by the worse axle, 1 at the limit [-]
    friction: FrictionCar  # planned friction limits

    def at(self, s: float) -> tuple[float, float]:
        """Return the speed [m/s] and acceleration [m/s^2] at an arc length [m] of any lap."""
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
    """Largest acceleration by the engine and smallest by the brakes [m/s^2] over speed [m/s]."""

    speeds: Array
    most: Array
    least: Array


@dataclass(frozen=True)
class VelocityPlanner:
    """Planner of speeds for a car with identified tires, engine and brakes.

    Parameters
    ----------
    vehicle : Vehicle
        The car.
    grip : Grip
        Largest forces of the tires.
    engine : EngineMap, optional
        The engine; by default, drive and drag do not limit the plan.
    brake : Brake, optional
        The brake; by default, only the tires limit braking.
    mu : float, optional
        Performance factor of Eq. 10, which scales all tire forces [-].
    top_speed : float, optional
        Largest speed [m/s].
    brake_share : float, optional
        Share of the largest brake force for plans [-].
    reserve : float, optional
        Share of the tire forces within mu that is reserved for the controllers [-], because a car
        that enters a turn or brakes overshoots the steady values of the plan.
    entry_reserve : float, optional
        Further reserve at the entry of a turn and for braking before it [-], because the grip may
        have fallen on the straight, which does not show it.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    vehicle: Vehicle
    grip: Grip
    engine: EngineMap | None = None
    brake: Brake | None = None
    mu: float = 1.0
    top_speed: float = 90.0
    brake_share: float = 0.9
    reserve: float = 0.0
    entry_reserve: float = 0.0

    def __post_init__(self) -> None:
        positive_settings(self, ("mu", "top_speed", "brake_share"))
        for name in ("reserve", "entry_reserve"):
            value = getattr(self, name)
            if not 0 <= value < 1:
                raise ValueError(f"{name} is {value:g}; expected at least 0 and below 1")

    @property
    def friction(self) -> FrictionCar:
        """Friction limits with the performance factor mu, including the reserve."""
        share = 0.5 if self.brake is None else front_share(self.brake)
        return friction_car(self.vehicle, self.grip, self.mu, share, self.engine is not None)

    @property
    def slowest_rate(self) -> float:
        """Acceleration by the brakes alone [m/s^2], below 0."""
        if self.brake is None:
            return -math.inf
        return -self.brake_share * self.brake.largest_force / self.vehicle.mass

    @property
    def _planned(self) -> FrictionCar:
        """Friction limits of the planned speeds, without the reserve."""
        return self.friction._replace(mu=self.mu * (1 - self.reserve))

    def plan(self, line: Track) -> VelocityPlan:
        """Return the fastest plan for laps of a line; raises ValueError if no speed is safe."""
        limits = self.lateral_limits(line)
        used = (1 - self.reserve) * (1 - self.entry_reserve)
        careful = replace(self, reserve=1 - used, entry_reserve=0.0)
        if self.entry_reserve > 0:
            limits = np.where(entries(line), careful.lateral_limits(line), limits)
        if not (limits > 0).all():
            i = int(np.argmin(limits))
            raise ValueError(
                f"no speed holds the car on {line.name} at s = {line.s[i]:.1f} m, where the "
                f"curvature is {line.curvature[i]:.4g} 1/m and the bank {line.bank[i]:.4g} rad; "
                f"expected more grip than a performance factor of {self.mu:g} gives"
            )
        powers, road = self._powers(), (line.curvature, line.bank)
        if self.entry_reserve > 0:
            _brake_ahead(careful._planned, powers, *road, limits, line.step)
        v = _speed_up(self._planned, powers, *road, limits, line.step)
        _brake_ahead(self._planned, powers, *road, v, line.step)
        ax = (np.roll(v, -1) ** 2 - v**2) / (2 * line.step)
        lateral, _ = demand(v, line.curvature, line.bank)
        limit, use = limits_and_use(self.friction, v, ax, line.curvature, line.bank)
        return VelocityPlan(line, v, ax, lateral, limit, use, self.friction)

    def lateral_limits(self, line: Track) -> Array:
        """Return the largest steady speed at each point of a line, (n,) [m/s]; 0 if none."""
        highest = self._highest(self._powers())
        return np.asarray(_lateral_limits(self._planned, line.curvature, line.bank, highest))

    def _powers(self) -> _Powers:
        speeds = np.arange(1.0, self.top_speed + 2.0)
        most, least = np.full(speeds.size, np.inf), np.full(speeds.size, -np.inf)
        if self.engine is not None:
            most = full_throttle(self.vehicle, self.engine, speeds)
        if self.brake is not None:
            drag = self.friction.C_d * speeds**2 + self.vehicle.C_r
            least = -(self.brake_share * self.brake.largest_force + drag) / self.vehicle.mass
        return _Powers(speeds, most, least)

    def _highest(self, powers: _Powers) -> float:
        """Return the largest speed of the engine, at most the top speed."""
        weak = powers.most < 0
        if weak[0]:
            raise ValueError(
                f"the engine accelerates the car by {powers.most[0]:.3g} m/s^2 at 1 m/s; expected "
                "a positive acceleration"
            )
        return min(
            self.top_speed, float(powers.speeds[np.argmax(weak) - 1]) if weak.any() else np.inf
        )


def entries(line: Track) -> NDArray[np.bool_]:
    """Return whether each point (n,) of a closed line is at the entry of a turn.

    There the curvature is more than twice the curvature at a point in the last `ENTRY` metres.
    """
    bend = np.abs(line.curvature)
    back = range(round(ENTRY / line.step) + 1)
    least = np.min([np.roll(bend, k) for k in back], axis=0)
    return np.asarray(bend > 2 * least)


def full_throttle(vehicle: Vehicle, engine: EngineMap, speeds: Array) -> Array:
    """Return the largest acceleration [m/s^2] in the best gear at speeds (n,) [m/s]."""
    drive = vehicle.longitudinal
    best = np.full(speeds.shape, -np.inf)
    for gear in range(1, len(vehicle.gear_ratios) + 1):
        omega = drive.engine_speed(speeds, gear)
        usable = omega <= vehicle.engine_speed_max
        torque = engine.torque(np.maximum(omega, vehicle.idle_speed), 1.0)
        best = np.where(usable, np.maximum(best, drive.acceleration(torque, speeds, gear)), best)
    return np.where(np.isfinite(best), best, -np.inf)


def front_share(brake: Brake) -> float:
    """Return the share of the front axle in a large brake force [-]."""
    front, rear = brake.pressure(brake.u1)
    at_front = brake.K_front * max(float(front) - brake.P0_front, 0.0) / brake.radius_front
    at_rear = brake.K_rear * max(float(rear) - brake.P0_rear, 0.0) / brake.radius_rear
    return at_front / (at_front + at_rear)


@compiled
def _lateral_limits(car: FrictionCar, curvature: Array, bank: Array, highest: float) -> Array:
    """Return the upper ends (n,) of the ranges of steady speeds at each point.

    The result is 0 if there is no such speed, because the road is too steep or too tight.
    """
    limits = np.zeros(curvature.size)
    for i in range(curvature.size):
        if i and curvature[i] == curvature[i - 1] and bank[i] == bank[i - 1]:
            limits[i] = limits[i - 1]
            continue
        # Scan for the last possible speed before an impossible one, because low speeds may be
        # impossible on a steep bank. Then bisect between the two.
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
def _speed_up(
    car: FrictionCar, powers: _Powers, curvature: Array, bank: Array, limits: Array, step: float
) -> Array:
    """Return speeds (n,) below the limits with feasible gains of speed between points."""
    # Both passes begin at the lowest speed, which no other point changes.
    n, start = limits.size, np.argmin(limits)
    v = limits.copy()
    for k in range(n):
        i, j = (start + k) % n, (start + k + 1) % n
        needed = (v[j] * v[j] - v[i] * v[i]) / (2 * step)
        engine = np.interp(v[i], powers.speeds, powers.most)
        if needed > 0:
            ax = _largest(car, v[i], min(needed, max(engine, 0.0)), curvature[i], bank[i])
            v[j] = min(v[j], math.sqrt(v[i] * v[i] + 2 * ax * step))
    return v


@compiled
def _brake_ahead(
    car: FrictionCar, powers: _Powers, curvature: Array, bank: Array, v: Array, step: float
) -> None:
    """Reduce speeds v (n,) in place until the decelerations between points are feasible."""
    n, start = v.size, np.argmin(v)
    for k in range(n):
        i, j = (start - k - 1) % n, (start - k) % n
        if v[i] > v[j]:
            v[i] = _entry(car, powers, v[i], v[j], curvature[i], bank[i], step)


@part
def _largest(car: FrictionCar, v: float, highest: float, curvature: float, bank: float) -> float:
    """Return the largest acceleration [m/s^2] from 0 to `highest` within the tires' friction."""
    lateral, gravity = point_demand(v, curvature, bank)
    if friction_use(car, v, highest, lateral, gravity) <= 1:
        return highest
    return farthest(car, v, 0.0, lateral, (highest, lateral), gravity)[0]


@part
def _entry(
    car: FrictionCar, powers: _Powers, v: float, after: float, curvature: float, bank: float,
    step: float,
) -> float:  # fmt: skip
    """Return the largest speed up to v from which the car can slow down to `after` in a step."""
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
    car: FrictionCar, powers: _Powers, v: float, after: float, curvature: float, bank: float,
    step: float,
) -> bool:  # fmt: skip
    ax = (after * after - v * v) / (2 * step)
    if ax < np.interp(v, powers.speeds, powers.least):
        return False
    return bool(use_on_line(car, v, ax, curvature, bank) <= 1)
