"""Paths around obstacles."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miho.vehicle.driving.local_plan import LocalPlanner, NoPathError, Obstacle, Swerve
from miho.vehicle.driving.segments import Segment, track_of

RADIUS = 400.0
RING = track_of(
    "ring", [Segment(length=math.tau * RADIUS, curvature=(1 / RADIUS, 1 / RADIUS))], step=1.0
)
PLANNER = LocalPlanner()


def test_a_swerve_is_as_steep_and_bent_as_it_says() -> None:
    swerve = Swerve(lap=500.0, start=450.0, out=40.0, stay=20.0, back=80.0, e=-3.0)
    s = np.linspace(0.0, 500.0, 20_001)
    e, slope, bend = swerve(s)
    assert e.min() == pytest.approx(-3.0)
    assert np.gradient(e, s)[5:-5] == pytest.approx(slope[5:-5], abs=5e-5)
    assert np.gradient(slope, s)[5:-5] == pytest.approx(bend[5:-5], abs=5e-5)
    # Clothoids: 8 over the length squared at most, and it changes by 32 over its cube everywhere.
    assert np.abs(bend).max() == pytest.approx(3 * 8 / 40**2, rel=1e-4)
    assert np.abs(np.gradient(bend, s)).max() == pytest.approx(3 * 32 / 40**3, rel=1e-6)


@settings(max_examples=12, deadline=None)
@given(
    now=st.floats(0, RING.length),
    gap=st.floats(25, 120),
    e=st.floats(-3, 3),
    width=st.floats(0.5, 3.0),
)
def test_the_path_clears_the_obstacle_and_returns(
    now: float, gap: float, e: float, width: float
) -> None:
    """Checked by the distance of the car's box from the obstacle's in the plane."""
    obstacle = Obstacle(s=(now + gap) % RING.length, e=e, width=width)
    path = PLANNER.path(RING, [obstacle], now)
    apart = []
    for x, y in zip(path.x[::2], path.y[::2], strict=True):
        at = RING.project(float(x), float(y))
        along = math.remainder(at.s - obstacle.s, RING.length)
        if abs(along) < (PLANNER.length + obstacle.length) / 2:
            apart.append(abs(at.e - e) - (PLANNER.width + width) / 2)
        if not -gap - 1 < along < obstacle.length + PLANNER.back + PLANNER.length + 10:
            assert abs(at.e) < 1e-6
    assert min(apart) > PLANNER.clearance - 0.02
    assert min(path.width_left.min(), path.width_right.min()) > PLANNER.width / 2


def test_with_nothing_in_the_way_the_line_stays() -> None:
    assert PLANNER.path(RING, [], 0.0) is RING
    beside = Obstacle(s=100.0, e=6.0, width=1.0)
    assert PLANNER.path(RING, [beside], 20.0).length == pytest.approx(RING.length, rel=1e-9)


def test_the_nearer_side_with_room_is_taken() -> None:
    for e, side in ((1.0, -1), (-1.0, 1)):
        path = PLANNER.path(RING, [Obstacle(s=100.0, e=e)], 40.0)
        off = [RING.project(float(x), float(y)).e for x, y in zip(path.x, path.y, strict=True)]
        assert max(off, key=abs) * side > 0


def test_no_path_is_an_error_of_one_line() -> None:
    with pytest.raises(NoPathError, match=r"no path with .* passes the obstacle at s = 100") as e:
        PLANNER.path(RING, [Obstacle(s=100.0, e=0.0, width=12.0)], 40.0)
    assert "\n" not in str(e.value)
    with pytest.raises(NoPathError, match=r"the obstacle is 8.0 m ahead"):
        PLANNER.path(RING, [Obstacle(s=100.0, e=0.0)], 92.0)


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="obstacle width is -1"):
        Obstacle(s=0.0, e=0.0, width=-1)
    with pytest.raises(ValueError, match="obstacle at s = nan"):
        Obstacle(s=math.nan, e=0.0)
    with pytest.raises(ValueError, match="back is 0"):
        LocalPlanner(back=0)
