"""How a car answers the steering wheel: the yaw rate of a simulated single-track model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numba import njit
from numpy.typing import NDArray

from miho.models.elementary import atan, sin
from miho.models.model import DifferencedModel
from miho.models.signature import signature_of, signed
from miho.models.single_track import SingleTrack
from miho.models.vehicle_settings import from_settings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SingleTrackResponse(DifferencedModel):
    """Yaw rate r [rad/s] over time t [s], from steering [rad] and speed vx [m/s], ISO-W signs.

        m (v_y' + v_x r) = F_yf cos(delta) + F_yr     I_zz r' = l_f F_yf cos(delta) - l_r F_yr
        F_y = -D sin(C arctan(B alpha)),   alpha of either axle as in `SingleTrack`

    Output-error identification: the model runs on its own from the inputs, and only what it says
    of the yaw rate is compared with the data. `vehicle` names the fields of `SingleTrack`, of
    which mass, lf and lr are used; the parameters are B [1/rad], C [-] and D [N] of both axles
    (front _f, rear _r; two tires each) and the yaw inertia Izz [kg m^2].

    Rows are one record in the order of time with vx > 0, which begins straight ahead (v_y = r = 0).
    One step of the classical Runge-Kutta method goes from row to row, with inputs that are linear
    in between; it is stable for l_f^2 (B C D)_f + l_r^2 (B C D)_r < 2.7 Izz v_x / dt, and forces
    that saturate keep the solution bounded beyond. Raises ValueError for rows out of order.
    """

    vehicle: Mapping[str, object]
    _car: SingleTrack = field(init=False, repr=False)

    inputs = MappingProxyType({"t": "s", "vx": "m/s", "steering": "rad"})
    parameters = MappingProxyType(
        {
            "B_f": "1/rad", "C_f": "-", "D_f": "N",
            "B_r": "1/rad", "C_r": "-", "D_r": "N", "Izz": "kg*m^2",
        }
    )  # fmt: skip
    output = "rad/s"
    ordered = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "_car", from_settings(SingleTrack, self.vehicle))

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Yaw rate [rad/s], (n, N)."""
        t, vx, steering = inputs
        if not (np.diff(t) > 0).all():
            raise ValueError(
                "t does not increase from row to row; give one record in order of time"
            )
        speed, delta = _with_halves(vx), _with_halves(steering)
        car = self._car
        return np.asarray(
            _yaw_rates(
                np.ascontiguousarray(thetas.T), (car.mass, car.lf, car.lr),
                np.diff(t), speed, delta, np.cos(delta),
            ).T
        )  # fmt: skip


def _with_halves(column: Array) -> Array:
    """A column (N,) and its values halfway between the rows, (2 N - 1,)."""
    both = np.empty(2 * column.size - 1)
    both[::2] = column
    both[1::2] = (column[:-1] + column[1:]) / 2
    return both


@njit(cache=True, error_model="numpy")
@signed(signature_of())
def _yaw_rates(
    columns: Array,
    car: tuple[float, float, float],
    steps: Array,
    vx: Array,
    delta: Array,
    cosine: Array,
) -> Array:
    """Yaw rates (N, n) of parameter columns (7, n) after steps (N - 1,).

    Inputs (2 N - 1,) are at the rows and halfway between. The configurations are the inner loop,
    so that the processor moves several cars at once. vx is positive: arctan is arctan2.
    """
    mass, lf, lr = car
    n = columns.shape[1]
    yaw_rates, lateral = np.zeros((steps.size + 1, n)), np.zeros(n)  # r, v_y at the row
    dr, dv = np.zeros(n), np.zeros(n)  # their rates at the stage before
    for j in range(steps.size):
        h, r, after = steps[j], yaw_rates[j], yaw_rates[j + 1]
        after[:] = r
        v_after = lateral.copy()
        for stage in range(4):
            at = 2 * j + (stage + 1) // 2
            ahead = h * ((stage + 1) // 2) / 2
            weight = h / 3 if stage in (1, 2) else h / 6
            speed, steering, turned = vx[at], delta[at], cosine[at]
            for i in range(n):
                v, w = lateral[i] + ahead * dv[i], r[i] + ahead * dr[i]
                alpha_f = atan((v + lf * w) / speed) - steering
                alpha_r = atan((v - lr * w) / speed)
                B_f, C_f, D_f = columns[0, i], columns[1, i], columns[2, i]
                B_r, C_r, D_r = columns[3, i], columns[4, i], columns[5, i]
                front = -D_f * sin(C_f * atan(B_f * alpha_f)) * turned
                rear = -D_r * sin(C_r * atan(B_r * alpha_r))
                dv[i] = (front + rear) / mass - speed * w
                dr[i] = (lf * front - lr * rear) / columns[6, i]
                v_after[i] += weight * dv[i]
                after[i] += weight * dr[i]
        lateral = v_after
    return yaw_rates
