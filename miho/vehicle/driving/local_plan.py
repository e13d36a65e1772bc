"""Local plans: paths around obstacles and back to the line (Sec. V-B.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from miho.quantities import Array
from miho.validate import positive, positive_settings
from miho.vehicle.driving.lines import Offset, beside
from miho.vehicle.driving.track import Track


class NoPathError(ValueError):
    """Error if there is no path around the obstacles, so that the car must stop."""


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """A box along a line, centred at the arc length s and the offset e (left positive) [m]."""

    s: float
    e: float
    length: float = 5.0
    width: float = 2.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.s) and math.isfinite(self.e)):
            raise ValueError(f"obstacle at s = {self.s}, e = {self.e}; expected finite numbers")
        positive("obstacle length", self.length, "[m]")
        positive("obstacle width", self.width, "[m]")


@dataclass(frozen=True, kw_only=True)
class Swerve:
    """A temporary offset from a line of length `lap`.

    The offset rises over `out` [m] from `start` to e [m], is constant for `stay` and returns to 0
    over `back`. Both transitions consist of clothoids, with piecewise linear curvature. For a given
    length, they need the smallest steering rate.
    """

    lap: float
    start: float
    out: float
    stay: float
    back: float
    e: float

    def __call__(self, s: Array) -> Offset:
        """Return the offset at arc lengths (m,) of the line, for `beside`."""
        since = np.mod(s - self.start, self.lap)
        rising = np.clip(since / self.out, 0, 1)
        falling = np.clip((since - self.out - self.stay) / self.back, 0, 1)
        up, up_slope, up_bend = _clothoids(rising, self.out)
        down, down_slope, down_bend = _clothoids(falling, self.back)
        return Offset(
            self.e * (up - down), self.e * (up_slope - down_slope), self.e * (up_bend - down_bend)
        )


def _clothoids(t: Array, length: float) -> tuple[Array, Array, Array]:
    """Return a transition from 0 to 1 for t from 0 to 1, and two derivatives by t * length.

    The second derivative is linear from 0 to 8 at t = 1/4, to -8 at 3/4 and to 0 at 1.
    """
    value, slope, bend = np.zeros((3, *np.shape(t)))
    for weight, knot in ((1, 0.0), (-2, 0.25), (2, 0.75)):
        beyond = np.maximum(t - knot, 0)
        value += weight * beyond**3 * 16 / 3
        slope += weight * beyond**2 * 16 / length
        bend += weight * beyond * 32 / length**2
    return value, slope, bend


@dataclass(frozen=True, kw_only=True)
class LocalPlanner:
    """Planner of paths around obstacles; all settings are in m."""

    length: float = 4.9  # of the car
    width: float = 1.93
    clearance: float = 0.7  # lateral distance from an obstacle
    edge: float = 0.5  # distance from the edges of the road
    ahead: float = 3.0  # distance before and after an obstacle with the full offset
    out: float = 80.0  # largest length of the transition from the line
    back: float = 120.0  # length of the return
    spacing: float = 0.25  # of candidate offsets

    def __post_init__(self) -> None:
        positive_settings(self, [field.name for field in fields(self)], "[m]")

    def path(self, line: Track, obstacles: Sequence[Obstacle], now: float) -> Track:
        """Return the line with the smallest offset that avoids all obstacles, from `now` [m].

        The car is on the line at `now`, and must have the full offset at the first obstacle. Raises
        NoPathError if no offset avoids the obstacles and stays on the road.
        """
        if not obstacles:
            return line
        # Distances [m] ahead of the car between which the full offset is kept: half a car length
        # and `ahead` before the first obstacle and after the last one.
        room = (self.length / 2 + self.ahead) * np.array([-1.0, 1.0])
        distances = [(obstacle.s - now) % line.length for obstacle in obstacles]
        first = min(d - o.length / 2 for d, o in zip(distances, obstacles, strict=True)) + room[0]
        last = max(d + o.length / 2 for d, o in zip(distances, obstacles, strict=True)) + room[1]
        if first <= self.length:
            raise NoPathError(
                f"the obstacle is {min(distances):.1f} m ahead; expected more room to pass it"
            )
        # Offsets in steps of `spacing` between the edges of the road along the whole swerve.
        out = min(first, self.out)
        half = self.width / 2
        near = line.at(now + np.linspace(first - out, last + self.back, 200))
        left = float(near.width_left.min()) - half - self.edge
        right = float(near.width_right.min()) - half - self.edge
        steps = np.arange(-math.floor(right / self.spacing), math.floor(left / self.spacing) + 1)
        for e in sorted(steps * self.spacing, key=abs):
            swerve = Swerve(
                lap=line.length, start=now + first - out, out=out, stay=last - first,
                back=self.back, e=float(e),
            )  # fmt: skip
            if all(self._clear(swerve, obstacle) for obstacle in obstacles):
                return beside(line, swerve)
        raise NoPathError(
            f"no path with an offset between {-right:.2f} and {left:.2f} m passes the obstacle at "
            f"s = {obstacles[0].s:.1f} m with a clearance of {self.clearance:g} m"
        )

    def _clear(self, swerve: Swerve, obstacle: Obstacle) -> bool:
        """Return whether the car keeps the clearance along the whole obstacle."""
        reach = (self.length + obstacle.length) / 2
        beside_it = obstacle.s + np.linspace(-reach, reach, 41)
        apart = np.abs(swerve(beside_it).e - obstacle.e)
        return bool(apart.min() >= (self.width + obstacle.width) / 2 + self.clearance)
