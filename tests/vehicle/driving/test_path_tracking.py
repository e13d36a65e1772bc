"""The regulator: published gains, stability on a fine grid, exactness of the sampled model."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from miho.vehicle.driving.path_tracking import (
    GainSchedule,
    LateralModel,
    SampledModel,
    SteeringActuator,
    Weights,
    continuous_gains,
)
from miho.vehicle.models import SingleTrack
from tests.vehicle.driving.cars import car

CAR = SingleTrack(mass=800.0, lf=1.724, lr=1.247, Izz=1000.0)
MODEL = LateralModel(car=CAR, C_f=150e3, C_r=200e3)
STEERING = SteeringActuator(delay=0.04, lag=0.0531)
SAMPLED = SampledModel(model=MODEL, steering=STEERING, period=0.01)


@pytest.mark.parametrize(
    ("vx", "expected"),
    [
        (20.0, [0.316228, 0.013178, 1.171170, 0.026587]),
        (60.0, [0.316228, 0.029644, 1.500024, 0.058353]),
    ],
)
def test_the_printed_regulator_has_the_known_gains(vx: float, expected: list[float]) -> None:
    """Computed independently, to six digits."""
    assert continuous_gains(MODEL, Weights(), vx) == pytest.approx(expected, abs=1e-5)


def test_the_slip_angles_are_those_of_the_single_track_model() -> None:
    """A steady state of the error model is one of the nonlinear geometry, linearised."""
    vx, curvature, steering = 40.0, 2e-3, 0.01
    A, B1, B2, _ = MODEL.matrices(vx)
    vy, r = 0.3, 0.1  # any: e_y' = vy + vx e_psi, e_psi' = r - vx kappa
    e_psi = 0.02
    xi = np.array([0.0, vy + vx * e_psi, e_psi, r - vx * curvature])
    rates = A @ xi + B1 * steering + B2 * vx * curvature
    alpha_f = (vy + CAR.lf * r) / vx - steering
    alpha_r = (vy - CAR.lr * r) / vx
    Fyf, Fyr = -MODEL.C_f * alpha_f, -MODEL.C_r * alpha_r
    vy_rate = (Fyf + Fyr) / CAR.mass - vx * r
    assert rates[1] == pytest.approx(vy_rate + vx * xi[3])
    assert rates[3] == pytest.approx((CAR.lf * Fyf - CAR.lr * Fyr) / CAR.Izz)


def test_a_sample_is_the_exact_solution() -> None:
    """Against an integration of delay, lag and car, to the integrator's tolerance."""
    vx, rng = 35.0, np.random.default_rng(3)
    commands = 0.05 * rng.standard_normal(12)
    F, G = SAMPLED.matrices(vx)
    z = np.zeros(9)
    for u in commands:
        z = F @ z + G * u
    A, B1, _, _ = MODEL.matrices(vx)
    xi = np.zeros(5)
    for k in range(12):
        u = commands[k - 4] if k >= 4 else 0.0

        def rate(_: float, y: np.ndarray, u: float = u) -> np.ndarray:
            return np.append(A @ y[:4] + B1 * y[4], (u - y[4]) / STEERING.lag)

        xi = solve_ivp(rate, (0, 0.01), xi, rtol=1e-10, atol=1e-13).y[:, -1]
    assert z[:5] == pytest.approx(xi, abs=1e-8)
    assert z[5:] == pytest.approx(commands[:-5:-1])


@pytest.mark.parametrize("steering", [10.0, 300.0])
def test_the_loop_is_stable_on_the_interpolants(steering: float) -> None:
    """From 3 to 80 m/s, eight speeds between the design points, of this car and of the AV-21."""
    for model in (MODEL, car().steering_controller(Weights()).schedule.sampled.model):
        sampled = SampledModel(model=model, steering=STEERING, period=0.01)
        schedule = GainSchedule.of(sampled, Weights(steering=steering))
        for vx in np.arange(3.0, 80.01, 0.25):
            F, G = sampled.matrices(vx)
            assert np.abs(np.linalg.eigvals(F - np.outer(G, schedule.at(vx)))).max() < 0.999


def test_without_delay_and_lag_both_regulators_agree() -> None:
    """As the period goes to 0; at 0.1 ms they are 1 % apart."""
    quick = SampledModel(model=MODEL, steering=SteeringActuator(delay=0.0, lag=1e-6), period=1e-4)
    # The sum over samples counts the state per sample, the integral per second: the same weights.
    gains = quick.gains(Weights(), 30.0)[:4]
    assert gains == pytest.approx(continuous_gains(MODEL, Weights(), 30.0), rel=0.02)


@pytest.mark.parametrize("vx", [0.0, -3.0, math.nan])
def test_there_is_no_model_at_rest(vx: float) -> None:
    with pytest.raises(ValueError, match="expected a speed above 0 m/s"):
        MODEL.matrices(vx)


def test_settings_that_make_no_regulator_are_refused() -> None:
    with pytest.raises(ValueError, match=r"C_f is 0\.0; expected a positive number"):
        LateralModel(car=CAR, C_f=0.0, C_r=1e5)
    with pytest.raises(ValueError, match=r"weights are .* expected numbers of at least 0"):
        Weights(e_y=-1.0)
    with pytest.raises(ValueError, match=r"steering is 0\.0; expected a weight above 0"):
        Weights(steering=0.0)
    with pytest.raises(ValueError, match="delay is -1 s"):
        SteeringActuator(delay=-1, lag=0.1)
    with pytest.raises(ValueError, match="period is 0"):
        SampledModel(model=MODEL, steering=STEERING, period=0.0)
    with pytest.raises(ValueError, match="expected rising numbers above 0 m/s"):
        GainSchedule.of(SAMPLED, Weights(), np.array([3.0, 3.0]))
