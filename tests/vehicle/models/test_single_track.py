"""The single-track model: steady states in closed form, balances, signs, settings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import g

from miho.vehicle.models import Longitudinal, SingleTrack
from miho.vehicle.models.vehicle_settings import from_settings

CAR = SingleTrack(mass=800.0, lf=1.70, lr=1.271, Izz=850.0)


def test_slip_angles_of_a_rolling_turn_are_none() -> None:
    """Turning about a point on the line of the rear axle (Ackermann): no wheel slips."""
    radius = 20.0
    front, rear = CAR.slip_angles(
        vx=10.0, vy=CAR.lr * 10 / radius, yaw_rate=10 / radius, steering=np.arctan(2.971 / radius)
    )
    assert front == pytest.approx(0, abs=1e-15)
    assert rear == pytest.approx(0, abs=1e-15)


def test_iso_w_signs_in_a_left_turn() -> None:
    """At the limit of a left turn the axles slide outwards: negative angles, positive forces."""
    front, rear = CAR.slip_angles(vx=30.0, vy=-1.0, yaw_rate=0.3, steering=0.06)
    assert front < 0 and rear < 0
    forces = CAR.axle_forces(ay=9.0, yaw_acceleration=0.0, steering=0.06)
    assert forces.front > 0 and forces.rear > 0


def test_steady_forces_are_shared_like_the_weight() -> None:
    front, rear = CAR.axle_forces(ay=5.0, yaw_acceleration=0.0, steering=0.0)
    assert front == pytest.approx(800 * 5 * 1.271 / 2.971, rel=1e-15)
    assert front + rear == pytest.approx(800 * 5, rel=1e-15)


def test_forces_balance_force_and_moment() -> None:
    ay, turning, steering = np.random.default_rng(0).normal(0, [[5.0], [2.0], [0.1]], (3, 50))
    front, rear = CAR.axle_forces(ay, turning, steering)
    across = front * np.cos(steering)
    np.testing.assert_allclose(across + rear, 800 * ay, atol=1e-9)
    np.testing.assert_allclose(1.70 * across - 1.271 * rear, 850 * turning, atol=1e-9)


def test_a_bank_can_carry_the_turn() -> None:
    """At v^2 = g R tan(beta) no tire pushes; a_y along the road is v^2 / R cos(beta)."""
    bank = np.radians(20.0)
    ay = g * np.tan(bank) * np.cos(bank)
    assert CAR.axle_forces(ay, 0.0, 0.02, bank).front == pytest.approx(0, abs=1e-11)


def test_steady_turn_of_linear_axles() -> None:
    """The textbook understeer gradient: delta = L / R + m (lr / (Cf L) - lf / (Cr L)) a_y."""
    front, rear = CAR.axle_forces(4.0, 0.0, 0.0)
    Cf, Cr, radius = 150e3, 200e3, 225.0
    v = np.sqrt(4.0 * radius)
    vy = CAR.lr * v / radius - rear / Cr * v
    gradient = 800 / 2.971 * (1.271 / Cf - 1.70 / Cr)
    steering = 2.971 / radius + gradient * 4.0
    alpha = CAR.slip_angles(v, vy, v / radius, steering)
    assert -Cr * alpha.rear == pytest.approx(rear, rel=1e-3), "small angles"
    assert -Cf * alpha.front == pytest.approx(front, rel=1e-3), "small angles"


@pytest.mark.parametrize("field", ["mass", "lf", "lr", "Izz"])
def test_impossible_cars(field: str) -> None:
    with pytest.raises(ValueError, match=f"{field} is -1.0; expected a positive number"):
        replace(CAR, **{field: -1.0})


SETTINGS = {
    "mass": 800, "lf": 1.7, "lr": 1.271, "Izz": 850.0, "wheel_radius": 0.31,
    "gear_ratios": [2.9, 1.9], "final_drive": 3.0, "efficiency": 0.9, "engine_inertia": 0.2,
    "wheel_inertia": 3.0, "C_d": 0.47, "C_r": 120.0,
}  # fmt: skip


def test_a_vehicle_from_settings() -> None:
    assert from_settings(SingleTrack, SETTINGS) == CAR
    assert from_settings(Longitudinal, SETTINGS).gear_ratios == (2.9, 1.9)
    own = {key: SETTINGS[key] for key in ("mass", "lf", "lr", "Izz")}
    assert from_settings(SingleTrack, own) == CAR, "what the model does not need may be absent"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wheelbase": 3.0}, "vehicle.wheelbase is unknown; allowed are C_d, C_r, Izz"),
        ({"mass": None}, "vehicle.mass is None; expected a number"),
        ({"mass": "heavy"}, "vehicle.mass is 'heavy'; expected a number"),
        ({"mass": True}, "vehicle.mass is True; expected a number"),
        ({"gear_ratios": 3.0}, "vehicle.gear_ratios is 3.0; expected a list of numbers"),
        ({"gear_ratios": [3.0, "2"]}, "expected a list of numbers"),
        ({"mass": -1}, "vehicle: mass is -1; expected a positive number"),
    ],
)
def test_bad_settings_are_one_line(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError) as error:
        from_settings(Longitudinal, SETTINGS | changes)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_setting_is_named() -> None:
    with pytest.raises(ValueError, match=r"vehicle\.Izz is missing; give it in SI units"):
        from_settings(SingleTrack, {"mass": 800.0, "lf": 1.7, "lr": 1.3})
