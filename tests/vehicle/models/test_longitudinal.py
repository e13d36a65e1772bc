"""Longitudinal dynamics: the paper's equations, inverses, energy, published equivalent masses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import g

from miho.vehicle.models import Longitudinal

CAR = Longitudinal(
    mass=800.0,
    wheel_radius=0.31,
    gear_ratios=(2.9167, 1.875, 1.3809, 1.1154, 0.96, 0.8889),
    final_drive=3.0,
    efficiency=0.9,
    engine_inertia=0.2,
    wheel_inertia=3.0,
    C_d=0.474,
    C_r=120.0,
)
PRINTED = replace(CAR, engine_inertia=0.0, wheel_inertia=0.0)


def test_equations_6_and_7_as_printed() -> None:
    """Without inertia and grade: m a = F - C_d v^2 - C_r and F = T eta i_g i_0 / R."""
    force = PRINTED.traction_force(3.0, 40.0, 2)
    assert force == pytest.approx(800 * 3.0 + 0.474 * 1600 + 120, rel=1e-15)
    torque = PRINTED.engine_torque(3.0, 40.0, 2)
    assert torque * 0.9 * 1.875 * 3.0 / 0.31 == pytest.approx(force, rel=1e-15)


def test_equivalent_masses_of_the_engine() -> None:
    """Published as 170/70/38/25/18/16 kg, to the kilogram, with a wheel radius of 0.30 m."""
    car = replace(CAR, wheel_inertia=0.0, wheel_radius=0.30)
    masses = car.equivalent_mass(np.arange(1, 7))
    assert np.round(masses).tolist() == [170, 70, 38, 25, 18, 16]
    wheels = CAR.equivalent_mass(1) - replace(CAR, wheel_inertia=0.0).equivalent_mass(1)
    assert wheels == pytest.approx(3.0 / 0.31**2, rel=1e-12)


@pytest.mark.parametrize("car", [CAR, PRINTED])
def test_acceleration_is_the_inverse_of_torque(car: Longitudinal) -> None:
    """Through driving and coasting, so that both directions of power flow are met."""
    ax = np.linspace(-3.0, 6.0, 46)[:, None, None]
    vx = np.array([10.0, 35.0, 70.0])[:, None]
    gear = np.arange(1, 7)
    torque = car.engine_torque(ax, vx, gear, 0.05)
    assert torque.shape == (46, 3, 6)
    assert (torque.min() < -50) and (torque.max() > 300)
    back = car.acceleration(torque, vx, gear, 0.05)
    np.testing.assert_allclose(back, np.broadcast_to(ax, back.shape), atol=1e-12)
    assert (np.diff(torque, axis=0) > 0).all()


def test_power_is_accounted_for() -> None:
    """What the engine gives is what moves, turns, climbs, drags, and the loss in the gears."""
    gear, vx, grade = 3, 30.0, 0.08
    for ax in (2.0, -1.9):
        torque = float(CAR.engine_torque(ax, vx, gear, grade))
        speed = float(CAR.engine_speed(vx, gear))
        into_gears = torque * speed - 0.2 * speed * float(CAR.engine_speed(ax, gear))
        moving = 800 * ax * vx + 3.0 * (vx / 0.31) * (ax / 0.31)
        resistance = (0.474 * vx**2 + 120 + 800 * g * np.sin(grade)) * vx
        out_of_gears = moving + resistance
        loss = into_gears - out_of_gears
        larger = max(abs(into_gears), abs(out_of_gears))
        assert loss == pytest.approx(0.1 * larger, rel=1e-9), "a tenth of what flows in"
        assert np.sign(into_gears) == np.sign(ax)


def test_traction_force_is_what_the_whole_torque_gives() -> None:
    force, torque = CAR.traction_force(2.0, 30.0, 1), CAR.engine_torque(2.0, 30.0, 1)
    assert force == pytest.approx(0.9 * torque * 8.7501 / 0.31, rel=1e-12)
    rotating = CAR.equivalent_mass(1) - 3.0 / 0.31**2
    road = (800 + 3.0 / 0.31**2) * 2.0 + 0.474 * 900 + 120
    assert force == pytest.approx(road + 0.9 * rotating * 2.0, rel=1e-12)


def test_coasting_down_a_slope_holds_its_speed_without_torque() -> None:
    grade = -np.arcsin((0.474 * 400 + 120) / (800 * g))
    assert CAR.engine_torque(0.0, 20.0, 4, grade) == pytest.approx(0, abs=1e-10)
    assert CAR.acceleration(0.0, 20.0, 4, grade) == pytest.approx(0, abs=1e-13)


def test_engine_speed() -> None:
    """Fourth gear at 60 m/s: 60 / 0.31 * 1.1154 * 3 rad/s, which is 6185 1/min."""
    assert CAR.engine_speed(60.0, 4) * 60 / (2 * np.pi) == pytest.approx(6184.7, abs=0.1)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("mass", 0.0, "mass is 0.0; expected a positive number"),
        ("wheel_radius", np.nan, "wheel_radius is nan"),
        ("final_drive", np.inf, "final_drive is inf"),
        ("efficiency", 1.1, "efficiency is 1.1; expected a number above 0 and at most 1"),
        ("efficiency", 0.0, "efficiency is 0.0"),
        ("engine_inertia", -0.1, "engine_inertia is -0.1; expected a number of at least 0"),
        ("wheel_inertia", np.nan, "wheel_inertia is nan"),
        ("C_d", -1.0, "C_d is -1.0"),
        ("C_r", -1.0, "C_r is -1.0"),
        ("gear_ratios", (), "a positive ratio for each gear"),
        ("gear_ratios", (2.0, -1.0), "a positive ratio for each gear"),
    ],
)
def test_impossible_cars(field: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(CAR, **{field: value})


@pytest.mark.parametrize("gear", [0, 7, 1.5, [1, 2, -1], np.nan])
def test_gears_that_do_not_exist(gear: object) -> None:
    with pytest.raises(ValueError, match="does not exist; expected 1 to 6"):
        CAR.engine_speed(10.0, gear)
