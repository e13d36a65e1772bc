"""The motion of a single-track car, to be identified from how it drives."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from miho.models.model import Model
from miho.models.single_track import SingleTrack
from miho.models.trajectory import Trajectory
from miho.models.vehicle_settings import from_settings


def single_track_response(vehicle: Mapping[str, object]) -> Model:
    """Yaw rate r [rad/s] over time t [s], from steering [rad] and speed vx [m/s], ISO-W signs.

        m (v_y' + v_x r) = F_yf cos(delta) + F_yr     I_zz r' = l_f F_yf cos(delta) - l_r F_yr
        F_y = -D sin(C arctan(B alpha)),   alpha of either axle as in `SingleTrack`

    `vehicle` names the fields of `SingleTrack`, of which mass, lf and lr are used; the parameters
    are B [1/rad], C [-] and D [N] of both axles (front _f, rear _r; two tires each) and the yaw
    inertia Izz [kg m^2].

    Rows are one record in the order of time with vx > 0, which begins straight ahead (v_y = r = 0).
    One step goes from row to row; it is stable for l_f^2 (B C D)_f + l_r^2 (B C D)_r < 2.7 Izz v_x
    / dt, and forces that saturate keep the solution bounded beyond.
    """
    car = from_settings(SingleTrack, vehicle)
    return Trajectory(
        partial(_lateral_motion, mass=car.mass, lf=car.lf, lr=car.lr),
        states={"vy": 0.0, "yaw_rate": 0.0},
        outputs=["yaw_rate"],
        units=UNITS,
        name="single_track_response",
    )


AXLE = MappingProxyType({"B": "1/rad", "C": "-", "D": "N"})
UNITS = MappingProxyType(
    {"vx": "m/s", "vy": "m/s", "yaw_rate": "rad/s", "steering": "rad", "Izz": "kg*m^2"}
    | {f"{name}_{axle}": unit for axle in "fr" for name, unit in AXLE.items()}
)


def _lateral_motion(
    vy: Any, yaw_rate: Any, vx: Any, steering: Any, *,
    B_f: Any, C_f: Any, D_f: Any, B_r: Any, C_r: Any, D_r: Any, Izz: Any,
    mass: float, lf: float, lr: float,
) -> tuple[Any, Any]:  # fmt: skip
    """Rates of v_y and of the yaw rate; vx is positive, so that arctan is arctan2."""
    alpha_f = np.arctan((vy + lf * yaw_rate) / vx) - steering
    alpha_r = np.arctan((vy - lr * yaw_rate) / vx)
    front = -D_f * np.sin(C_f * np.arctan(B_f * alpha_f)) * np.cos(steering)
    rear = -D_r * np.sin(C_r * np.arctan(B_r * alpha_r))
    return (front + rear) / mass - vx * yaw_rate, (lf * front - lr * rear) / Izz
