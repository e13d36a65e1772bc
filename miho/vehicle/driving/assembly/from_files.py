"""Assembly of a car from parameters files that were identified from drives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from miho.models import Identified, read_parameters
from miho.vehicle.data import dyno_test
from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE
from miho.vehicle.driving.assembly.engine import trusted_map
from miho.vehicle.driving.assembly.from_drives import (
    HIGH_OPENINGS,
    LOW_OPENINGS,
    MEAN_SPEED,
    part_of,
)
from miho.vehicle.driving.grip import Grip
from miho.vehicle.driving.known_car import KnownCar, straight_loads
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models import Axle, Brake, EngineMap, Pacejka, TorqueCubic, TorqueCurve
from miho.vehicle.models.brake_statics import BrakeDeceleration

BEYOND_THE_MAP = (1.0, 1.1)
"""Fade of curves with full weight up to full throttle."""


@dataclass(frozen=True)
class Wrong:
    """Factors on identified parameters [-], for drives with deliberately wrong parameters."""

    grip: float = 1.0  # of the forces of both axles
    stiffness: float = 1.0  # of B
    torque: float = 1.0  # of the engine map
    brake: float = 1.0  # of the gain of the brake


def known_from(
    folder: Path,
    vehicle: Vehicle,
    *,
    sensitivity: float,
    extended: bool = False,
    dyno: float = 1.0,
    seed: int = 0,
    wrong: Wrong | None = None,
) -> KnownCar:
    """Assemble a car from the parameters files of a folder.

    Loads of the axles are taken at the mean speed of the weave, without load transfer. Load
    transfer in the weave lowered the measured peaks, so a planner that subtracts it again is
    conservative.

    The files are from `identify_parts`. `sensitivity` is the load sensitivity of the peaks [-],
    which curves of an axle do not determine. If `extended`, learned curves also replace the dyno
    above 20 % throttle. `dyno` is the torque on the dyno relative to the torque in the car [-], and
    `seed` is of its noise. `wrong` are factors on the identified parameters.
    """
    off = Wrong() if wrong is None else wrong
    front, rear = (
        read_parameters(folder / f"{axle}_axle.json", Pacejka()) for axle in ("front", "rear")
    )
    axles = _axle(front, off), _axle(rear, off)
    loads = straight_loads(vehicle, front.derived[MEAN_SPEED].value)
    grip = Grip.of_axles(*axles, loads, sensitivity=sensitivity)
    engine = engine_from(folder, extended=extended, dyno=dyno, seed=seed)
    engine = replace(
        engine, table=off.torque * engine.table, correction=off.torque * engine.correction
    )
    brake = read_parameters(folder / "brake.json", BrakeDeceleration())
    return KnownCar(vehicle, *axles, loads, grip, engine, _brake(brake, vehicle, off))


def engine_from(
    folder: Path, *, extended: bool = False, dyno: float = 1.0, seed: int = 0
) -> EngineMap:
    """Return the integrated engine map of the learned curves in a folder.

    Parameters
    ----------
    folder, extended, dyno, seed
        As in `known_from`.

    Returns
    -------
    EngineMap
        The map of the dyno with the learned curves.
    """
    trusted = trusted_map(dyno_test(seed), dyno)
    openings = LOW_OPENINGS + (HIGH_OPENINGS if extended else ())
    curves = [
        _curve(read_parameters(folder / f"{part_of(opening)}.json", TorqueCubic()), opening)
        for opening in openings
    ]
    return trusted.integrate(curves, fade=BEYOND_THE_MAP) if extended else trusted.integrate(curves)


def _curve(part: Identified, opening: float) -> TorqueCurve:
    p0, p1, p2, p3 = part.theta.tolist()
    return TorqueCurve((p0, p1, p2, p3), TorqueCubic().omega_max, opening, part.ranges["omega"])


def _axle(part: Identified, off: Wrong) -> Axle:
    """Return two equal tires with half the force of the axle, because it has only one curve."""
    B, C, D, Sx, Sy = part.theta
    half = np.array([off.stiffness * B, C, off.grip * D / 2, Sx, off.grip * Sy / 2])
    return Axle(half, half)


def _brake(part: Identified, vehicle: Vehicle, off: Wrong) -> Brake:
    """Return the brake with the identified force over pressure.

    Braking in neutral also decelerates the inertia of the wheels. Both axles get the same torque
    per pressure, because drives determine only their sum. The pressure at which the pads touch
    follows from c_0 minus rolling resistance. Other numbers are from `EMBEDDED_BRAKE`.
    """
    c_p, _, c_0 = part.theta
    moved = vehicle.mass + vehicle.wheel_inertia / vehicle.wheel_radius**2
    rear = (1 - EMBEDDED_BRAKE.bias) / EMBEDDED_BRAKE.bias
    per_torque = 1 / vehicle.wheel_radius_front + rear / vehicle.wheel_radius
    K = off.brake * c_p * moved / per_torque
    contact = max((vehicle.C_r / moved - c_0) / c_p, 0.0)
    return replace(
        EMBEDDED_BRAKE, K_front=K, K_rear=K, P0_front=contact, P0_rear=contact * rear,
        radius_front=vehicle.wheel_radius_front, radius_rear=vehicle.wheel_radius,
    )  # fmt: skip
