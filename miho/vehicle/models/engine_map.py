"""The engine lookup table: dyno measurements integrated with learned torque curves (Sec. III-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # loads its subpackages at first use, because importing them takes a second
from numpy.typing import ArrayLike, NDArray

from miho.quantities import Array
from miho.vehicle.models.engine import RPM, TorqueCurve


class Throttle(NamedTuple):
    """An opening from 0 to 1, and the absolute difference to the demanded torque [Nm]."""

    opening: Array
    residual: Array


@dataclass(frozen=True, eq=False)
class EngineMap:
    """Engine torque T_e = f(omega, tau) [Nm] over engine speed [rad/s] and throttle opening.

    The map is bilinear between the entries of the table, and constant beyond its lowest and highest
    speed. Each column increases with the throttle, so the map is monotone in the throttle.

    Parameters
    ----------
    openings : ndarray of shape (K,)
        Throttle openings of the rows, from 0 to 1.
    speeds : ndarray of shape (M,)
        Engine speeds of the columns [rad/s].
    table : ndarray of shape (K, M)
        Torque [Nm]. Row 0 is engine braking, which is negative.
    learned : ndarray of shape (K, M)
        Weight of the learned curves in each entry; 0 for dyno data only.
    correction : ndarray of shape (K, M)
        Change of each entry [Nm] that made the table monotone.

    Raises
    ------
    ValueError
        If shapes or values are invalid, or if the torque falls with the throttle.
    """

    openings: Array
    speeds: Array
    table: Array
    learned: Array
    correction: Array

    def __post_init__(self) -> None:
        for name in ("openings", "speeds", "table", "learned", "correction"):
            values = np.array(getattr(self, name), dtype=float)
            if not np.isfinite(values).all():
                raise ValueError(f"{name} of the engine map: expected finite numbers")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        for name in ("openings", "speeds"):
            axis = getattr(self, name)
            if axis.ndim != 1 or axis.size < 2 or not (np.diff(axis) > 0).all():
                raise ValueError(f"{name} of the engine map is {axis}; expected rising numbers")
        if (self.openings[0], self.openings[-1]) != (0, 1) or self.speeds[0] < 0:
            raise ValueError(
                f"the engine map has openings {self.openings[0]} to {self.openings[-1]} and speeds "
                f"from {self.speeds[0]} rad/s; expected 0 to 1, and speeds of at least 0"
            )
        for name in ("table", "learned", "correction"):
            actual, shape = getattr(self, name).shape, (self.openings.size, self.speeds.size)
            if actual != shape:
                raise ValueError(f"{name} of the engine map has shape {actual}; expected {shape}")
        falls = np.diff(self.table, axis=0).min()
        if falls < 0:
            raise ValueError(
                f"the torque falls by up to {-falls:.3g} Nm from one throttle row to the next; "
                "expected a table that rises with the throttle; use EngineMap.from_points"
            )

    @classmethod
    def from_points(cls, throttle: ArrayLike, omega: ArrayLike, torque: ArrayLike) -> EngineMap:
        """Make a map from dyno points.

        Points at the same set point are averaged, and columns are made monotone in the throttle.

        Parameters
        ----------
        throttle, omega, torque : array_like of shape (N,)
            Opening from 0 to 1, engine speed [rad/s] and torque [Nm] of each point. Each speed
            must be measured at each opening. Leave out unreliable points.

        Returns
        -------
        EngineMap
            The map.

        Raises
        ------
        ValueError
            If a combination of speed and opening has no point.
        """
        points = [np.asarray(column, dtype=float) for column in (throttle, omega, torque)]
        rows, row = np.unique(points[0], return_inverse=True)
        columns, column = np.unique(points[1], return_inverse=True)
        count, total = np.zeros((2, rows.size, columns.size))
        np.add.at(count, (row, column), 1)
        np.add.at(total, (row, column), points[2])
        if not count.all():
            k, m = np.argwhere(count == 0)[0]
            raise ValueError(
                f"the dyno has no point at throttle {rows[k]:g} and {columns[m]:.6g} rad/s; "
                "expected every speed at every throttle"
            )
        nothing = np.zeros_like(total)
        return cls._monotone(rows, columns, total / count, nothing, nothing)

    @classmethod
    def _monotone(
        cls, openings: Array, speeds: Array, table: Array, learned: Array, corrected: Array
    ) -> EngineMap:
        """Return the map with the isotonic regression of each column of `table`.

        `corrected` (K, M) is the sum of earlier corrections.
        """
        risen = np.apply_along_axis(
            lambda column: scipy.optimize.isotonic_regression(column).x, 0, table
        )
        return cls(openings, speeds, risen, learned, corrected + risen - table)

    def integrate(
        self,
        curves: Sequence[TorqueCurve],
        *,
        fade: tuple[float, float] = (0.2, 0.4),
        reach: float = 1000 * RPM,
    ) -> EngineMap:
        """Return this map blended with learned curves, each of which adds a row at its throttle.

            T = T_dyno + weight (T_learned - T_dyno)

        In the row of a curve, the weight is 1 up to the opening fade[0], where the dyno is
        imprecise, and falls smoothly to 0 at fade[1]. Dyno rows between two curves are interpolated
        linearly between these curves up to fade[0]. Dyno rows above fade[0] and below the lowest
        curve are unchanged. Outside the valid interval of a curve, the difference at its end is
        used with a weight that falls smoothly to 0, so the map is continuous and no cubic is
        extrapolated.

        Parameters
        ----------
        curves : sequence of TorqueCurve
            Learned curves at different throttles.
        fade : tuple of float, optional
            Openings between which the weight falls from 1 to 0.
        reach : float, optional
            Range beyond a valid interval over which the weight falls to 0 [rad/s].

        Returns
        -------
        EngineMap
            The blended map, made monotone in the throttle.

        Raises
        ------
        ValueError
            If two curves have the same throttle, or if `fade` or `reach` is invalid.
        """
        curves = sorted(curves, key=lambda curve: curve.throttle)
        throttles = [curve.throttle for curve in curves]
        if len(set(throttles)) != len(throttles):
            raise ValueError(f"the curves have throttles {throttles}; expected one curve each")
        if not fade[0] < fade[1] or not reach > 0:
            raise ValueError(
                f"fade is {fade} and reach is {reach}; expected the lower opening first and a "
                "reach above 0 rad/s"
            )
        openings = np.union1d(self.openings, throttles)
        table = self.torque(self.speeds, openings[:, None])
        learned, corrected = np.zeros((2, *table.shape))
        corrected[np.isin(openings, self.openings)] = self.correction
        share = 1 - _smoothstep((openings - fade[0]) / (fade[1] - fade[0]))
        share[(openings > fade[0]) & ~np.isin(openings, throttles)] = 0
        for curve, hat in zip(curves, np.eye(len(curves)), strict=True):
            clipped = np.clip(self.speeds, *curve.valid)
            difference = curve.torque(clipped) - self.torque(clipped, openings[:, None])
            # 1 in the row of the curve, falling linearly to 0 in the rows of its neighbours
            near = share * np.interp(openings, throttles, hat, left=0, right=0)
            weight = np.outer(near, 1 - _smoothstep(np.abs(self.speeds - clipped) / reach))
            learned += weight
            table += weight * difference
        return self._monotone(openings, self.speeds, table, learned, corrected)

    def torque(self, omega: ArrayLike, throttle: ArrayLike) -> Array:
        """Return the torque of the map; arguments broadcast.

        Parameters
        ----------
        omega : array_like
            Engine speeds [rad/s].
        throttle : array_like
            Openings from 0 to 1.

        Returns
        -------
        ndarray
            Torque [Nm].

        Raises
        ------
        ValueError
            For openings outside [0, 1].
        """
        omega, throttle = np.broadcast_arrays(
            np.asarray(omega, dtype=float), np.asarray(throttle, dtype=float)
        )
        if not ((throttle >= 0) & (throttle <= 1)).all():
            raise ValueError(
                f"throttle ranges from {throttle.min()} to {throttle.max()}; expected 0 to 1"
            )
        row, up = _cell(self.openings, throttle)
        column, right = _cell(self.speeds, omega)
        low = _interpolated(self.table[row, column], self.table[row, column + 1], right)
        high = _interpolated(self.table[row + 1, column], self.table[row + 1, column + 1], right)
        return _interpolated(low, high, up)

    def limits(self, omega: ArrayLike) -> tuple[Array, Array]:
        """Return the torques [Nm] at closed and full throttle, at engine speeds [rad/s]."""
        return self.torque(omega, 0.0), self.torque(omega, 1.0)

    def throttle(self, omega: ArrayLike, torque: ArrayLike) -> Throttle:
        """Return the smallest opening that gives a torque; arguments broadcast.

        The map is nearly flat above 80 % throttle, so a small error of the torque causes a large
        error of the opening.

        Parameters
        ----------
        omega : array_like
            Engine speeds [rad/s].
        torque : array_like
            Torques [Nm].

        Returns
        -------
        Throttle
            Openings, and the residual |T(omega, opening) - torque| [Nm]. For a torque out of range,
            the smallest opening with the nearest torque: 0 below engine braking, and 1 above full
            throttle unless the map is flat there.
        """
        omega, torque = np.broadcast_arrays(
            np.asarray(omega, dtype=float), np.asarray(torque, dtype=float)
        )
        if not np.isfinite(torque).all():
            raise ValueError("torque has numbers that are not finite; expected torques [Nm]")
        column, right = _cell(self.speeds, omega)
        rows = _interpolated(self.table[:, column], self.table[:, column + 1], right)
        target = np.clip(torque, rows[0], rows[-1])
        above = (rows < target).sum(axis=0)  # the first row that gives the torque
        below = np.maximum(above - 1, 0)
        at_above, at_below = (np.take_along_axis(rows, k[None], 0)[0] for k in (above, below))
        rise = at_above - at_below
        part = np.divide(target - at_below, rise, out=np.zeros_like(rise), where=rise > 0)
        opening = _interpolated(self.openings[below], self.openings[above], part)
        return Throttle(opening, np.abs(self.torque(omega, opening) - torque))


def _cell(axis: Array, at: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the cell of a rising axis with each point, and the position in it from 0 to 1."""
    if not np.isfinite(at).all():
        raise ValueError("an engine speed or throttle is not finite; expected numbers")
    index = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, axis.size - 2)
    part = (at - axis[index]) / (axis[index + 1] - axis[index])
    return index, np.asarray(np.clip(part, 0, 1))


def _interpolated(low: Array, high: Array, part: Array) -> Array:
    """Interpolate from low (part 0) to high (part 1), exact at both ends."""
    return np.asarray((1 - part) * low + part * high)


def _smoothstep(x: ArrayLike) -> Array:
    """Return a smooth step: 0 for x <= 0 and 1 for x >= 1, with zero slope at both."""
    x = np.clip(x, 0, 1)
    return np.asarray(x * x * (3 - 2 * x))
