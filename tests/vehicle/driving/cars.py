"""The AV-21 with the embedded tires, engine and brake, for the tests of this folder."""

from __future__ import annotations

from functools import cache

from miho.vehicle.data.synthetic_brake import EMBEDDED_BRAKE
from miho.vehicle.driving.embedded import embedded_engine, embedded_tires
from miho.vehicle.driving.known_car import KnownCar
from miho.vehicle.driving.vehicle import Vehicle
from tests.vehicle.driving.test_vehicle import av21


@cache
def car() -> KnownCar:
    """Known as it is."""
    return KnownCar.of_tires(
        Vehicle.from_settings(av21()), embedded_tires(), embedded_engine(), EMBEDDED_BRAKE
    )
