"""Assembly of a car from tires, engine and brake that were identified on separate benches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from miho.data import Dataset
from miho.identification import CurveFit
from miho.quantities import Array
from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE
from miho.vehicle.driving.assembly.engine import DATASETS, engine_of
from miho.vehicle.driving.grip import Grip
from miho.vehicle.driving.known_car import KnownCar
from miho.vehicle.driving.loaded_axle import LoadedAxle
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models import Axle, Brake, LoadSensitivity, load_sensitivity

TIRES = ("lf", "rf", "lr", "rr")


def assembled(
    vehicle: Vehicle,
    problems: Mapping[str, CurveFit],
    thetas: Mapping[str, Array],
    sensitivity: float | None = None,
) -> KnownCar:
    """Assemble a car from problems of tires, engine and brake, and identified parameters, by part.

    Curves of the tires follow from `loaded_axle`. The load sensitivity [-] of peak and stiffness is
    one number for all tires, or estimated from the data.
    """
    front, rear = (
        loaded_axle([problems[tire].dataset for tire in pair], [thetas[tire] for tire in pair])
        for pair in (TIRES[:2], TIRES[2:])
    )
    loads = np.concatenate([front.loads, rear.loads])
    peak, stiffness = np.concatenate([front.sensitivity, rear.sensitivity], axis=1)
    if sensitivity is not None:
        peak = stiffness = np.full(4, sensitivity)
    grip = Grip.of_axles(front.axle, rear.axle, loads, sensitivity=peak)
    learned = {throttle: problems[name] for throttle, name in DATASETS.items()}
    parameters = {throttle: thetas[name] for throttle, name in DATASETS.items()}
    engine, brake = engine_of(learned, parameters).integrated, _brake(problems, thetas)
    return KnownCar(vehicle, front.axle, rear.axle, loads, grip, engine, brake, stiffness)


def loaded_axle(data: Sequence[Dataset], thetas: Sequence[Array]) -> LoadedAxle:
    """Return an axle with the identified curves of its left and right tire.

    The data are from `sample_tir`. Each curve has the middle load of its data, and the data
    determine its load sensitivity. Positive estimates, which noise can cause, are replaced by 0.
    """
    loads = np.array([(rows["Fz"].min() + rows["Fz"].max()) / 2 for rows in data])
    learned = [
        load_sensitivity(theta, rows["alpha"], rows["Fz"], rows["Fy"], load)
        for rows, theta, load in zip(data, thetas, loads, strict=True)
    ]
    peak, stiffness = np.minimum(np.array(learned, dtype=float).T, 0.0)
    return LoadedAxle(Axle(*thetas), loads, LoadSensitivity(peak, stiffness))


def _brake(problems: Mapping[str, CurveFit], thetas: Mapping[str, Array]) -> Brake:
    """Return the brake with radii of the embedded brake, and the bias from the pressure ratio."""
    test = problems["brake_pressure"].dataset
    slope = float(test["p_rear"] @ test["p"] / (test["p"] @ test["p"]))
    u0, u1, P_max, n = thetas["brake_pressure"].tolist()
    K_front, P0_front = thetas["brake_torque_front"].tolist()
    K_rear, P0_rear = thetas["brake_torque_rear"].tolist()
    delay, tau_rise, tau_fall = thetas["brake_step"].tolist()
    return replace(
        EMBEDDED_BRAKE,
        u0=u0, u1=u1, P_max=P_max, n=n, bias=1 / (1 + slope), K_front=K_front, P0_front=P0_front,
        K_rear=K_rear, P0_rear=P0_rear, delay=delay, tau_rise=tau_rise, tau_fall=tau_fall,
    )  # fmt: skip
