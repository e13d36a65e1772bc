"""The steady brake models and the brake composed of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from miho.testing import check_model
from miho.vehicle.models import Brake, BrakeDeceleration, BrakePressure, BrakeTorque

BRAKE = Brake(
    u0=0.08, u1=0.9, P_max=6e6, n=1.4, bias=0.57,
    K_front=3.6e-4, P0_front=6e4, K_rear=3.2e-4, P0_rear=9e4,
    radius_front=0.298, radius_rear=0.310,
    delay=0.04, tau_rise=0.12, tau_fall=0.07,
)  # fmt: skip


def pressure(u: float) -> float:
    theta = np.array([[0.1, 0.9, 6e6, 2.0]])
    return float(BrakePressure().predict(theta, np.array([u]))[0, 0])


def test_pressure_in_closed_form() -> None:
    assert pressure(0.0) == pressure(0.1) == 0.0
    assert pressure(0.5) == pytest.approx(6e6 / 4, rel=1e-15)
    assert pressure(0.9) == pressure(1.0) == 6e6


def test_models_keep_their_contract() -> None:
    """Derivatives, batches, and the parameters declared linear; points away from the kinks."""
    u = np.linspace(0.003, 1.0, 50)
    check_model(BrakePressure(), np.array([[0.05, 0.93, 6e6, 1.3], [0.2, 1.2, 2e6, 0.6]]), u)
    p = np.linspace(0, 6e6, 50)
    check_model(BrakeTorque(), np.array([[3.6e-4, 6.1e4], [1e-3, 2.1e5]]), p)
    vx = np.linspace(10, 60, 50)
    check_model(BrakeDeceleration(), np.array([[2.5e-6, 5.9e-4, 1.24]]), p, vx)


def test_derivatives_at_the_ends_are_finite() -> None:
    """A root (n < 1) has no slope at u0; nothing warns."""
    u = np.array([0.0, 0.1, 0.9, 1.0])
    jacobian = BrakePressure().jacobian(np.array([0.1, 0.9, 6e6, 0.5]), u)
    assert np.isfinite(jacobian).all()
    assert jacobian[:, 2].tolist() == [0.0, 0.0, 1.0, 1.0]


def test_force_is_the_sum_of_the_axle_torques_over_the_radii() -> None:
    front, rear = BRAKE.pressure(np.array([0.3, 0.6, 0.9]))
    assert front / (front + rear) == pytest.approx(0.57)
    torques = [
        BrakeTorque().predict(np.array([theta]), p)[0]
        for theta, p in (((3.6e-4, 6e4), front), ((3.2e-4, 9e4), rear))
    ]
    expected = torques[0] / 0.298 + torques[1] / 0.310
    np.testing.assert_allclose(BRAKE.force([0.3, 0.6, 0.9]), expected, rtol=1e-14)


@pytest.mark.parametrize("P0_front", [0.0, 6e4, 3e5])
def test_command_is_the_inverse_of_force(P0_front: float) -> None:
    """Whichever axle's pads touch first, and where one of them works alone."""
    brake = replace(BRAKE, P0_front=P0_front)
    forces = np.geomspace(1e-3, brake.largest_force, 5000)
    u, residual = brake.command(forces)
    assert (np.diff(u) > 0).all()
    np.testing.assert_allclose(brake.force(u), forces, rtol=1e-9)
    assert np.abs(residual / forces).max() < 1e-9
    u = np.linspace(float(brake.command(1e-9).u) + 1e-6, brake.u1, 5000)
    np.testing.assert_allclose(brake.command(brake.force(u)).u, u, rtol=1e-9)


def test_command_agrees_with_a_root_finder() -> None:
    for demand in (20.0, 400.0, 9000.0):

        def excess(u: float, demand: float = demand) -> float:
            return float(BRAKE.force(u)) - demand

        root = brentq(excess, 0.08, 0.9, xtol=1e-14)
        assert float(BRAKE.command(demand).u) == pytest.approx(root, rel=1e-10)


def test_dead_band_and_saturation_leave_a_residual() -> None:
    largest = BRAKE.largest_force
    u, residual = BRAKE.command([-50.0, 0.0, largest + 700.0, np.inf])
    assert u[:2].tolist() == [0.0, 0.0]
    assert u[2:] == pytest.approx([0.9, 0.9])
    assert residual[:3] == pytest.approx([-50.0, 0.0, 700.0])
    assert np.isinf(residual[3])
    onset = float(BRAKE.command(1e-9).u)
    assert BRAKE.force(onset - 1e-6) == 0.0
    assert BRAKE.force(onset + 1e-9) > 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n": 0.0}, "n is 0.0; expected a positive number"),
        ({"P0_rear": -1.0}, "P0_rear is -1.0; expected a number of at least 0"),
        ({"tau_rise": np.nan}, "tau_rise is nan"),
        ({"u0": 0.95}, "u1 is 0.9; expected above u0, which is 0.95"),
        ({"bias": 1.0}, "bias is 1.0; expected between 0 and 1"),
        ({"P_max": 5e4}, "P_max is 50000.0; expected above"),
    ],
)
def test_impossible_brakes_are_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(BRAKE, **settings)


def test_impossible_demands_are_refused() -> None:
    with pytest.raises(ValueError, match="force is NaN"):
        BRAKE.command(np.nan)
