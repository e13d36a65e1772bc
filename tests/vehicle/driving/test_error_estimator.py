"""Tracking errors from noisy sensors, against the model that they are filtered by."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from miho.vehicle.driving.path_tracking import ErrorEstimator, SampledModel, Weights
from miho.vehicle.driving.plant import Sensors
from tests.vehicle.driving.cars import car

VX = 27.8
SPEEDS = np.array([VX, VX + 1.0])


@cache
def sampled() -> SampledModel:
    return car().steering_controller(Weights(steering=100.0)).schedule.sampled


def test_without_noise_the_model_is_followed_exactly() -> None:
    """What it predicts is the state of `SampledModel` with the commands on their way."""
    estimator = ErrorEstimator.of(sampled(), Sensors(), SPEEDS)
    F, G = sampled().matrices(VX)
    rng = np.random.default_rng(0)
    z = rng.normal(0.0, 0.1, F.shape[0])
    u = 0.02
    following = F @ z + G * u
    predicted = estimator.predict(z[:5], z[-1], VX)
    # Both are the same sum of nine products of order 0.1, so that only rounding is left.
    assert predicted == pytest.approx(following[:5], abs=1e-12)
    assert estimator.correct(predicted, following[:5], VX) == pytest.approx(following[:5])


def test_the_noise_of_the_sensors_is_filtered() -> None:
    """A car that stays on its path: the errors of the estimate against those of the measurement.

    0.18 for e_y and 0.46 for e_psi come out; the bounds are far above, since other 2000 samples of
    noise move them by some percent.
    """
    noise = Sensors()
    estimator = ErrorEstimator.of(sampled(), noise, SPEEDS)
    rng = np.random.default_rng(0)
    stds = np.array([noise.position, noise.vy, noise.yaw, noise.yaw_rate, noise.steering])
    x, estimates, measured = np.zeros(5), [], rng.normal(0.0, stds, (2000, 5))
    measured[:, 1] += VX * measured[:, 2]
    for sample in measured:
        x = estimator.correct(x, sample, VX)
        estimates.append(x)
        x = estimator.predict(x, 0.0, VX)
    ratio = np.std(estimates[100:], axis=0) / np.std(measured[100:], axis=0)
    assert ratio[0] < 0.4
    assert ratio[2] < 0.6
    assert (ratio < 1).all()


def test_better_sensors_are_trusted_more() -> None:
    good, poor = (
        ErrorEstimator.of(sampled(), Sensors(position=std), SPEEDS).L[0, 0, 0]
        for std in (0.002, 0.2)
    )
    assert good > 3 * poor


def test_a_sensor_without_noise_is_believed() -> None:
    exact = Sensors(position=0, yaw=0, vy=0, yaw_rate=0, steering=0)
    L = ErrorEstimator.of(sampled(), exact, SPEEDS).L[0]
    # The covariance has a floor of 1e-6 in each unit, against model errors of 1e-3 and more.
    assert np.diag(L)[[1, 3, 4]] == pytest.approx(1.0, abs=1e-3)
