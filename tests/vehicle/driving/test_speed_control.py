"""The low-level controller: force to pedals and back, gears, dead band and dwell."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miho.vehicle.driving.speed_control import SpeedController, SpeedSettings, SpeedState
from tests.vehicle.driving.cars import car

CAR = car()
STILL = SpeedSettings(integral=0.0, dead_band=0.0, dwell=0.0)
CONTROL = CAR.speed_controller(STILL)
DRIVE = CAR.vehicle.longitudinal


def achieved(
    control: SpeedController, throttle: float, brake: float, gear: int, vx: float
) -> float:
    """Acceleration that the pedals give, by the forward models, at rest of all lags [m/s^2]."""
    torque = float(control.engine.torque(float(DRIVE.engine_speed(vx, gear)), throttle))
    force = float(control.brake.force_of_pressure(brake))
    # A brake force slows the car like a rolling resistance.
    braked = replace(DRIVE, C_r=DRIVE.C_r + force)
    return float(braked.acceleration(torque, vx, gear))


@settings(max_examples=40, deadline=None)
@given(vx=st.floats(15.0, 65.0), ax=st.floats(-9.0, 2.0))
def test_the_pedals_give_the_acceleration_that_was_asked_for(vx: float, ax: float) -> None:
    """The round trip through both inverses, wherever engine and brake can do it at all."""
    state = CONTROL.start(vx)
    pedals, _ = CONTROL.command(state, vx, ax, vx, 0.01)
    acceleration = achieved(CONTROL, pedals.throttle, pedals.brake, pedals.gear, vx)
    if pedals.throttle < 1:
        assert acceleration == pytest.approx(ax, abs=2e-3)
    else:
        assert acceleration < ax + 1e-9
    assert pedals.throttle == 0 or pedals.brake == 0


def test_the_gear_follows_the_engine_speed_without_hunting() -> None:
    rules = CONTROL.settings
    state, gears = CONTROL.start(10.0), []
    up = [10 + 0.05 * k for k in range(1200)]
    for vx in [*up, *reversed(up)]:
        pedals, state = CONTROL.command(state, vx, 0.0, vx, 0.05)
        gears.append(pedals.gear)
    changes = [b - a for a, b in pairwise(gears) if a != b]
    assert set(changes) == {1, -1}
    assert changes == sorted(changes, reverse=True), "only up, then only down"
    assert max(gears) >= 4
    speeds = [float(DRIVE.engine_speed(v, n)) for v, n in zip(up, gears, strict=False)]
    assert max(speeds) < 1.02 * rules.shift_up


def test_a_dead_band_and_a_dwell_keep_the_pedals_from_chattering() -> None:
    """A demand that crosses the closed throttle's force by 100 N, a hundred times a second."""
    calm = CAR.speed_controller(SpeedSettings(integral=0.0, dead_band=150.0, dwell=0.2))
    vx = 40.0
    gear = CONTROL.start(vx).gear
    closed = float(calm.engine.torque(float(DRIVE.engine_speed(vx, gear)), 0.0))
    coasting = float(DRIVE.acceleration(closed, vx, gear))

    def changes(control: SpeedController, swing: float) -> int:
        state, count = control.start(vx), 0
        for k in range(400):
            before = state.braking
            desired = coasting + (-1) ** k * swing / CAR.vehicle.mass
            _, state = control.command(state, vx, desired, vx, 0.01)
            count += before != state.braking
        return count

    assert changes(CONTROL, 100.0) > 300
    assert changes(calm, 100.0) == 0
    assert 0 < changes(calm, 1000.0) <= 20, "four seconds hold at most twenty dwells of 0.2 s"


def test_the_integral_ends_an_error_and_does_not_wind_up() -> None:
    control = CAR.speed_controller(SpeedSettings(integral=0.5))
    state = control.start(30.0)
    for _ in range(2000):
        _, state = control.command(state, 80.0, 0.0, 30.0, 0.01)
    assert abs(state.integral) < 0.05, "full throttle: nothing left to integrate for"
    for _ in range(2000):
        _, state = control.command(state, 30.1, 0.0, 30.0, 0.01)
    assert state.integral == pytest.approx(1.0), "integral_max"


def test_at_rest_there_is_a_command() -> None:
    pedals, _ = CONTROL.command(CONTROL.start(0.0), 5.0, 0.0, 0.0, 0.01)
    assert pedals.gear == 1
    assert 0 < pedals.throttle <= 1
    pedals, _ = CONTROL.command(SpeedState(), 0.0, -3.0, 0.0, 0.01)
    assert pedals.brake > 0


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ValueError, match=r"feedback is -1; expected a number of at least 0"):
        SpeedSettings(feedback=-1)
    with pytest.raises(ValueError, match="dwell is nan"):
        replace(STILL, dwell=math.nan)
    with pytest.raises(ValueError, match="shift_down is 700 rad/s; expected below shift_up"):
        SpeedSettings(shift_down=700.0)
