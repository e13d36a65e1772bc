"""A synthetic drive: vx, vy and yaw rate of a car with twelve known tire parameters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from miho.data import Dataset, stacked
from miho.models.trajectory import Trajectory
from miho.quantities import Array
from miho.validate import at_least, one_of, positive, whole
from miho.vehicle.models.single_track import SingleTrack
from miho.vehicle.models.single_track_motion import BENT, DRIVE_NOISE, MOTION, planar_motion
from miho.vehicle.models.vehicle_settings import from_settings

DRIVE_TRUTH = MappingProxyType(
    {
        "B_f": 16.0, "C_f": 1.5, "D_f": 5500.0, "E_f": -0.5, "Sh_f": 0.003, "Sv_f": 80.0,
        "B_r": 17.0, "C_r": 1.5, "D_r": 7800.0, "E_r": -0.4, "Sh_r": 0.002, "Sv_r": 100.0,
    }
)  # fmt: skip
"""The car's axles, in SI units: nearly neutral, so that both saturate."""

STYLES = MappingProxyType({"lively": 0.12, "gentle": 0.06})
"""Largest steering angle [rad]."""
GUST, TWIST = 400.0, 40.0
"""Standard deviations of the disturbing forces along and across [N], and of their moment [Nm]."""
RATE = 50.0


def tire_drive(
    vehicle: Mapping[str, object],
    style: str = "lively",
    duration: float = 120.0,
    noise: float = 1.0,
    disturbance: float = 0.0,
    seed: int = 0,
) -> Dataset:
    """A weave at 15 to 35 m/s, 50 rows per second, with outputs vx, vy and yaw rate.

    The outputs are stacked (see `stacked`) with `DRIVE_NOISE` as scales. The drive begins straight
    ahead at 30 m/s. Inputs are exact and constant between rows.

    Parameters
    ----------
    vehicle : mapping of str to object
        Fields of `SingleTrack`; the axles are `DRIVE_TRUTH`.
    style : {'lively', 'gentle'}
        A lively drive takes both axles beyond their peaks. A gentle one stays where forces are
        linear in the slip angles.
    duration : float
        Duration [s].
    noise : float
        Standard deviation of the sensors' white noise, in multiples of `DRIVE_NOISE`.
    disturbance : float
        Standard deviation of random forces and moments (gusts), in multiples of `GUST` and `TWIST`;
        they change at each row.
    seed : int
        Seed of noise and disturbance.

    Returns
    -------
    Dataset
        The stacked outputs over t, ax and steering.
    """
    one_of("style", style, list(STYLES))
    positive("duration", duration)
    at_least("noise", noise, 0)
    at_least("disturbance", disturbance, 0)
    whole("seed", seed, 0)
    t = np.arange(max(2, round(duration * RATE))) / RATE
    ax, steering = _manoeuvre(t, style)
    rng = np.random.default_rng([seed, *b"drive"])
    gusts = disturbance * np.array([[GUST], [GUST], [TWIST]]) * rng.standard_normal((3, t.size))
    columns = {"t": t, "ax": ax, "steering": steering}
    for name, exact in _motion(from_settings(SingleTrack, vehicle), columns, gusts).items():
        columns[name] = exact + noise * DRIVE_NOISE[name] * rng.standard_normal(t.size)
    units = {name: (MOTION | {"t": "s", "ax": "m/s^2"})[name] for name in columns}
    return stacked(Dataset(f"{style}_drive", columns, units, "yaw_rate"), DRIVE_NOISE)


def _manoeuvre(t: Array, style: str) -> tuple[Array, Array]:
    """Acceleration [m/s^2] and steering angle [rad] at times t [s], with up to 0.8 Hz."""
    swell = 0.5 + 0.5 * np.sin(2 * np.pi * t / 23.0)
    weave = np.sin(2 * np.pi * (0.5 * t + 1.5 * np.sin(2 * np.pi * t / 31.0)))
    return 2.0 * np.cos(2 * np.pi * t / 19.0), STYLES[style] * swell * weave


def _motion(car: SingleTrack, columns: Mapping[str, Array], gusts: Array) -> dict[str, Array]:
    """vx, vy and yaw rate without noise, integrated in steps of a millisecond."""
    model = Trajectory(
        partial(_blown, mass=car.mass, lf=car.lf, lr=car.lr, Izz=car.Izz),
        states={"vx": 30.0, "vy": 0.0, "yaw_rate": 0.0},
        outputs=list(DRIVE_NOISE),
        scales=[1.0] * len(DRIVE_NOISE),
        interpolation="hold",
        substeps=20,
        units=MOTION | BENT,
        name="blown",
    )
    inputs = [*columns.values(), *gusts]
    rows = [np.tile(column, len(DRIVE_NOISE)) for column in inputs]
    index = np.repeat(np.arange(len(DRIVE_NOISE), dtype=float), columns["t"].size)
    motion = model.predict(np.array([list(DRIVE_TRUTH.values())]), *rows, index)[0]
    return dict(zip(DRIVE_NOISE, np.split(motion, len(DRIVE_NOISE)), strict=True))


def _blown(
    vx: Any, vy: Any, yaw_rate: Any, ax: Any, steering: Any, along: Any, across: Any, twist: Any, *,
    B_f: Any, C_f: Any, D_f: Any, E_f: Any, Sh_f: Any, Sv_f: Any,
    B_r: Any, C_r: Any, D_r: Any, E_r: Any, Sh_r: Any, Sv_r: Any,
    mass: float, lf: float, lr: float, Izz: float,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """`planar_motion` with gusts."""
    dvx, dvy, dr = planar_motion(
        vx, vy, yaw_rate, ax, steering,
        B_f=B_f, C_f=C_f, D_f=D_f, E_f=E_f, Sh_f=Sh_f, Sv_f=Sv_f,
        B_r=B_r, C_r=C_r, D_r=D_r, E_r=E_r, Sh_r=Sh_r, Sv_r=Sv_r,
        mass=mass, lf=lf, lr=lr, Izz=Izz,
    )  # fmt: skip
    return dvx + along / mass, dvy + across / mass, dr + twist / Izz
