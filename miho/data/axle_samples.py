"""Slip angle and lateral force of an axle, from a driving log (Fig. 4, right panel)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from miho.data.csv import TextFormat
from miho.data.dataset import Dataset
from miho.data.driving_log import DrivingLog, load_driving_log
from miho.models.single_track import SingleTrack
from miho.models.vehicle_settings import from_settings

UNITS = {"alpha": "rad", "vx": "m/s", "ax": "m/s^2", "Fy": "N"}


def axle_samples(
    log: DrivingLog,
    car: SingleTrack,
    axle: str = "front",
    cutoff: float = 5.0,
    min_speed: float = 10.0,
    max_ax: float | None = None,
) -> Dataset:
    """Slip angle alpha [rad] and lateral force Fy [N] of the 'front' or 'rear' axle, ISO-W.

    alpha comes from vx, vy, yaw_rate and steering; Fy from the balances of lateral force and yaw
    moment, with ay (if it is not logged, v_y' + v_x r) and the derivative of yaw_rate. All
    channels pass the same `low_pass` of `cutoff` [Hz], so that force and slip angle stay
    together. Dropped are samples below `min_speed` [m/s], the first and last 1 / cutoff [s], and,
    if `max_ax` [m/s^2] is given, those where the tires brake or drive more than that. The force is
    of both tires at the load they carried, aerodynamics and slip ratio included: vx and ax stay
    as conditions.

    vy must be measured. Integrated from ay - v_x r it drifts with every bias and bank, and what
    holds the drift, a filter or a tire model, would end up in the identified tire.
    """
    if axle not in ("front", "rear"):
        raise ValueError(f"axle is {axle!r}; expected 'front' or 'rear'")
    vx, vy, yaw_rate, steering = (
        log.filtered(channel, cutoff) for channel in ("vx", "vy", "yaw_rate", "steering")
    )
    ax = log.longitudinal_acceleration(cutoff)
    slip_angles = car.slip_angles(vx, vy, yaw_rate, steering)
    forces = car.axle_forces(
        log.lateral_acceleration(cutoff),
        log.rate("yaw_rate", cutoff),
        steering,
        log.angle("bank", cutoff),
    )
    kept = log.away_from_ends(cutoff) & (vx >= min_speed)
    if max_ax is not None:
        kept &= np.abs(ax) <= max_ax
    if not kept.any():
        raise ValueError(
            f"log {log.name}: no sample of {len(log)} is left; lower min_speed {min_speed:g} m/s "
            f"or raise max_ax {max_ax} m/s^2"
        )
    columns = {
        "alpha": getattr(slip_angles, axle), "vx": vx, "ax": ax, "Fy": getattr(forces, axle),
    }  # fmt: skip
    kept_columns = {key: values[kept] for key, values in columns.items()}
    return Dataset(f"{log.name}_{axle}_axle", kept_columns, UNITS, "Fy")


def load_axle_samples(
    path: str,
    columns: Sequence[str],
    units: Sequence[str],
    vehicle: Mapping[str, float],
    headers: Sequence[str] | None = None,
    flip: Sequence[str] = (),
    delays: Mapping[str, float] | None = None,
    steering_ratio: float = 1.0,
    sensor_x: float = 0.0,
    accelerometer: bool = True,
    start: float = 0.0,
    end: float | None = None,
    axle: str = "front",
    cutoff: float = 5.0,
    min_speed: float = 10.0,
    max_ax: float | None = None,
    every: int = 1,
    delimiter: str | None = None,
    decimal: str = ".",
    skip_rows: int = 0,
    drop_rows: Sequence[int] = (),
    comment: str | None = None,
) -> Dataset:
    """`axle_samples` of a log in a CSV file; `vehicle` names the fields of `SingleTrack`.

    The other settings are those of `load_driving_log` and `axle_samples`.
    every: of the samples, the first of so many. delimiter to comment: `TextFormat`.
    """
    car = from_settings(SingleTrack, vehicle)
    log = load_driving_log(
        path, columns, units, headers, flip=flip, delays=delays, steering_ratio=steering_ratio,
        sensor_x=sensor_x, accelerometer=accelerometer, start=start, end=end,
        text=TextFormat(delimiter, decimal, skip_rows, drop_rows, comment),
    )  # fmt: skip
    samples = axle_samples(log, car, axle, cutoff, min_speed, max_ax)
    return replace(samples.thinned(every), reading=log.reading)
