"""The AV-21 with the embedded tires, engine and brake, for the tests of this folder."""

from __future__ import annotations

from functools import cache

from miho.data.synthetic_brake import EMBEDDED_BRAKE
from miho.driving.embedded import embedded_engine, embedded_tires
from miho.driving.known_car import KnownCar
from miho.driving.vehicle import Vehicle
from tests.driving.test_vehicle import av21


@cache
def car() -> KnownCar:
    """Known as it is."""
    return KnownCar.of_tires(
        Vehicle.from_settings(av21()), embedded_tires(), embedded_engine(), EMBEDDED_BRAKE
    )
