"""Samples of braking from a driving log: pressure, speed and deceleration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from miho.data.csv import TextFormat
from miho.data.dataset import Dataset
from miho.quantities import g
from miho.vehicle.data.driving_log import DrivingLog, load_driving_log, low_pass

UNITS = {"p": "Pa", "vx": "m/s", "deceleration": "m/s^2", "t": "s", "event": "-"}


def braking_samples(
    log: DrivingLog,
    cutoff: float = 3.0,
    min_pressure: float = 1.0e5,
    min_speed: float = 10.0,
    max_throttle: float = 0.01,
    max_lateral: float = 3.0,
    settle: float = 0.0,
) -> Dataset:
    """Braking phases of a log, as data for `BrakeDeceleration`; see `load_braking_samples`."""
    if not settle >= 0:
        raise ValueError(f"settle is {settle}; expected a number of seconds of at least 0")
    grade = g * np.sin(log.angle("grade", cutoff))
    deceleration = -log.longitudinal_acceleration(cutoff) - grade
    t, pressure, vx = log["time"], log["brake"], log["vx"]
    braking = (pressure > min_pressure) & (vx > min_speed) & (log["throttle"] <= max_throttle)
    event = np.cumsum(braking & ~np.concatenate([[False], braking[:-1]]))
    start = t[np.searchsorted(event, event)]
    usable = log.inside(braking, cutoff) & (t - start >= settle)
    if "yaw_rate" in log:
        turning = np.abs(log.filtered("vx", cutoff) * log.filtered("yaw_rate", cutoff))
        usable &= turning <= max_lateral
    if not usable.any():
        raise ValueError(
            f"log {log.name}: no sample of {len(log)} has brake above {min_pressure:g} Pa, vx "
            f"above {min_speed:g} m/s, throttle of at most {max_throttle:g} for {1 / cutoff:g} s "
            f"before and after, settle {settle:g} s and |v_x r| of at most {max_lateral:g} m/s^2; "
            "check the units or widen the selection"
        )
    columns = {
        "p": log.filtered("brake", cutoff),
        "vx": np.sqrt(np.maximum(low_pass(vx * vx, log.dt, cutoff), 0.0)),
        "deceleration": deceleration,
        "t": t,
        "event": event.astype(float),
    }
    samples = {key: values[usable] for key, values in columns.items()}
    return Dataset(f"{log.name}_braking", samples, UNITS, "deceleration")


def load_braking_samples(
    path: str,
    columns: Sequence[str],
    units: Sequence[str],
    headers: Sequence[str] | None = None,
    flip: Sequence[str] = (),
    delays: Mapping[str, float] | None = None,
    accelerometer: bool = True,
    start: float = 0.0,
    end: float | None = None,
    cutoff: float = 3.0,
    min_pressure: float = 1.0e5,
    min_speed: float = 10.0,
    max_throttle: float = 0.01,
    max_lateral: float = 3.0,
    settle: float = 0.0,
    every: int = 1,
    delimiter: str | None = None,
    decimal: str = "point",
    skip_rows: int = 0,
    drop_rows: Sequence[int] = (),
    comment: str | None = None,
) -> Dataset:
    """Load the braking phases of a driving log in a CSV file, as data for `BrakeDeceleration`.

    Deceleration is -ax or, if ax is not logged, -v_x' + v_y r (-v_x' alone without vy or yaw_rate),
    minus the effect of a logged grade. Some loggers' ax lags by a second or is a commanded value:
    compare it with the speed before using it.

    Deceleration, pressure and squared speed pass the same `low_pass`, so that a law that is linear
    in them also holds for the filtered values, as long as the filter covers nothing but braking.
    Near the ends of a phase it also covers driving. A higher cutoff keeps more samples of short
    phases, and more noise.

    Parameters
    ----------
    path, columns, units, headers, flip, delays, accelerometer, start, end
        See `load_driving_log`.
    cutoff : float
        Cutoff of the low pass [Hz]. The first and last 1 / cutoff [s] of each braking phase are
        dropped, and shorter phases entirely.
    min_pressure : float
        Pressure above which the car is braking [Pa].
    min_speed : float
        Speed above which samples are used [m/s].
    max_throttle : float
        Largest throttle while braking [-].
    max_lateral : float
        Samples with larger |v_x r| are dropped [m/s^2] if yaw_rate is logged, because steered
        wheels drag.
    settle : float
        Time dropped at the beginning of each phase [s], for a commanded pressure that takes longer
        to build up.
    every : int
        Keep the first of every `every` samples.
    delimiter, decimal, skip_rows, drop_rows, comment
        See `miho.data.csv.TextFormat`.

    Returns
    -------
    Dataset
        Columns p [Pa], vx [m/s], the output deceleration [m/s^2] (positive), t [s] and event [-].
        `event` numbers the phases, including phases without samples: errors within one phase are
        far from independent.

    Raises
    ------
    CSVError
        For a fault in the file, including gaps and times that do not increase.
    ValueError
        For an invalid setting, or if no sample is left.
    """
    log = load_driving_log(
        path, columns, units, headers, flip=flip, delays=delays, accelerometer=accelerometer,
        start=start, end=end,
        text=TextFormat(delimiter, decimal, skip_rows, drop_rows, comment),
    )  # fmt: skip
    samples = braking_samples(
        log, cutoff, min_pressure, min_speed, max_throttle, max_lateral, settle
    )
    return replace(samples.thinned(every), reading=log.reading)
