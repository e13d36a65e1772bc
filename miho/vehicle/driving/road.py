"""The road under a simulated car: a banked ribbon along a line, or a plane."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from miho.quantities import Array
from miho.validate import positive
from miho.vehicle.driving.compiling import part
from miho.vehicle.driving.track import Track


class Road(NamedTuple):
    """A line in n cells of equal length for compiled code, with units and signs of `Track`.

    A line that is not closed continues straight beyond its ends.

    Attributes
    ----------
    step : float
        Length of a cell [m].
    closed : bool
        Whether the line is closed.
    turn : float
        Change of the heading over a lap [rad].
    x, y, heading, bank : ndarray of shape (n + 1,)
        Position [m], heading [rad] and bank [rad] at the ends of the cells.
    curvature : ndarray of shape (n,)
        Curvature of each cell [1/m]; its integral is the heading.
    friction : float
        Friction relative to the surface of the tire measurement [-].
    """

    step: float
    closed: bool
    turn: float
    x: Array
    y: Array
    heading: Array
    bank: Array
    curvature: Array
    friction: float = 1.0


PLANE = Road(
    1.0, False, 0.0, np.array([0.0, 1.0]), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(1)
)
"""Flat ground, with the x axis as its line."""


def road_of(track: Track, friction: float = 1.0) -> Road:
    """Return the road of a track.

    Parameters
    ----------
    track : Track
        The closed line.
    friction : float, optional
        Friction relative to the surface of the tire measurement [-].

    Returns
    -------
    Road
        The road for compiled code.

    Raises
    ------
    ValueError
        If the friction is not positive.
    """
    positive("friction of the road", friction)
    x, y, bank = (np.append(column, column[0]) for column in (track.x, track.y, track.bank))
    heading = np.append(track.heading, track.heading[0] + track.turn)
    curvature = np.diff(heading) / track.step
    return Road(float(track.step), True, track.turn, x, y, heading, bank, curvature, friction)


@part
def shape_at(road: Road, s: float) -> tuple[float, float]:
    """Return the plan curvature [1/m] and bank [rad] at an arc length [m] of any lap."""
    i, part, _ = _cell(road, s)
    bank: float = road.bank[i] + part * (road.bank[i + 1] - road.bank[i])
    return road.curvature[i], bank


@part
def place_at(road: Road, s: float, offset: float) -> tuple[float, float, float]:
    """Return x, y [m] and the heading of the line [rad] at an arc length and a plan offset [m].

    Within a cell the line is an arc, as in `Track`: the chord has the heading of its middle.
    """
    i, part, lap = _cell(road, s)
    rise = road.heading[i + 1] - road.heading[i]
    middle, heading = road.heading[i] + part * rise / 2, road.heading[i] + part * rise
    x = road.x[i] + part * road.step * np.cos(middle) - offset * np.sin(heading)
    y = road.y[i] + part * road.step * np.sin(middle) + offset * np.cos(heading)
    return x, y, heading + lap * road.turn


@part
def _cell(road: Road, s: float) -> tuple[int, float, Any]:
    """Return the cell of an arc length, the position in it (0 to 1 if closed), and the laps."""
    at, lap = s / road.step, 0.0
    n = road.curvature.size
    if road.closed:
        lap = np.floor(at / n)
        at -= lap * n
    i = min(max(int(np.floor(at)), 0), n - 1)
    return i, at - i, lap
