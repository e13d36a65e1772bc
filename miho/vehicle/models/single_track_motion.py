"""Motion of a single-track car, for identification from driving data."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from miho.models import Model, Trajectory
from miho.models.layout import MEASURED
from miho.vehicle.models.single_track import SingleTrack
from miho.vehicle.models.vehicle_settings import from_settings


def single_track_response(vehicle: Mapping[str, object]) -> Model:
    """Model of the yaw rate r [rad/s] over time t [s], from steering [rad] and speed vx [m/s].

        m (v_y' + v_x r) = F_yf cos(delta) + F_yr     I_zz r' = l_f F_yf cos(delta) - l_r F_yr
        F_y = -D sin(C arctan(B alpha)),   alpha of either axle as in `SingleTrack`

    Signs are ISO-W. The parameters are B [1/rad], C [-] and D [N] of both axles (front _f, rear
    _r; two tires each) and the yaw inertia Izz [kg m^2].

    Rows are one record in order of time with vx > 0. The record begins with straight driving
    (v_y = r = 0). There is one integration step per row. It is stable for l_f^2 (B C D)_f + l_r^2
    (B C D)_r < 2.7 Izz v_x / dt; saturating forces keep the solution bounded for longer steps.

    Parameters
    ----------
    vehicle : Mapping[str, object]
        Fields of `SingleTrack`, of which mass, lf and lr are used.

    Returns
    -------
    Model
        A `Trajectory`.

    Raises
    ------
    ValueError
        If a field is missing, unknown or invalid.
    """
    car = from_settings(SingleTrack, vehicle)
    return Trajectory(
        partial(_lateral_motion, mass=car.mass, lf=car.lf, lr=car.lr),
        states={"vy": 0.0, "yaw_rate": 0.0},
        outputs=["yaw_rate"],
        units=MOTION | SIMPLE | {"Izz": "kg*m^2"},
        name="single_track_response",
    )


def single_track_drive(
    vehicle: Mapping[str, object], speed: float = 30.0, restart: int | None = None
) -> Model:
    """Model of vx, vy [m/s] and yaw rate [rad/s] from acceleration ax [m/s^2] and steering [rad].

        v_x' = a_x + v_y r    m (v_y' + v_x r) = F_yf cos(delta) + F_yr
        I_zz r' = l_f F_yf cos(delta) - l_r F_yr
        F_y = Sv - D sin(C arctan(z - E (z - arctan(z)))),   z = B (alpha + Sh)

    a_x is the reading of a longitudinal accelerometer. The twelve parameters are B [1/rad], C [-],
    D [N], E [-], Sh [rad] and Sv [N] of the front axle _f and the rear axle _r, two tires each.
    B C D of each axle is reported as its cornering stiffness. Outputs are divided by
    `DRIVE_NOISE`, as in the data of `miho.vehicle.data.tire_drive`. Inputs are constant from row to
    row.

    Parameters
    ----------
    vehicle : Mapping[str, object]
        Fields of `SingleTrack`.
    speed : float, optional
        Initial speed of straight driving [m/s].
    restart : int, optional
        Number of rows after which the simulation restarts from the measured motion, see
        `Trajectory`; by default it does not restart.

    Returns
    -------
    Model
        A `Trajectory`.

    Raises
    ------
    ValueError
        If a field is missing, unknown or invalid.
    """
    car = from_settings(SingleTrack, vehicle)
    straight: dict[str, float | str] = {"vx": speed, "vy": 0.0, "yaw_rate": 0.0}
    return Trajectory(
        partial(planar_motion, mass=car.mass, lf=car.lf, lr=car.lr, Izz=car.Izz),
        states=straight if restart is None else dict.fromkeys(straight, MEASURED),
        outputs=list(DRIVE_NOISE),
        scales=list(DRIVE_NOISE.values()),
        interpolation="hold",
        restart=restart,
        substeps=5,
        units=MOTION | BENT | STIFFNESSES | {"ax": "m/s^2"},
        name="single_track_drive",
        quantities=[front_cornering_stiffness, rear_cornering_stiffness],
    )


DRIVE_NOISE = MappingProxyType({"vx": 0.05, "vy": 0.05, "yaw_rate": 0.005})
"""Standard deviation of white noise of each output, in SI units, for a good unit with GNSS."""


def _units(axle: Mapping[str, str]) -> dict[str, str]:
    return {f"{name}_{end}": unit for end in "fr" for name, unit in axle.items()}


MOTION = {"vx": "m/s", "vy": "m/s", "yaw_rate": "rad/s", "steering": "rad"}
SIMPLE = _units({"B": "1/rad", "C": "-", "D": "N"})
STIFFNESSES = dict.fromkeys(("front_cornering_stiffness", "rear_cornering_stiffness"), "N/rad")
BENT = SIMPLE | _units({"E": "-", "Sh": "rad", "Sv": "N"})


def _lateral_motion(
    vy: Any, yaw_rate: Any, vx: Any, steering: Any, *,
    B_f: Any, C_f: Any, D_f: Any, B_r: Any, C_r: Any, D_r: Any, Izz: Any,
    mass: float, lf: float, lr: float,
) -> tuple[Any, Any]:  # fmt: skip
    """Return the rates of v_y and the yaw rate; arctan equals arctan2, because vx is positive."""
    alpha_f = np.arctan((vy + lf * yaw_rate) / vx) - steering
    alpha_r = np.arctan((vy - lr * yaw_rate) / vx)
    front = -D_f * np.sin(C_f * np.arctan(B_f * alpha_f)) * np.cos(steering)
    rear = -D_r * np.sin(C_r * np.arctan(B_r * alpha_r))
    return (front + rear) / mass - vx * yaw_rate, (lf * front - lr * rear) / Izz


def planar_motion(
    vx: Any, vy: Any, yaw_rate: Any, ax: Any, steering: Any, *,
    B_f: Any, C_f: Any, D_f: Any, E_f: Any, Sh_f: Any, Sv_f: Any,
    B_r: Any, C_r: Any, D_r: Any, E_r: Any, Sh_r: Any, Sv_r: Any,
    mass: float, lf: float, lr: float, Izz: float,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Return the rates of v_x, v_y and the yaw rate; v_x must be positive."""
    z_f = B_f * (np.arctan((vy + lf * yaw_rate) / vx) - steering + Sh_f)
    z_r = B_r * (np.arctan((vy - lr * yaw_rate) / vx) + Sh_r)
    front = Sv_f - D_f * np.sin(C_f * np.arctan(z_f - E_f * (z_f - np.arctan(z_f))))
    rear = Sv_r - D_r * np.sin(C_r * np.arctan(z_r - E_r * (z_r - np.arctan(z_r))))
    front = front * np.cos(steering)
    return (
        ax + vy * yaw_rate,
        (front + rear) / mass - vx * yaw_rate,
        (lf * front - lr * rear) / Izz,
    )


def front_cornering_stiffness(*, B_f: Any, C_f: Any, D_f: Any) -> Any:
    """Return B C D [N/rad] of the front axle."""
    return B_f * C_f * D_f


def rear_cornering_stiffness(*, B_r: Any, C_r: Any, D_r: Any) -> Any:
    """Return B C D [N/rad] of the rear axle."""
    return B_r * C_r * D_r
