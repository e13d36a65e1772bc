"""The simulated single-track car: steady cornering, an independent integration, its order."""

import numpy as np
import pytest

from miho.models.model import central_differences
from miho.quantities import Array
from miho.testing import check_model
from miho.vehicle.data import steering_test, tire_drive
from miho.vehicle.data.synthetic_drive import DRIVE_TRUTH
from miho.vehicle.models import single_track_drive, single_track_response

CAR = {"mass": 800.0, "lf": 1.7, "lr": 1.271, "Izz": 850.0}
MODEL = single_track_response(CAR)
TRUE = np.array([18.0, 1.5, 5500.0, 18.0, 1.5, 8000.0, 850.0])
EXACT = steering_test(CAR, noise=0.0)
INPUTS = [EXACT[name] for name in MODEL.inputs]


def refined(column: Array, times: int) -> Array:
    rows = np.arange(column.size)
    return np.asarray(np.interp(np.arange(times * (column.size - 1) + 1) / times, rows, column))


def test_steady_cornering_in_closed_form() -> None:
    """At small angles r = v delta / (L + m v^2 (l_r C_r - l_f C_f) / (C_f C_r L)), C = B C D."""
    t, speed, angle = np.arange(0.0, 6.0, 0.01), 30.0, 1e-5
    yaw_rate = MODEL.predict(TRUE[None], t, np.full_like(t, speed), np.full_like(t, angle))[0]
    front, rear = TRUE[0] * TRUE[1] * TRUE[2], TRUE[3] * TRUE[4] * TRUE[5]
    length = CAR["lf"] + CAR["lr"]
    turn = CAR["lr"] * rear - CAR["lf"] * front
    gradient = CAR["mass"] * turn / (front * rear * length)
    expected = speed * angle / (length + gradient * speed**2)
    assert yaw_rate[-1] == pytest.approx(expected, rel=1e-6)


def test_it_converges_to_an_integration_of_another_kind_with_order_four() -> None:
    """The data's own integration has a relative 1e-10; rows refined between are as if steered."""
    errors = []
    for times in (1, 2, 4):
        yaw_rate = MODEL.predict(TRUE[None], *(refined(column, times) for column in INPUTS))[0]
        errors.append(np.abs(yaw_rate[::times] - EXACT["yaw_rate"]).max())
    assert errors[0] < 2e-4, "rad/s, a twenty-fifth of the noise"
    assert errors[0] / errors[1] > 12
    assert errors[1] / errors[2] > 12


def test_left_is_positive_and_right_its_mirror() -> None:
    t, vx, steering = INPUTS
    left, right = (MODEL.predict(TRUE[None], t, vx, s * steering)[0] for s in (1, -1))
    assert np.array_equal(left, -right)
    first = np.flatnonzero(steering)[0]
    assert left[0] == 0
    assert np.sign(left[first + 1]) == np.sign(steering[first])


def test_the_model_keeps_its_contract() -> None:
    check_model(MODEL, TRUE * np.array([[1.0], [1.05], [0.9]]), *INPUTS)


@pytest.mark.parametrize("shape", [1.5, 1.2])
def test_derivatives_are_those_of_the_computed_motion(shape: float) -> None:
    """Central differences have a relative error of some 1e-10; of 600 rows the sums lose a little.

    Both axles saturate on the way, at the second shape far beyond their peak.
    """
    theta = TRUE * np.array([1.0, shape / 1.5, 0.5, 1.6, shape / 1.5, 0.6, 1.1])
    own, differences = (f(theta, *INPUTS) for f in (MODEL.jacobian, _differences))
    size = np.abs(differences).max(axis=0)
    np.testing.assert_allclose(own / size, differences / size, rtol=0, atol=1e-7)


def _differences(theta: Array, *inputs: Array) -> Array:
    return central_differences(MODEL.predict, theta, *inputs)


def test_a_row_is_the_same_in_any_batch() -> None:
    """Also where the processor moves several cars at once, and for the last ones alone."""
    thetas = TRUE * np.random.default_rng(0).uniform(0.7, 1.3, (37, 7))
    batch = MODEL.predict(thetas, *INPUTS)
    for theta, row in zip(thetas, batch, strict=True):
        assert np.array_equal(MODEL.predict(theta[None], *INPUTS)[0], row)


def test_forces_that_saturate_keep_it_bounded() -> None:
    """Beyond the stability of the integration, at the stiffest corner of the space."""
    stiff = np.array([[30.0, 2.2, 12000.0, 30.0, 2.2, 15000.0, 300.0]])
    assert np.isfinite(MODEL.predict(stiff, *INPUTS)).all()


def test_rows_out_of_order_and_a_car_without_mass_are_refused() -> None:
    t, vx, steering = INPUTS
    with pytest.raises(ValueError, match="t does not increase"):
        MODEL.predict(TRUE[None], t[::-1], vx, steering)
    with pytest.raises(ValueError, match=r"vehicle\.mass is missing"):
        single_track_response({name: CAR[name] for name in ("lf", "lr", "Izz")})


@pytest.mark.parametrize("restart", [None, 1, 20])
def test_the_motion_in_the_plane_keeps_its_contract(restart: int | None) -> None:
    data, model = tire_drive(CAR, "lively", duration=3.0), single_track_drive(CAR, restart=restart)
    thetas = np.array(list(DRIVE_TRUTH.values())) * np.array([[1.0], [1.1]])
    check_model(model, thetas, *(data[name] for name in model.inputs))
