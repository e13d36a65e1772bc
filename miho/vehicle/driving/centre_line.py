"""A track from points of its centre line in a CSV file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, splprep

from miho.data.csv import read_numbers
from miho.vehicle.driving.lines import by_length
from miho.vehicle.driving.track import Track


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
