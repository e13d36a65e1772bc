"""The Pacejka model: closed forms, signs, derivatives."""

import numpy as np
import pytest

from miho.testing import check_model
from miho.vehicle.models import Pacejka, PacejkaCurvature

THETA = np.array([12.0, 1.4, 3000.0, 0.01, 80.0])
B, C, D, SX, SY = THETA


def force(alpha: float) -> float:
    return float(Pacejka().predict(THETA[None], np.array([alpha]))[0, 0])


def test_closed_forms() -> None:
    assert force(SX) == SY
    peak = SX - np.tan(np.pi / (2 * C)) / B
    assert force(peak) == pytest.approx(D + SY, rel=1e-15)
    assert force(SX - 1e9) == pytest.approx(D * np.sin(C * np.pi / 2) + SY, rel=1e-9)


def test_iso_w_signs() -> None:
    """Positive slip angle, negative force; the slope at the centre is -BCD."""
    assert force(0.05) < SY < force(-0.05)
    h = 1e-6
    slope = (force(SX + h) - force(SX - h)) / (2 * h)
    assert slope == pytest.approx(-B * C * D, rel=1e-8)


def test_jacobian_is_the_complex_step_derivative() -> None:
    """Complex steps are exact to rounding: sin and arctan extend to complex arguments."""
    alpha = np.linspace(-0.3, 0.3, 41)
    jacobian = Pacejka().jacobian(THETA, alpha)
    for k in range(5):
        b, c, d, sx, sy = THETA + 1e-30j * (np.arange(5) == k)
        value = d * np.sin(c * np.arctan(b * (sx - alpha))) + sy
        assert jacobian[:, k] == pytest.approx(value.imag / 1e-30, rel=1e-12, abs=1e-12)


def test_a_row_is_the_same_in_any_batch() -> None:
    rng = np.random.default_rng(0)
    thetas = THETA * rng.uniform(0.2, 5.0, (300, 5))
    alpha = rng.uniform(-0.3, 0.3, 301)
    batch = Pacejka().predict(thetas, alpha)
    for i, theta in enumerate(thetas):
        assert np.array_equal(Pacejka().predict(theta[None], alpha)[0], batch[i])


BENT = np.array([12.0, 1.4, 3000.0, -0.7, 0.01, 80.0])


def test_curvature_of_zero_is_pacejka() -> None:
    alpha = np.linspace(-0.3, 0.3, 41)
    straight = np.array([B, C, D, 0.0, SX, SY])
    plain = Pacejka().predict(THETA[None], alpha)
    np.testing.assert_allclose(PacejkaCurvature().predict(straight[None], alpha), plain, rtol=1e-14)


def test_curvature_bends_the_peak_and_leaves_the_centre() -> None:
    """The force at the centre and its slope B C D hold for every E; E < 0 draws the peak nearer."""
    model, h = PacejkaCurvature(), 1e-6
    ahead, centre, behind = model.predict(BENT[None], np.array([SX + h, SX, SX - h]))[0]
    assert centre == SY
    assert (behind - ahead) / (2 * h) == pytest.approx(B * C * D, rel=1e-7)
    alpha = np.linspace(SX - 0.3, SX, 3001)
    peaks = {}
    for E in (-1.5, 0.0, 0.8):
        force = model.predict(np.array([[B, C, D, E, SX, SY]]), alpha)[0]
        peaks[E] = SX - alpha[force.argmax()]
    assert peaks[-1.5] < peaks[0.0] < peaks[0.8]


def test_curvature_jacobian_is_the_complex_step_derivative() -> None:
    alpha = np.linspace(-0.3, 0.3, 41)
    jacobian = PacejkaCurvature().jacobian(BENT, alpha)
    for k in range(6):
        b, c, d, e, sx, sy = BENT + 1e-30j * (np.arange(6) == k)
        z = b * (sx - alpha)
        value = d * np.sin(c * np.arctan(z - e * (z - np.arctan(z)))) + sy
        assert jacobian[:, k] == pytest.approx(value.imag / 1e-30, rel=1e-12, abs=1e-12)


def test_curvature_jacobian_of_a_batch() -> None:
    thetas, alpha = BENT * np.array([[1.0], [1.1], [0.7]]), np.linspace(-0.3, 0.3, 41)
    batch = PacejkaCurvature().jacobian(thetas, alpha)
    for theta, jacobian in zip(thetas, batch, strict=True):
        assert np.array_equal(PacejkaCurvature().jacobian(theta, alpha), jacobian)
    check_model(PacejkaCurvature(), thetas, alpha)
