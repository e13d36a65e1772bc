"""The car of what was identified of its tires, engine and brake, each on a bench of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from miho.data.synthetic_brake import EMBEDDED_BRAKE
from miho.data.tir_sampling import EMBEDDED_RANGES
from miho.driving.assembly.engine import DATASETS, engine_of
from miho.driving.grip import Grip
from miho.driving.known_car import KnownCar
from miho.driving.vehicle import Vehicle
from miho.identification import CurveFit
from miho.models import Axle, Brake, EngineMap

Array = NDArray[np.float64]

TIRES = ("lf", "rf", "lr", "rr")


def assembled(
    vehicle: Vehicle,
    problems: Mapping[str, CurveFit],
    thetas: Mapping[str, Array],
    sensitivity: float,
) -> KnownCar:
    """The car that identified parameters of all its parts make.

    The tires' curves are those of the middle of the loads they were sampled at. sensitivity: of
    their peaks to the load [-], which is in none of the curves.
    """
    front, rear = Axle(thetas["lf"], thetas["rf"]), Axle(thetas["lr"], thetas["rr"])
    loads = np.array([np.mean(EMBEDDED_RANGES[tire].Fz) for tire in TIRES])
    grip = Grip.of_axles(front, rear, loads, sensitivity=sensitivity)
    return KnownCar(
        vehicle, front, rear, loads, grip, _engine(problems, thetas), _brake(problems, thetas)
    )


def _engine(problems: Mapping[str, CurveFit], thetas: Mapping[str, Array]) -> EngineMap:
    learned = {throttle: problems[name] for throttle, name in DATASETS.items()}
    return engine_of(learned, {t: thetas[name] for t, name in DATASETS.items()}).integrated


def _brake(problems: Mapping[str, CurveFit], thetas: Mapping[str, Array]) -> Brake:
    """Radii are the car's own; the bias is the slope of the rear over the front pressure."""
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
