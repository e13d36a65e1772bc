"""Slip angle and lateral force of an axle, from a driving log (Fig. 4, right panel)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from miho.data.conventions import sign_problem
from miho.data.csv import TextFormat
from miho.data.dataset import Dataset
from miho.data.driving_log import DrivingLog, load_driving_log
from miho.models.single_track import SingleTrack
from miho.models.vehicle_settings import from_settings
from miho.quantities import Array, g

LARGEST_SLIP_ANGLE = 1.0
"""Largest slip angle of an axle [rad]; beyond, a car spins or a unit is wrong."""
RISING = 0.2
"""Rank correlation of force and slip angle above which their signs cannot both be right."""
BOTH_WAYS = 0.1
"""Share of the samples with a force to either side from which on a log turns both ways."""
LEVEL = 0.1
"""A bank that moves the lateral acceleration by less [m/s^2], root mean square, is not checked."""
INWARD = 0.5
"""Cosine between the accelerations of bank and turning from which on a bank leans one way."""
TURNING = 1.0
"""A lateral acceleration [m/s^2] from which on the car turns."""
CROSSFALL = 1.0
"""What a bank for drainage accelerates at most [m/s^2]: one of six degrees."""

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
    # Slip angles and forces of both axles, from channels filtered alike.
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
    # The samples that count.
    usable = log.away_from_ends(cutoff) & (vx >= min_speed)
    if max_ax is not None:
        usable &= np.abs(ax) <= max_ax
    if not usable.any():
        raise ValueError(
            f"log {log.name}: no sample of {len(log)} is left; lower min_speed {min_speed:g} m/s "
            f"or raise max_ax {max_ax} m/s^2"
        )
    # Signs and units that cannot be right are refused.
    _check_bank(log, cutoff)
    columns = {
        "alpha": getattr(slip_angles, axle), "vx": vx, "ax": ax, "Fy": getattr(forces, axle),
    }  # fmt: skip
    samples = {key: values[usable] for key, values in columns.items()}
    largest = float(np.abs(samples["alpha"]).max())
    if largest > LARGEST_SLIP_ANGLE:
        raise ValueError(
            f"log {log.name}: the {axle} axle's slip angle reaches {largest:.3g} rad, expected at "
            f"most {LARGEST_SLIP_ANGLE:g}; check the units of vy, yaw_rate and steering, or leave "
            "out where the car spins with start and end"
        )
    if _rises(samples):
        raise ValueError(
            f"log {log.name}: the {axle} axle's force rises with its slip angle, but it falls in "
            "ISO signs; flip the column whose sign is not ISO's (vy and ay positive to the left, "
            "yaw_rate and steering in a left turn), or correct sensor_x, delays or steering_ratio"
        )
    return Dataset(f"{log.name}_{axle}_axle", samples, UNITS, "Fy")


def _rises(samples: Mapping[str, Array]) -> bool:
    """Whether the force rises with the slip angle, as it does in wrong signs.

    In a log that turns both ways an offset of the slip angle, as of a sensor, does not count.
    """
    alpha, Fy = samples["alpha"], samples["Fy"]
    if min(np.mean(Fy > 0), np.mean(Fy < 0)) >= BOTH_WAYS:
        alpha, Fy = alpha - np.median(alpha), Fy - np.median(Fy)
    return sign_problem({**samples, "alpha": alpha, "Fy": Fy}, UNITS, RISING) is not None


def _check_bank(log: DrivingLog, cutoff: float) -> None:
    """Refuse a bank of the other sign, and warn where nothing in the log tells the sign.

    With an accelerometer, the sign is wrong if the opposite one explains its readings clearly
    better. Without one, turns decide: roads lean inwards there, except for a small crossfall.
    """
    if "bank" not in log:
        return
    turning = log.filtered("vx", cutoff) * log.filtered("yaw_rate", cutoff)
    weight = g * np.sin(log.angle("bank", cutoff))
    remedy = (
        "it is positive where the left side is lower, which a roll angle of ISO 8855 is not: "
        "set flip=[bank]"
    )
    if log.accelerometer and "ay" in log:
        residual = log.filtered("ay", cutoff) - log.rate("vy", cutoff) - turning
        error_as_is, error_reversed = (
            float(np.sqrt(np.mean((residual + sign * weight) ** 2))) for sign in (1.0, -1.0)
        )
        if error_reversed < 0.5 * error_as_is:
            raise ValueError(
                f"log {log.name}: ay, vy and yaw_rate fit the opposite bank ({error_reversed:.2g} "
                f"against {error_as_is:.2g} m/s^2 left over); {remedy}"
            )
        return
    size = float(np.linalg.norm(weight))
    if size <= LEVEL * np.sqrt(len(log)):
        return
    inward = float(weight @ turning) / (size * float(np.linalg.norm(turning)) or 1.0)
    in_turns = weight[np.abs(turning) > TURNING]
    steep = bool(in_turns.size) and float(np.sqrt(np.mean(in_turns**2))) > CROSSFALL
    if inward < -INWARD and steep:
        raise ValueError(
            f"log {log.name}: the bank leans outwards in the turns, where roads lean inwards; "
            f"{remedy}, or give ay of an accelerometer, which tells the sign"
        )
    if inward < INWARD:
        warnings.warn(
            f"log {log.name}: nothing tells whether bank has the right sign, on which the forces "
            "depend: it is positive where the left side is lower; with ay of an accelerometer it "
            "is checked",
            UserWarning,
            stacklevel=3,
        )


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
    decimal: str = "point",
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
