"""The engine lookup table: dyno measurements integrated with learned torque curves (Sec. III-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second
from numpy.typing import ArrayLike, NDArray

from miho.models.engine import RPM, TorqueCurve
from miho.quantities import Array


class Throttle(NamedTuple):
    """An opening from 0 to 1, and by how much [Nm] it misses the demanded torque, >= 0."""

    opening: Array
    residual: Array


@dataclass(frozen=True, eq=False)
class EngineMap:
    """Engine torque T_e = f(omega, tau) [Nm] over engine speed [rad/s] and throttle opening.

    Bilinear between the rows (`openings`, (K,), from 0 to 1) and columns (`speeds` [rad/s], (M,))
    of `table` [Nm] (K, M), and monotone in the throttle everywhere because it is in every column.
    Row 0 is engine braking, negative. Speeds outside the table are held at its ends, as a
    controller's table does.

    learned: weight (K, M) of the learned curves in each entry; 0 is dyno alone. correction: what
    making the table monotone added to each entry [Nm], (K, M).
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
                raise ValueError(f"{name} of the engine map holds numbers that are not finite")
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
                "expected a table that rises with the throttle, as from_points makes it"
            )

    @classmethod
    def from_points(cls, throttle: ArrayLike, omega: ArrayLike, torque: ArrayLike) -> EngineMap:
        """A map from dyno points (N,): opening [0, 1], engine speed [rad/s], torque [Nm].

        Every speed must have been measured at every opening; points at the same set point are
        averaged. Leave out rows that are not to be trusted.
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
        """The map whose columns are the isotonic regressions of those of `table`.

        `corrected` (K, M) is what had been added to the table before.
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
        """This map with learned curves blended in, each a row at its throttle.

            T = T_dyno + weight (T_learned - T_dyno)

        In a curve's own row the weight is 1 up to the opening fade[0], where the dyno is weak, and
        falls smoothly to 0 at fade[1], where it is strong. Dyno rows between two curves are, up to
        fade[0], on the line between these over the throttle, with weight 1; above, and below the
        lowest curve, they stay the dyno's.

        Outside a curve's valid interval the difference at its end is carried on with a weight that
        falls smoothly to 0 over `reach` [rad/s], so that nothing jumps and no cubic is
        extrapolated. Raises ValueError if two curves share a throttle.
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
            # 1 in the curve's own row, falling linearly to 0 in those of its neighbours
            near = share * np.interp(openings, throttles, hat, left=0, right=0)
            weight = np.outer(near, 1 - _smoothstep(np.abs(self.speeds - clipped) / reach))
            learned += weight
            table += weight * difference
        return self._monotone(openings, self.speeds, table, learned, corrected)

    def torque(self, omega: ArrayLike, throttle: ArrayLike) -> Array:
        """Torque [Nm] at engine speeds [rad/s] and openings, which broadcast.

        Raises ValueError for openings outside [0, 1].
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
        """Torque [Nm] at closed and at full throttle, at engine speeds [rad/s]."""
        return self.torque(omega, 0.0), self.torque(omega, 1.0)

    def invertible(self, omega: ArrayLike, torque: ArrayLike) -> NDArray[np.bool_]:
        """Whether some opening gives this torque [Nm] at this speed [rad/s]; they broadcast.

        So it is from engine braking to full throttle. Beyond, `throttle` saturates.
        """
        low, high = self.limits(omega)
        torque = np.asarray(torque, dtype=float)
        return np.asarray((low <= torque) & (torque <= high))

    def throttle(self, omega: ArrayLike, torque: ArrayLike) -> Throttle:
        """The smallest opening that gives the torque [Nm] at engine speeds [rad/s].

        Arguments broadcast. Where the torque cannot be given, the opening is the smallest that
        comes nearest: 0 below engine braking, 1 above full throttle unless the map is flat there.
        The residual is |T(omega, opening) - torque|. Where the map is nearly flat, above 80 %, a
        small error of the torque is a large one of the opening.
        """
        omega, torque = np.broadcast_arrays(
            np.asarray(omega, dtype=float), np.asarray(torque, dtype=float)
        )
        if not np.isfinite(torque).all():
            raise ValueError("torque holds numbers that are not finite; expected Nm")
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
    """Index of the cell of a rising axis that holds each point, and how far into it, 0 to 1."""
    if not np.isfinite(at).all():
        raise ValueError("an engine speed or throttle is not finite; expected numbers")
    index = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, axis.size - 2)
    part = (at - axis[index]) / (axis[index + 1] - axis[index])
    return index, np.asarray(np.clip(part, 0, 1))


def _interpolated(low: Array, high: Array, part: Array) -> Array:
    """Linear from low (part 0) to high (part 1), exact at both ends and monotone in the ends."""
    return np.asarray((1 - part) * low + part * high)


def _smoothstep(x: ArrayLike) -> Array:
    """0 up to 0, 1 from 1 on, with zero slope at both."""
    x = np.clip(x, 0, 1)
    return np.asarray(x * x * (3 - 2 * x))
