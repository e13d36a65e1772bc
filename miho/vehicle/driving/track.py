"""A closed line on a road, with curvature, bank and width of the road."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array
from miho.vehicle.driving.compiling import compiled

GAP = 0.05
"""Largest gap between the end and the start of a closed line [m]."""
FEWEST = 16


class TrackPoint(NamedTuple):
    """Points of a line, with units and signs of `Track` and the shape of the arc lengths."""

    x: Array
    y: Array
    heading: Array
    curvature: Array
    bank: Array
    width_left: Array
    width_right: Array


class Projection(NamedTuple):
    """Arc length s [m] of the nearest point of a line, and offset e [m], positive to the left."""

    s: float
    e: float


@dataclass(frozen=True, eq=False)
class Track:
    """A closed line with n equidistant points, driven in the direction of rising s.

    Arc length and positions refer to the plan view.

    Parameters
    ----------
    name : str
        Name of the track.
    length : float
        Length of a lap [m].
    s : ndarray of shape (n,)
        Arc lengths [m], from 0 in steps of length / n; the last point is one step before the first.
    x, y : ndarray of shape (n,)
        Position [m], east and north.
    heading : ndarray of shape (n,)
        Heading [rad], counter-clockwise from the x axis and without jumps.
    curvature : ndarray of shape (n,)
        Curvature [1/m], positive to the left.
    bank : ndarray of shape (n,)
        Bank [rad], positive if the left side is lower, as in a left turn of an oval.
    width_left, width_right : ndarray of shape (n,)
        Distance from the line to the edges of the road [m].

    Raises
    ------
    ValueError
        If shapes or values are invalid, or if the line is not closed.
    """

    name: str
    length: float
    s: Array
    x: Array
    y: Array
    heading: Array
    curvature: Array
    bank: Array
    width_left: Array
    width_right: Array

    def __post_init__(self) -> None:
        n = np.shape(self.s)[0] if np.ndim(self.s) == 1 else 0
        for name in ("s", *TrackPoint._fields):
            values = np.array(getattr(self, name), dtype=float)
            if values.shape != (n,) or n < FEWEST or not np.isfinite(values).all():
                raise ValueError(
                    f"{name} of track {self.name} has shape {values.shape}; expected ({n},), of "
                    f"finite numbers and at least {FEWEST}"
                )
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if not 0 < self.length < math.inf or not np.allclose(self.s, np.arange(n) * self.step):
            raise ValueError(
                f"s of track {self.name} ends at {self.s[-1]:g} m of {self.length:g} m; expected "
                f"0, {self.step:g}, ... up to a step before the length"
            )
        if np.minimum(self.width_left, self.width_right).min() < 0:
            raise ValueError(f"track {self.name} has a negative width; the line leaves the road")
        if np.abs(self.bank).max() >= math.pi / 3:
            worst = math.degrees(np.abs(self.bank).max())
            raise ValueError(
                f"track {self.name} is banked by {worst:.4g} degrees; expected less than 60, in rad"
            )
        self._check_closed()

    @cached_property
    def step(self) -> float:
        """Distance of the points [m]."""
        return self.length / self.s.size

    @cached_property
    def turn(self) -> float:
        """Change of the heading over a lap [rad], 2 pi for a line that turns left."""
        bend = self.step * (self.curvature[-1] + self.curvature[0]) / 2
        return float(2 * math.pi * round((self.heading[-1] + bend - self.heading[0]) / math.tau))

    def at(self, s: ArrayLike) -> TrackPoint:
        """Return points at arc lengths [m] of any shape and lap; the heading is continuous."""
        s = np.asarray(s, dtype=float)
        rows = _points(s.ravel(), self.length, self.turn, *self._columns)
        return TrackPoint(*rows.reshape(7, *s.shape))

    def position(self, s: ArrayLike, e: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Return x and y [m] at an offset e [m] to the left of the line; arguments broadcast."""
        point = self.at(s)
        e = np.asarray(e, dtype=float)
        return point.x - e * np.sin(point.heading), point.y + e * np.cos(point.heading)

    def project(self, x: float, y: float, hint: float | None = None) -> Projection:
        """Project (x, y) on the line, near the arc length `hint`.

        The normal of the line at the result goes through (x, y). Without a hint, the search starts
        at the nearest point. s is between 0 and the length.
        """
        if hint is None:
            hint = float(self.s[np.argmin((self.x - x) ** 2 + (self.y - y) ** 2)])
        s, e = _project(x, y, hint, self.length, self.turn, *self._columns[:4])
        return Projection(s, e)

    @property
    def _columns(self) -> tuple[Array, ...]:
        """Arrays of the track in the order of `TrackPoint`."""
        return tuple(getattr(self, name) for name in TrackPoint._fields)

    def _check_closed(self) -> None:
        end = self.at(self.length * (1 - 1e-12))
        gap = math.hypot(float(end.x) - self.x[0], float(end.y) - self.y[0])
        steps = np.hypot(np.diff(self.x), np.diff(self.y))
        if gap > GAP or np.abs(steps - self.step).max() > GAP or self.turn == 0:
            raise ValueError(
                f"track {self.name} does not close: a lap of {self.length:.1f} m ends {gap:.2f} m "
                f"from its start after turning by {math.degrees(self.turn):.0f} degrees; expected "
                f"at most {GAP} m and a full turn"
            )


@compiled
def _points(
    s: Array, length: float, turn: float, xs: Array, ys: Array, heading: Array,
    curvature: Array, bank: Array, left: Array, right: Array,
) -> Array:  # fmt: skip
    """Return the rows of `TrackPoint` (7, m) at arc lengths (m,).

    Within a cell the position is on an arc: the chord has the heading of its middle.
    """
    n = xs.size
    step = length / n
    points = np.empty((7, s.size))
    for k in range(s.size):
        lap = np.floor(s[k] / length)
        steps = (s[k] - lap * length) / step
        i = min(int(steps), n - 1)
        part, j = steps - i, (i + 1) % n
        rise = heading[j] + (turn if j == 0 else 0.0) - heading[i]
        middle, chord = heading[i] + part * rise / 2, part * step
        points[0, k] = xs[i] + chord * math.cos(middle)
        points[1, k] = ys[i] + chord * math.sin(middle)
        points[2, k] = heading[i] + part * rise + lap * turn
        points[3, k] = (1 - part) * curvature[i] + part * curvature[j]
        points[4, k] = (1 - part) * bank[i] + part * bank[j]
        points[5, k] = (1 - part) * left[i] + part * left[j]
        points[6, k] = (1 - part) * right[i] + part * right[j]
    return points


@compiled
def _project(
    x: float, y: float, s: float, length: float, turn: float, xs: Array, ys: Array,
    heading: Array, curvature: Array,
) -> tuple[float, float]:  # fmt: skip
    """Project by Newton's method on the distance along the line, for `Track.project`."""
    n = xs.size
    step = length / n
    e = 0.0
    for _ in range(20):
        steps = (s % length) / step
        cell = min(int(steps), n - 1)
        part = steps - cell
        following = heading[cell + 1] if cell < n - 1 else heading[0] + turn
        rise = following - heading[cell]
        psi, middle = heading[cell] + part * rise, heading[cell] + part * rise / 2
        dx = x - xs[cell] - part * step * math.cos(middle)
        dy = y - ys[cell] - part * step * math.sin(middle)
        e = dy * math.cos(psi) - dx * math.sin(psi)
        ahead = dx * math.cos(psi) + dy * math.sin(psi)
        s += ahead / max(1 - curvature[cell] * e, 0.1)
        if abs(ahead) < 1e-9:
            break
    return s % length, e
