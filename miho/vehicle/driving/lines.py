"""Lines as tracks: centre lines from files, and lines at an offset (lanes and swerves)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import BSpline, PchipInterpolator, splprep

from miho.data.csv import read_numbers
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


def track_from_csv(
    path: str,
    columns: Sequence[str] = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m"),
    bank: str | None = None,
    *,
    step: float = 1.0,
    noise: float = 0.1,
) -> Track:
    """Make a track from points of its centre line in a CSV file with a header.

    A periodic cubic spline smooths the points, because survey noise would appear as curvature.

    Parameters
    ----------
    path : str
        The CSV file. Points follow the direction of travel; the last point may repeat the first.
    columns : sequence of str, optional
        Column names of x, y and the widths to the right and to the left [m], in this order.
    bank : str, optional
        Column name of the bank [rad], positive if the left side is lower; flat by default.
    step : float, optional
        Distance of the points of the track [m].
    noise : float, optional
        Standard deviation of the coordinates of the points [m].

    Returns
    -------
    Track
        The closed line.

    Raises
    ------
    CSVError
        If the file cannot be read.
    ValueError
        If the points do not form a closed line.
    """
    headers = [*columns, *([] if bank is None else [bank])]
    rows = np.stack(list(read_numbers(Path(path), headers, header=True).values()), axis=1)
    if np.hypot(*(rows[-1] - rows[0])[:2]) < 1e-6:
        rows = rows[:-1]
    x, y, right, left = rows[:, :4].T
    around = np.hypot(np.diff(x, append=x[0]), np.diff(y, append=y[0]))
    if len(rows) < 8 or around.min() == 0 or around[-1] > 3 * np.median(around) + 1.0:
        raise ValueError(
            f"{path}: {len(rows)} points, the last {around[-1]:.4g} m from the first and others "
            f"{np.median(around):.4g} m apart; expected a closed line of distinct points"
        )
    along = np.concatenate([[0.0], np.cumsum(around)])
    points = [np.append(column, column[0]) for column in (x, y)]
    fitted: Any = splprep(points, u=along, s=2 * len(rows) * noise**2, per=True)[0]
    knots, parts, degree = fitted
    line = BSpline(knots, np.stack(parts, axis=1), degree)
    fine = np.linspace(0.0, along[-1], 8 * max(len(rows), math.ceil(along[-1] / step)) + 1)
    length, s, u = by_length(np.hypot(*line(fine, 1).T), fine, step)
    (sx, sy), (dx, dy), (ddx, ddy) = (line(u, order).T for order in range(3))
    wide = [np.interp(u, along, np.append(column, column[0])) for column in (left, right)]
    lean = np.zeros(len(rows)) if bank is None else rows[:, 4]
    return Track(
        Path(path).stem, length, s, sx, sy, np.unwrap(np.arctan2(dy, dx)),
        (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3,
        np.interp(u, along, np.append(lean, lean[0])), *wide,
    )  # fmt: skip
