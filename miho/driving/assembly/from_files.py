"""What parameters.json files, identified from drives, make known of a car."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from miho.data import dyno_test
from miho.data.synthetic_brake import EMBEDDED_BRAKE
from miho.data.synthetic_engine import DYNO_TRUSTED
from miho.driving.assembly.from_drives import HIGH_OPENINGS, LOW_OPENINGS, part_of
from miho.driving.grip import Grip
from miho.driving.known_car import KnownCar
from miho.driving.load_transfer import LoadTransfer
from miho.driving.vehicle import Vehicle
from miho.identification.parameters_file import MEAN_SPEED
from miho.models import Axle, Brake, EngineMap, Pacejka, TorqueCubic, TorqueCurve, read_parameters
from miho.models.brake_statics import BrakeDeceleration
from miho.models.identified import Identified

BEYOND_THE_MAP = (1.0, 1.1)
"""The fade of curves that count fully up to full throttle."""


@dataclass(frozen=True)
class Wrong:
    """Factors on what was identified, to drive on parameters that are poor on purpose [-].

    grip: of both axles' forces. stiffness: B. torque: of the engine map. brake: of its gain.
    """

    grip: float = 1.0
    stiffness: float = 1.0
    torque: float = 1.0
    brake: float = 1.0


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
    """What the parameters files of a folder make known of a car.

    sensitivity: of the peaks to the load [-], which curves of an axle do not hold. extended: the
    learned curves replace the dyno above 20 % throttle too. dyno: what it shows over what the
    engine gives in the car [-], from 30 % on; seed: of its noise.

    The loads are those of the axles at the mean speed of the weave, without its load transfer,
    which has lowered the peaks that were measured: a planner that takes it off again is cautious.
    """
    off = Wrong() if wrong is None else wrong
    front, rear = (
        read_parameters(folder / f"{axle}_axle.json", Pacejka()) for axle in ("front", "rear")
    )
    axles = _axle(front, off), _axle(rear, off)
    at = LoadTransfer(vehicle).wheel_loads(front.derived[MEAN_SPEED].value)
    loads = np.array([float(load) for load in at])
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
    """The integrated map of the learned curves in a folder; settings as in `known_from`."""
    test = dyno_test(seed)
    throttle, high = test["throttle"], test["throttle"] >= DYNO_TRUSTED
    trusted_rows = (throttle == 0) | high
    torque = test["torque"] * np.where(high, dyno, 1.0)
    trusted = EngineMap.from_points(
        throttle[trusted_rows], test["omega"][trusted_rows], torque[trusted_rows]
    )
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
    """Two tires that share the force of the axle evenly: one curve cannot tell them apart."""
    B, C, D, Sx, Sy = part.theta
    half = np.array([off.stiffness * B, C, off.grip * D / 2, Sx, off.grip * Sy / 2])
    return Axle(half, half)


def _brake(part: Identified, vehicle: Vehicle, off: Wrong) -> Brake:
    """The brake whose force over the pressure is the identified one.

    Braking in neutral, the wheels' inertia is slowed as well. The axles' torques over their
    pressures are taken to be equal, as driving shows only their sum; the pads touch at the
    pressure that c_0, less rolling resistance, says. Bench data are those of `EMBEDDED_BRAKE`.
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
