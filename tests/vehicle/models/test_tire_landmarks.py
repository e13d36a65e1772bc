"""The tire by its landmarks: they are found on its curve, and some have none."""

import numpy as np
import pytest
from scipy.optimize import brentq

from miho.testing import check_model
from miho.vehicle.models import PacejkaCurvature, PacejkaLandmarks
from miho.vehicle.models.tire import factors

K, D, Y_A, X_M, SX, SY = THETA = np.array([9.0e4, 4500.0, 3500.0, 0.09, 0.003, 100.0])
MODEL = PacejkaLandmarks()


def force(alpha: float) -> float:
    return float(MODEL.predict(THETA[None], np.array([alpha]))[0, 0]) - SY


def test_the_landmarks_are_on_the_curve() -> None:
    h = 1e-6
    assert (force(SX - h) - force(SX + h)) / (2 * h) == pytest.approx(K, rel=1e-7)
    assert force(SX - X_M) == pytest.approx(D, rel=1e-14)
    slip = np.linspace(0.5, 1.5, 1001) * X_M
    curve = MODEL.predict(THETA[None], SX - slip)[0]
    assert slip[curve.argmax()] == pytest.approx(X_M)
    assert force(SX - 1e9) == pytest.approx(Y_A, rel=1e-7)


@pytest.mark.parametrize(("B", "C", "E"), [(12.0, 1.4, -0.7), (20.0, 1.2, 0.5), (8.0, 1.9, -3.0)])
def test_the_factors_of_a_curve_come_back(B: float, C: float, E: float) -> None:
    """The peak by a root finder: C arctan(z - E (z - arctan(z))) = pi / 2."""

    def missing(z: float) -> float:
        return float(z - E * (z - np.arctan(z)) - np.tan(np.pi / (2 * C)))

    peak = brentq(missing, 1e-6, 1e3, xtol=1e-14) / B
    theta = np.array([[B * C * D, D, D * np.sin(C * np.pi / 2), peak, SX, SY]])
    np.testing.assert_allclose(factors(theta)[0], [B, C, D, E, SX, SY], rtol=1e-9)


def test_what_has_no_curve_is_nan_and_leaves_the_others_alone() -> None:
    high = THETA * np.array([1, 1, 1.3, 1, 1, 1])  # asymptote above the peak
    far = THETA * np.array([1, 1, 0.1, 10, 1, 1])  # E > 1 as the asymptote is far below it
    soft = THETA * np.array([0.3, 1, 1, 1, 1, 1])
    alpha = np.linspace(-0.2, 0.2, 11)
    forces = MODEL.predict(np.stack([high, THETA, far, soft]), alpha)
    assert np.isnan(forces[0]).all()
    assert np.isnan(forces[2]).all()
    assert np.array_equal(forces[1], MODEL.predict(THETA[None], alpha)[0])
    assert np.isfinite(forces[3]).all()
    for theta in (high, far):
        assert np.isnan(MODEL.jacobian(theta, alpha)).all()


def test_the_model_keeps_its_contract() -> None:
    alpha = np.linspace(-0.2, 0.2, 41)
    check_model(MODEL, THETA * np.array([[1.0], [1.05], [0.9]]), alpha)


def test_it_spans_the_same_curves_as_the_curvature_model() -> None:
    alpha = np.linspace(-0.2, 0.2, 41)
    expected = PacejkaCurvature().predict(factors(THETA[None]), alpha)
    assert np.array_equal(MODEL.predict(THETA[None], alpha), expected)
