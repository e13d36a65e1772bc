"""What the printed equations do, in numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.constants import g

from miho.driving.velocity_as_printed import PrintedPlanner
from miho.driving.velocity_planner import VelocityPlanner
from tests.driving.test_velocity_planner import CAR, PLAIN, equal_grip, ring

TRACK = ring(150.0, 0.0)


def test_eq_11_gives_0_707_of_the_speed() -> None:
    """Without load sensitivity and air the corrected limit is sqrt(mu g R)."""
    printed = PrintedPlanner(PLAIN, equal_grip(), mu=0.9).speeds(TRACK)
    mended = PrintedPlanner(PLAIN, equal_grip(), mu=0.9, yaw_term=False).speeds(TRACK)
    limit = VelocityPlanner(PLAIN, equal_grip(), mu=0.9).plan(TRACK).v
    assert limit == pytest.approx(math.sqrt(0.9 * g * 150))
    # cos(delta) takes 2e-4 of the front axle's force.
    assert mended == pytest.approx(limit, rel=2e-4)
    assert printed / mended == pytest.approx(math.sqrt(0.5))


def test_eq_10_makes_load_transfer_cancel() -> None:
    """With equal tires exactly; with the embedded ones, which differ, all but 0.1 %."""
    for grip, most in ((equal_grip(), 1e-12), (CAR.grip, 1e-3)):
        still, moved = (
            PrintedPlanner(PLAIN, grip, transfer=transfer).speeds(TRACK)
            for transfer in (False, True)
        )
        assert np.abs(moved / still - 1).max() < most


def test_straights_have_the_top_speed_and_right_turns_their_own_peaks() -> None:
    line = TRACK
    planner = PrintedPlanner(CAR.vehicle, CAR.grip, top_speed=20.0)
    assert planner.speeds(line) == pytest.approx(20.0)
