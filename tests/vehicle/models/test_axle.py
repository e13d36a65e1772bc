"""Axles: the sum of two tires, and two cornering stiffnesses."""

from __future__ import annotations

import numpy as np
import pytest

from miho.vehicle.models import (
    Axle,
    Pacejka,
    PacejkaCurvature,
    central_stiffness,
    cornering_stiffness,
)

FIVE = np.array([12.0, 1.4, 3000.0, 0.01, 80.0])
SIX = np.array([10.0, 1.5, 4200.0, -0.8, -0.02, 50.0])


def test_an_axle_is_the_sum_of_its_tires() -> None:
    alpha = np.linspace(-0.2, 0.2, 12)
    expected = (
        Pacejka().predict(FIVE[None], alpha)[0] + PacejkaCurvature().predict(SIX[None], alpha)[0]
    )
    axle = Axle(FIVE, SIX)
    assert np.array_equal(axle.force(alpha), expected)
    assert axle.force(alpha.reshape(3, 4)).shape == (3, 4)
    assert axle.force(0.0).shape == ()
    assert axle.force(0.1) < 0 < axle.force(-0.1)


@pytest.mark.parametrize("theta", [FIVE, SIX], ids=["Pacejka", "PacejkaCurvature"])
def test_stiffness_is_the_slope(theta: np.ndarray) -> None:
    """Central differences with h = 1e-5 rad are good to 1e-7 here."""
    axle, h = Axle(theta, theta), 1e-5
    Sx = theta[-2]
    for x, stiffness in ((0.0, cornering_stiffness(theta)), (Sx, central_stiffness(theta))):
        slope = (axle.force(x - h) - axle.force(x + h)) / (2 * h)
        assert 2 * stiffness == pytest.approx(slope, rel=1e-6)
    assert axle.cornering_stiffness == pytest.approx(2 * cornering_stiffness(theta))


def test_the_printed_form_for_an_offset() -> None:
    B, C, D, Sx, _ = FIVE
    expected = B * C * D * np.cos(C * np.arctan(B * Sx)) / (1 + B**2 * Sx**2)
    assert cornering_stiffness(FIVE) == pytest.approx(expected, rel=1e-14)
    assert cornering_stiffness(FIVE) < central_stiffness(FIVE) == B * C * D


def test_without_offset_the_two_agree() -> None:
    for theta in (FIVE, SIX):
        centred = theta.copy()
        centred[-2] = 0.0
        assert cornering_stiffness(centred) == central_stiffness(centred)


def test_a_batch_gives_a_stiffness_per_row() -> None:
    thetas = np.stack([SIX, 1.1 * SIX])
    assert cornering_stiffness(thetas).tolist() == [cornering_stiffness(row) for row in thetas]


def test_bad_parameters_are_named() -> None:
    with pytest.raises(ValueError, match=r"right is \[1.0, 2.0\]; expected the 5 finite"):
        Axle(FIVE, np.array([1.0, 2.0]))
    with pytest.raises(ValueError, match="left is"):
        Axle(FIVE * np.nan, FIVE)
    with pytest.raises(ValueError, match=r"theta has shape \(4,\)"):
        cornering_stiffness(np.ones(4))


def test_an_axle_does_not_change_with_the_array_it_was_made_of() -> None:
    theta = FIVE.copy()
    axle = Axle(theta, theta)
    theta[2] = 0.0
    assert axle.force(0.1) != 0
    with pytest.raises(ValueError, match="read-only"):
        axle.left[0] = 1.0
