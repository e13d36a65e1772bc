"""The embedded steering test: what is true is found, and settings are checked."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from miho.vehicle.data import steering_test
from miho.vehicle.data.synthetic_handling import NOISE, TEST_AMPLITUDE, TRUTH
from miho.vehicle.models import single_track_response

CAR = {"mass": 800.0, "lf": 1.7, "lr": 1.271, "Izz": 850.0}
TRUE = np.array([*TRUTH["front"].values(), *TRUTH["rear"].values(), CAR["Izz"]])


@pytest.mark.slow
def test_parameters_are_recovered() -> None:
    """Within four standard errors of linear theory, none above 5 %."""
    data, model = steering_test(CAR), single_track_response(CAR)
    inputs = [data[name] for name in model.inputs]

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.asarray(model.predict((x * TRUE)[None], *inputs)[0] - data["yaw_rate"])

    def jacobian(x: np.ndarray) -> np.ndarray:
        return np.asarray(model.jacobian(x * TRUE, *inputs) * TRUE)

    identified = least_squares(residuals, np.full(7, 0.9), jac=jacobian).x
    J = jacobian(identified)
    errors = NOISE["yaw_rate"] * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    assert (np.abs(identified - 1) < 4 * errors).all()
    assert errors.max() < 0.05


def test_the_tires_are_far_from_linear() -> None:
    """The answer to a ten-thousandth of the steering, scaled up, is off by a quarter."""
    data = steering_test(CAR, noise=0.0)
    t, vx, steering = data["t"], data["vx"], data["steering"]
    assert 0.9 * TEST_AMPLITUDE < np.abs(steering).max() <= TEST_AMPLITUDE
    linear = single_track_response(CAR).predict(TRUE[None], t, vx, 1e-4 * steering)[0] / 1e-4
    assert np.std(data["yaw_rate"] - linear) > 0.25 * np.std(linear)


def test_a_seed_is_a_stream_of_noise() -> None:
    first, again, other_seed = steering_test(CAR, 1), steering_test(CAR, 1), steering_test(CAR, 2)
    exact = steering_test(CAR, noise=0.0)["yaw_rate"]
    assert np.array_equal(first["yaw_rate"], again["yaw_rate"])
    assert np.std(first["yaw_rate"] - exact) == pytest.approx(NOISE["yaw_rate"], rel=0.15)
    noise = [data["yaw_rate"] - exact for data in (first, other_seed)]
    assert abs(np.corrcoef(noise)[0, 1]) < 0.25


@pytest.mark.parametrize(
    "bad", [{"seed": -1}, {"duration": 0.0}, {"rate": np.inf}, {"noise": -1.0}, {"duration": 0.01}]
)
def test_bad_settings_are_named(bad: dict[str, float]) -> None:
    ((name, value),) = bad.items()
    with pytest.raises(ValueError, match=rf"{name} is {value}.*; expected"):
        steering_test(CAR, **bad)  # type: ignore[arg-type]
