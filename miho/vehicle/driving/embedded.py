"""The true car of a simulation; its controllers use identified models instead."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE
from miho.vehicle.data.synthetic_engine import true_torque
from miho.vehicle.data.tir_sampling import embedded_tire
from miho.vehicle.driving.compiled_tire import Tires
from miho.vehicle.driving.double_track import DoubleTrack
from miho.vehicle.driving.road import PLANE, Road
from miho.vehicle.driving.vehicle import Vehicle
from miho.vehicle.models import EngineMap, load_tir
from miho.vehicle.models.engine import RPM
from miho.vehicle.models.magic_formula import MagicFormula


def embedded_plant(vehicle: Vehicle, road: Road = PLANE, step: float = 1e-3) -> DoubleTrack:
    """Return a plant with the embedded tires, engine and brake, the origin of the datasets.

    Parameters
    ----------
    vehicle : Vehicle
        The car.
    road : Road, optional
        The road, by default a plane.
    step : float, optional
        Integration step [s].

    Returns
    -------
    DoubleTrack
        The plant.
    """
    return DoubleTrack(vehicle, embedded_tires(), embedded_engine(), EMBEDDED_BRAKE, road, step)


@cache
def embedded_tires() -> Tires:
    """Return the four oval tires: front left, front right, rear left, rear right."""
    lf, rf, lr, rr = (_tire(name) for name in ("lf", "rf", "lr", "rr"))
    return lf, rf, lr, rr


def _tire(name: str) -> MagicFormula:
    return replace(load_tir(embedded_tire(name)), fade_at_standstill=True)


@cache
def embedded_engine() -> EngineMap:
    """Return the map of the embedded engine, every 50 rpm and 2.5 % throttle, without noise."""
    throttle, omega = np.meshgrid(
        np.linspace(0, 1, 41), np.arange(1000, 7001, 50) * RPM, indexing="ij"
    )
    torque = true_torque(omega, throttle)
    return EngineMap.from_points(throttle.ravel(), omega.ravel(), torque.ravel())
