"""The Pacejka model: closed forms, signs, derivatives."""

import numpy as np
import pytest

from miho.models import Pacejka

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
