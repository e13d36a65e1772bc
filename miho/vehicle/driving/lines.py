"""Lines at an offset from a line: racing lines, lanes and swerves, as tracks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import PchipInterpolator

from miho.quantities import Array
from miho.vehicle.driving.track import Track


class Offset(NamedTuple):
    """An offset e [m] along a line, positive to the left, with e' [-] and e'' [1/m]."""

    e: Array
    slope: Array
    bend: Array


def constant(e: float) -> Callable[[Array], Offset]:
    """Return a constant offset [m] for `beside`."""

    def offset(s: Array) -> Offset:
        return Offset(np.full_like(s, e), np.zeros_like(s), np.zeros_like(s))

    return offset


def beside(track: Track, offset: Callable[[Array], Offset], name: str | None = None) -> Track:
    """Return the line at an offset from `track`, with new arc length, heading and curvature.

    `offset` is called with arc lengths of the track (m,) [m] and must be periodic over a lap. With
    derivatives by the arc length of the track, the curvature is

        kappa = (u (u kappa_0 + e'') + e' (kappa_0' e + 2 kappa_0 e')) / (u^2 + e'^2)^(3/2),
        u = 1 - kappa_0 e

    Raises ValueError if the line leaves the road, or if the offset reaches the centre of a bend.
    """
    fine = np.linspace(0.0, track.length, 4 * track.s.size + 1)
    length, s_line, s = by_length(_stretch(track, offset, fine), fine, track.step)
    e, slope, bend = offset(s)
    point = track.at(s)
    x, y = track.position(s, e)
    u = 1 - point.curvature * e
    change = (track.at(s + 0.5).curvature - track.at(s - 0.5).curvature) / 1.0
    turned = u * (u * point.curvature + bend) + slope * (change * e + 2 * point.curvature * slope)
    return Track(
        track.name if name is None else name, length, s_line, x, y,
        point.heading + np.arctan2(slope, u), turned / np.hypot(u, slope) ** 3,
        point.bank, point.width_left - e, point.width_right + e,
    )  # fmt: skip


def by_length(speed: Array, u: Array, step: float) -> tuple[float, Array, Array]:
    """Return the length [m] of a line, arc lengths (n,) in equal steps, and its parameter there.

    The line has the length `speed` (m,) per parameter u (m,). The steps are at most `step` [m].
    """
    length = cumulative_simpson(speed, x=u, initial=0.0)
    n = math.ceil(length[-1] / step)
    s = np.arange(n) * (length[-1] / n)
    return float(length[-1]), s, PchipInterpolator(length, u)(s)


def _stretch(track: Track, offset: Callable[[Array], Offset], s: Array) -> Array:
    """Return the length of the offset line per length of the track [-]."""
    e, slope, _ = offset(s)
    u = 1 - track.at(s).curvature * e
    if u.min() <= 0.05:
        raise ValueError(
            f"an offset of {e[np.argmin(u)]:.4g} m at s = {s[np.argmin(u)]:.4g} m reaches the "
            "centre of the bend; expected a smaller one"
        )
    return np.asarray(np.hypot(u, slope))
