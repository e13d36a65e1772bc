"""Slip angle and lateral force of an axle from a driving log (Fig. 4, right panel)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from miho.data.conventions import sign_problem
from miho.data.csv import TextFormat
from miho.data.dataset import Dataset
from miho.quantities import Array, g
from miho.vehicle.data.driving_log import DrivingLog, load_driving_log
from miho.vehicle.models.single_track import SingleTrack
from miho.vehicle.models.vehicle_settings import from_settings

LARGEST_SLIP_ANGLE = 1.0
"""Largest slip angle of an axle [rad]; larger values mean that the car spins or a unit is wrong."""
RISING = 0.2
"""Rank correlation of force and slip angle above which one of their signs must be wrong."""
BOTH_WAYS = 0.1
"""Smallest share of samples with a force to either side in a log that turns both ways."""
LEVEL = 0.1
"""Root mean square effect of the bank on the lateral acceleration [m/s^2] below which it is not
checked."""
INWARD = 0.5
"""Smallest cosine between the accelerations of bank and turning for a bank that leans one way."""
TURNING = 1.0
"""Smallest lateral acceleration in a turn [m/s^2]."""
CROSSFALL = 1.0
"""Largest effect of a crossfall for drainage [m/s^2]: a bank of six degrees."""

UNITS = {"alpha": "rad", "vx": "m/s", "ax": "m/s^2", "Fy": "N", "time": "s"}


def axle_samples(
    log: DrivingLog,
    car: SingleTrack,
    axle: str = "front",
    cutoff: float = 5.0,
    min_speed: float = 10.0,
    max_ax: float | None = None,
    timed: bool = False,
) -> Dataset:
    """Slip angle and lateral force of an axle of a log, perhaps timed; see `load_axle_samples`."""
    if axle not in ("front", "rear"):
        raise ValueError(f"axle is {axle!r}; expected 'front' or 'rear'")
    # Slip angles and forces of both axles, from equally filtered channels.
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
    # Select the usable samples.
    usable = log.away_from_ends(cutoff) & (vx >= min_speed)
    if max_ax is not None:
        usable &= np.abs(ax) <= max_ax
    if not usable.any():
        raise ValueError(
            f"log {log.name}: no sample of {len(log)} is left; lower min_speed {min_speed:g} m/s "
            f"or raise max_ax {max_ax} m/s^2"
        )
    # Refuse signs and units that must be wrong.
    _check_bank(log, cutoff)
    columns = {
        "alpha": getattr(slip_angles, axle), "vx": vx, "ax": ax, "Fy": getattr(forces, axle),
    }  # fmt: skip
    if timed:
        columns["time"] = log["time"]
    samples = {key: values[usable] for key, values in columns.items()}
    largest = float(np.abs(samples["alpha"]).max())
    if largest > LARGEST_SLIP_ANGLE:
        raise ValueError(
            f"log {log.name}: the {axle} axle's slip angle reaches {largest:.3g} rad, expected at "
            f"most {LARGEST_SLIP_ANGLE:g}; check the units of vy, yaw_rate and steering, or "
            "exclude a spin with start and end"
        )
    if _rises(samples):
        raise ValueError(
            f"log {log.name}: the {axle} axle's force rises with its slip angle, but it falls in "
            "ISO signs; flip the column with the wrong sign (vy and ay are positive to the left, "
            "yaw_rate and steering in a left turn), or correct sensor_x, delays or steering_ratio"
        )
    units = {key: UNITS[key] for key in samples}
    return Dataset(f"{log.name}_{axle}_axle", samples, units, "Fy")


def _rises(samples: Mapping[str, Array]) -> bool:
    """Return whether the force rises with the slip angle, which means that a sign is wrong.

    In a log that turns both ways, an offset of the slip angle (for example of a sensor) is ignored.
    """
    alpha, Fy = samples["alpha"], samples["Fy"]
    if min(np.mean(Fy > 0), np.mean(Fy < 0)) >= BOTH_WAYS:
        alpha, Fy = alpha - np.median(alpha), Fy - np.median(Fy)
    return sign_problem({**samples, "alpha": alpha, "Fy": Fy}, UNITS, RISING) is not None


def _check_bank(log: DrivingLog, cutoff: float) -> None:
    """Refuse a bank with the wrong sign, and warn if the log cannot show its sign.

    With an accelerometer, the sign is wrong if the opposite sign explains its readings clearly
    better. Without one, turns decide: roads lean inwards in turns, except for a small crossfall.
    """
    if "bank" not in log:
        return
    turning = log.filtered("vx", cutoff) * log.filtered("yaw_rate", cutoff)
    weight = g * np.sin(log.angle("bank", cutoff))
    remedy = (
        "bank is positive if the left side is lower, opposite to a roll angle of ISO 8855: "
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
                f"against {error_as_is:.2g} m/s^2 unexplained); {remedy}"
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
            f"log {log.name}: the bank leans outwards in turns, but roads lean inwards; "
            f"{remedy}, or give ay of an accelerometer, which shows the sign"
        )
    if inward < INWARD:
        warnings.warn(
            f"log {log.name}: the sign of bank, on which the forces depend, cannot be checked: "
            "bank is positive if the left side is lower; give ay of an accelerometer to check it",
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
    """Load slip angle and lateral force of an axle from a driving log, in ISO-W signs.

    The slip angle follows from vx, vy, yaw_rate and steering. The force follows from the balances
    of lateral force and yaw moment, with ay (v_y' + v_x r if it is not logged) and the derivative
    of yaw_rate. All channels pass the same `low_pass`, so that force and slip angle stay in phase.
    The force is the sum of both tires at their actual loads and includes aerodynamics and slip
    ratio, so vx and ax are kept as conditions.

    vy must be measured. If it is integrated from ay - v_x r, it drifts with every bias and bank,
    and the filter or tire model that limits the drift would distort the identified tire.

    Parameters
    ----------
    path, columns, units
        See `load_driving_log`.
    vehicle : mapping of str to float
        Fields of `SingleTrack`.
    headers, flip, delays, steering_ratio, sensor_x, accelerometer, start, end
        See `load_driving_log`.
    axle : {'front', 'rear'}
        The axle.
    cutoff : float
        Cutoff of the low pass [Hz]. The first and last 1 / cutoff [s] are dropped.
    min_speed : float
        Samples with vx below this are dropped [m/s].
    max_ax : float, optional
        Samples with a larger magnitude of ax are dropped [m/s^2].
    every : int
        Keep the first of every `every` samples.
    delimiter, decimal, skip_rows, drop_rows, comment
        See `miho.data.csv.TextFormat`.

    Returns
    -------
    Dataset
        Columns alpha [rad], vx [m/s], ax [m/s^2], time [s] and the output Fy [N].

    Raises
    ------
    CSVError
        For a fault in the file, including gaps and times that do not increase.
    ValueError
        For an invalid setting, if no sample is left, or if a sign or a unit must be wrong.
    """
    car = from_settings(SingleTrack, vehicle)
    log = load_driving_log(
        path, columns, units, headers, flip=flip, delays=delays, steering_ratio=steering_ratio,
        sensor_x=sensor_x, accelerometer=accelerometer, start=start, end=end,
        text=TextFormat(delimiter, decimal, skip_rows, drop_rows, comment),
    )  # fmt: skip
    samples = axle_samples(log, car, axle, cutoff, min_speed, max_ax, timed=True)
    return replace(samples.thinned(every), reading=log.reading)
