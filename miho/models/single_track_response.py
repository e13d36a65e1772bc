"""The yaw rate of a car after its steering: a simulated single-track model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from miho.compiled.elementary import atan, cos, sin
from miho.compiled.signature import compiled_when_called
from miho.models.model import Model
from miho.models.single_track import SingleTrack
from miho.models.vehicle_settings import from_settings
from miho.quantities import Array


@dataclass(frozen=True)
class SingleTrackResponse(Model):
    """Yaw rate r [rad/s] over time t [s], from steering [rad] and speed vx [m/s], ISO-W signs.

        m (v_y' + v_x r) = F_yf cos(delta) + F_yr     I_zz r' = l_f F_yf cos(delta) - l_r F_yr
        F_y = -D sin(C arctan(B alpha)),   alpha of either axle as in `SingleTrack`

    Output-error identification: the model is simulated from the inputs alone, and only its yaw rate
    is compared with the data. `vehicle` names the fields of `SingleTrack`, of
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
        return np.asarray(_yaw_rates(np.ascontiguousarray(thetas.T), *self._record(*inputs)).T)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the yaw rate, (N, 7): the motion's own, differentiated step by step."""
        with np.errstate(all="ignore"):
            return np.asarray(_sensitivities(theta, *self._record(*inputs)))

    def _record(
        self, t: Array, vx: Array, steering: Array
    ) -> tuple[tuple[float, float, float], Array, Array, Array, Array]:
        """The car's constants, time steps, and speed, steering and its cosine at twice the rate."""
        if not (np.diff(t) > 0).all():
            raise ValueError(
                "t does not increase from row to row; give one record in order of time"
            )
        car, delta = self._car, _with_midpoints(steering)
        constants = (car.mass, car.lf, car.lr)
        return constants, np.diff(t), _with_midpoints(vx), delta, np.cos(delta)


def _with_midpoints(column: Array) -> Array:
    """A column (N,) and its values halfway between the rows, (2 N - 1,)."""
    finer = np.empty(2 * column.size - 1)
    finer[::2] = column
    finer[1::2] = (column[:-1] + column[1:]) / 2
    return finer


@compiled_when_called(error_model="numpy")
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


@compiled_when_called(error_model="numpy")
def _sensitivities(
    theta: Array,
    car: tuple[float, float, float],
    steps: Array,
    vx: Array,
    delta: Array,
    cosine: Array,
) -> Array:
    """Derivatives (N, 7) of `_yaw_rates` at one configuration (7,).

    Each stage of each step is differentiated, so these are the derivatives of what is computed, to
    rounding, and not those of the motion that it approximates.
    """
    mass, lf, lr = car

    # x_p is the derivative of x with respect to the parameters, dr and dv are rates of r and v_y.
    B_f, C_f, D_f = theta[0], theta[1], theta[2]
    B_r, C_r, D_r, Izz = theta[3], theta[4], theta[5], theta[6]
    derivatives = np.zeros((steps.size + 1, 7))
    r = v = dr = dv = 0.0
    r_p, v_p, dr_p, dv_p = np.zeros(7), np.zeros(7), np.zeros(7), np.zeros(7)
    front_p, rear_p = np.zeros(7), np.zeros(7)
    for j in range(steps.size):
        h, r_after, v_after = steps[j], r, v
        r_p_after, v_p_after = r_p.copy(), v_p.copy()
        for stage in range(4):
            at = 2 * j + (stage + 1) // 2
            ahead = h * ((stage + 1) // 2) / 2
            weight = h / 3 if stage in (1, 2) else h / 6
            speed, turned = vx[at], cosine[at]

            # The stage itself, as in `_yaw_rates`.
            at_v, at_r = v + ahead * dv, r + ahead * dr
            slip_f, slip_r = (at_v + lf * at_r) / speed, (at_v - lr * at_r) / speed
            alpha_f, alpha_r = atan(slip_f) - delta[at], atan(slip_r)
            inner_f, inner_r = atan(B_f * alpha_f), atan(B_r * alpha_r)
            front, rear = sin(C_f * inner_f) * turned, sin(C_r * inner_r)
            # Derivatives of the forces: through the motion so far ...
            by_f, by_r = -D_f * cos(C_f * inner_f) * turned, -D_r * cos(C_r * inner_r)
            per_f, per_r = C_f / (1 + (B_f * alpha_f) ** 2), C_r / (1 + (B_r * alpha_r) ** 2)
            for k in range(7):
                v_k, r_k = v_p[k] + ahead * dv_p[k], r_p[k] + ahead * dr_p[k]
                alpha_f_k = (v_k + lf * r_k) / (speed * (1 + slip_f**2))
                alpha_r_k = (v_k - lr * r_k) / (speed * (1 + slip_r**2))
                front_p[k] = by_f * per_f * B_f * alpha_f_k
                rear_p[k] = by_r * per_r * B_r * alpha_r_k
                dv_p[k], dr_p[k] = -speed * r_k, 0.0
            # ... and directly, by B, C and D of either axle.
            front_p[0] += by_f * per_f * alpha_f
            front_p[1] += by_f * inner_f
            front_p[2] -= front
            rear_p[3] += by_r * per_r * alpha_r
            rear_p[4] += by_r * inner_r
            rear_p[5] -= rear
            # Rates at this stage and their derivatives, added up with its weight.
            dv = (-D_f * front - D_r * rear) / mass - speed * at_r
            dr = (-lf * D_f * front + lr * D_r * rear) / Izz
            for k in range(7):
                dv_p[k] += (front_p[k] + rear_p[k]) / mass
                dr_p[k] = (lf * front_p[k] - lr * rear_p[k]) / Izz
            dr_p[6] -= dr / Izz
            v_after += weight * dv
            r_after += weight * dr
            for k in range(7):
                v_p_after[k] += weight * dv_p[k]
                r_p_after[k] += weight * dr_p[k]
        r, v = r_after, v_after
        r_p, v_p = r_p_after, v_p_after
        derivatives[j + 1] = r_p
    return derivatives
