"""The compiled inverse against the models it repeats."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miho.vehicle.driving.compiling import record_of
from miho.vehicle.driving.powertrain import engine_of
from miho.vehicle.driving.speed_control import effort
from tests.vehicle.driving.cars import car

CAR = car()
MODEL = engine_of(CAR.vehicle, CAR.engine), np.array([record_of(vars(CAR.vehicle))])
DRIVE = CAR.vehicle.longitudinal


@settings(max_examples=60, deadline=None)
@given(vx=st.floats(5.0, 80.0), ax=st.floats(-12.0, 6.0), gear=st.integers(1, 6))
def test_it_is_the_inverse_of_both_models(vx: float, ax: float, gear: int) -> None:
    inverse = effort(*MODEL, ax, vx, gear)
    assert inverse.torque == pytest.approx(float(DRIVE.engine_torque(ax, vx, gear)), rel=1e-12)
    omega = max(float(DRIVE.engine_speed(vx, gear)), CAR.vehicle.idle_speed)
    assert inverse.throttle == pytest.approx(
        float(CAR.engine.throttle(omega, inverse.torque).opening), abs=1e-9
    )


@settings(max_examples=40, deadline=None)
@given(vx=st.floats(5.0, 80.0), gear=st.integers(1, 6))
def test_what_coasts_needs_no_brake(vx: float, gear: int) -> None:
    """And braking with the force it names gives the acceleration: F = m a at the wheels."""
    omega = max(float(DRIVE.engine_speed(vx, gear)), CAR.vehicle.idle_speed)
    closed = float(CAR.engine.torque(omega, 0.0))
    coasting = float(DRIVE.acceleration(closed, vx, gear))
    assert effort(*MODEL, coasting, vx, gear).brake == pytest.approx(0.0, abs=1e-6)
    assert effort(*MODEL, coasting + 0.1, vx, gear).brake < 0
    mass = CAR.vehicle.mass + float(DRIVE.equivalent_mass(gear))
    braked = effort(*MODEL, coasting - 1.0, vx, gear).brake
    # The engine's inertia acts through the gears' loss: up to 1 / 0.9 of it.
    assert mass * 0.98 <= braked <= mass * 1.12
