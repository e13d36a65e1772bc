"""The torque cubic: values, derivatives, and what it leaves on a measured engine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from miho.testing import check_model
from miho.vehicle.models import TorqueCubic, TorqueCurve
from miho.vehicle.models.engine import RPM

THETA = np.array([40.0, -220.0, 310.0, -95.0])
CURVE = TorqueCurve((40.0, -220.0, 310.0, -95.0), 700.0, 0.15, (150.0, 650.0))


def test_it_is_the_polynomial_in_the_normalised_speed() -> None:
    """numpy's polynomial is the reference; 1e-12 is rounding of terms of some 100 Nm."""
    omega = np.linspace(0, 700, 61)
    torque = TorqueCubic(700.0).predict(np.stack([THETA, 2 * THETA]), omega)
    assert torque[0] == pytest.approx(np.polyval(THETA[::-1], omega / 700), rel=1e-12, abs=1e-12)
    assert np.array_equal(torque[1], 2 * torque[0])
    assert torque[0, 0] == THETA[0]
    assert torque[0, -1] == pytest.approx(THETA.sum(), rel=1e-14)


def test_it_is_a_model() -> None:
    thetas = np.random.default_rng(0).normal(0, 500, (20, 4))
    check_model(TorqueCubic(), thetas, np.linspace(100, 730, 37))


def test_it_is_linear_in_all_parameters() -> None:
    model, omega = TorqueCubic(), np.linspace(100, 730, 37)
    assert model.linear == tuple(model.parameters)
    expected = model.jacobian(np.zeros(4), omega) @ THETA
    assert model.predict(THETA[None], omega)[0] == pytest.approx(expected, rel=1e-12, abs=1e-10)


def test_the_largest_speed_must_be_one() -> None:
    for wrong in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="omega_max is"):
            TorqueCubic(wrong)


def test_a_curve_is_its_model_where_it_is_valid() -> None:
    omega = np.linspace(150, 650, 12).reshape(3, 4)
    expected = TorqueCubic(700.0).predict(THETA[None], omega.ravel()).reshape(3, 4)
    assert np.array_equal(CURVE.torque(omega), expected)


def test_a_curve_refuses_what_it_was_not_learned_from() -> None:
    with pytest.raises(
        ValueError, match="1 of 2 engine speeds, for example 651 rad/s, are outside"
    ):
        CURVE.torque(np.array([200.0, 651.0]))
    with pytest.raises(ValueError, match="outside the valid interval"):
        CURVE.torque(np.array(np.nan))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parameters": (1.0, 2.0, np.nan, 3.0)}, "four finite torques"),
        ({"throttle": 15.0}, "throttle is 15.0; expected an opening from 0 to 1"),
        ({"valid": (650.0, 150.0)}, "the lower first"),
        ({"omega_max": 0.0}, "omega_max is 0.0"),
    ],
)
def test_a_curve_says_what_is_wrong(change: dict[str, object], message: str) -> None:
    fields = {"parameters": tuple(THETA), "omega_max": 700.0, "throttle": 0.15, "valid": (1.0, 2.0)}
    with pytest.raises(ValueError, match=message):
        TorqueCurve(**(fields | change))  # type: ignore[arg-type]


def residual(rpm: np.ndarray, torque: np.ndarray) -> float:
    """RMSE [Nm] of the least-squares cubic."""
    J = TorqueCubic().jacobian(np.zeros(4), rpm * RPM)
    theta = np.linalg.lstsq(J, torque)[0]
    return float(np.sqrt(np.mean((J @ theta - torque) ** 2)))


def test_what_a_cubic_leaves_on_a_measured_engine(reference_data: Path) -> None:
    """It cannot follow the turbo from 3000 to 3600 rpm; above, and without the turbo, it can.

    Limits are the figures of docs/results.md.
    """
    path = reference_data / "engine" / "tum_iac_engine_map.csv"
    titles = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    rpm, *columns = np.loadtxt(path, delimiter=",", skiprows=1).T
    torque = {int(t.rpartition("_")[2]): c for t, c in zip(titles[1:], columns, strict=True)}
    whole, upper = ((low <= rpm) & (rpm <= 7000) for low in (1000, 3500))
    turbo = [opening for opening in torque if opening >= 50]
    assert turbo == [50, 65, 70, 80, 90, 100]
    residuals = [residual(rpm[whole], torque[opening][whole]) for opening in turbo]
    assert [min(residuals), max(residuals)] == pytest.approx([22, 46], abs=0.5)
    residuals = [residual(rpm[upper], torque[opening][upper]) for opening in turbo]
    assert [min(residuals), max(residuals)] == pytest.approx([3.5, 11.5], abs=0.05)
    assert residual(rpm[whole], torque[30][whole]) == pytest.approx(4.7, abs=0.05)
    assert residual(rpm[whole], torque[0][whole]) < 1e-6
