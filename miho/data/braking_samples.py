"""Samples of braking from a driving log: pressure, speed and deceleration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from miho.data.csv import TextFormat
from miho.data.dataset import Dataset
from miho.data.driving_log import DrivingLog, load_driving_log, low_pass
from miho.quantities import g

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
    """The braking phases of a log with vx, brake and throttle, for `BrakeDeceleration`.

    A sample is braking where the pressure is above min_pressure [Pa], the speed above min_speed
    [m/s] and the throttle at most max_throttle [-]. Deceleration is -ax or, if ax is not logged,
    -v_x' + v_y r (without vy or yaw_rate -v_x' alone), less what a logged grade explains. A logged
    ax may lag by a second or be a set value: compare it with the speed before you name it.

    Deceleration, pressure and squared speed pass the same `low_pass` of `cutoff` [Hz], so that a
    law linear in them stays true of what is filtered, as long as the filter sees nothing but
    braking. Near the ends of a phase it mixes in the drive, so that the first and last 1 / cutoff
    [s] of each phase are left out, and phases shorter than twice that altogether: a higher cutoff
    keeps more of short brakings and more noise. Left out are also the first `settle` [s] of each
    phase, if a pressure that is a command takes longer to build up, and, if yaw_rate is logged,
    samples with |v_x r| above max_lateral [m/s^2], where steered wheels drag.

    Columns p [Pa], vx [m/s], the output deceleration [m/s^2], positive, t [s] and event [-],
    which numbers the phases, also those of which nothing is kept: samples of one phase share its
    errors and are far from independent.
    """
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
    """`braking_samples` of a log in a CSV file.

    The other settings are those of `load_driving_log` and `braking_samples`.
    every: of the samples, the first of so many. delimiter to comment: `TextFormat`.
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
