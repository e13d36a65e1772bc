"""The brake with play: closed forms, the play operator on its own, derivatives."""

import numpy as np
import pytest

from miho.testing import check_model
from miho.vehicle.data import brake_play_test
from miho.vehicle.models import BrakePlay, BrakePressure, play

THETA = np.array([0.065, 0.93, 6.0e6, 1.35, 0.06])
U = brake_play_test()["u"]


@pytest.mark.parametrize("width", [0.0, 0.013, 0.06, 0.3, 2.5])
def test_it_is_the_static_curve_behind_the_play(width: float) -> None:
    """Two implementations of the play, which only compare and choose."""
    theta = np.append(THETA[:4], width)
    p = BrakePlay().predict(theta[None], U)[0]
    static = BrakePressure().predict(THETA[None, :4], play(U, width))[0]
    assert np.array_equal(p, static)


def test_a_straight_brake_in_closed_form() -> None:
    """p = u - width / 2 going up, u + width / 2 coming down, level in between."""
    theta = np.array([[0.0, 1.0, 1.0, 1.0, 0.2]])
    u = np.array([0.0, 0.05, 0.1, 0.5, 0.9, 0.8, 0.7, 0.5, 0.55, 0.7, 0.9])
    p = BrakePlay().predict(theta, u)[0]
    expected = [0.0, 0.0, 0.0, 0.4, 0.8, 0.8, 0.8, 0.6, 0.6, 0.6, 0.8]
    np.testing.assert_allclose(p, expected, rtol=1e-14, atol=1e-15)


def test_it_does_not_depend_on_the_rate() -> None:
    halves = np.insert(U, np.arange(1, U.size), (U[:-1] + U[1:]) / 2)
    p = BrakePlay().predict(THETA[None], U)
    assert np.array_equal(BrakePlay().predict(THETA[None], halves)[:, ::2], p)


def test_the_model_keeps_its_contract() -> None:
    """No row lies within a step of a kink at these configurations."""
    check_model(BrakePlay(), THETA * np.array([[1.0], [1.031], [0.973]]), U)


def test_the_loss_has_kinks_in_the_width() -> None:
    """At a width at which one row begins to rest, the two one-sided derivatives differ."""
    u = np.array([0.0, 0.5, 0.4])
    theta = np.array([0.0, 1.0, 1.0, 1.0, 0.0])
    below, above = (
        BrakePlay().jacobian(np.append(theta[:4], 0.1 + step), u)[2, 4] for step in (-1e-9, 1e-9)
    )
    assert (below, above) == (0.5, -0.5)
