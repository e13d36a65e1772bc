"""Closed lines: interpolation, projection and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from miho.vehicle.driving.ovals import lvms
from miho.vehicle.driving.segments import Segment, track_of
from miho.vehicle.driving.track import Track

RADIUS = 100.0
OVAL = lvms(step=2.0)


@pytest.fixture(scope="module")
def circle() -> Track:
    bend = (1 / RADIUS, 1 / RADIUS)
    return track_of("circle", [Segment(length=math.tau * RADIUS, curvature=bend)])


def test_a_circle_is_one(circle: Track) -> None:
    """Its centre is (0, R), where it starts along x; offsets to the left lie nearer to it."""
    assert circle.length == pytest.approx(math.tau * RADIUS, abs=1e-9)
    s = np.linspace(-50.0, 2 * circle.length, 777)
    x, y = circle.position(s, 7.0)
    assert np.hypot(x, y - RADIUS) == pytest.approx(RADIUS - 7.0, abs=1e-6)
    assert circle.at(s).heading == pytest.approx(s / RADIUS, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(s=st.floats(0, OVAL.length), e=st.floats(-8, 8), away=st.floats(-15, 15))
def test_projection_inverts_position(s: float, e: float, away: float) -> None:
    x, y = map(float, OVAL.position(s, e))
    for hint in (None, s + away):
        projection = OVAL.project(x, y, hint)
        assert projection.e == pytest.approx(e, abs=1e-6)
        assert math.remainder(projection.s - s, OVAL.length) == pytest.approx(0.0, abs=1e-6)


def test_a_lap_later_the_line_is_the_same_and_the_heading_a_turn_on() -> None:
    here, later = OVAL.at(123.4), OVAL.at(123.4 + OVAL.length)
    assert later.heading - here.heading == pytest.approx(math.tau)
    for name in ("x", "y", "curvature", "bank", "width_left", "width_right"):
        assert getattr(later, name) == pytest.approx(getattr(here, name), abs=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": OVAL.x + np.linspace(0.0, 30.0, OVAL.s.size)}, "does not close"),
        ({"bank": np.degrees(OVAL.bank)}, "is banked by"),
        ({"width_left": OVAL.width_left - 9.0}, "leaves the road"),
        ({"curvature": OVAL.curvature[:-1]}, r"curvature of track lvms has shape"),
        ({"y": np.where(OVAL.s == 0, np.nan, OVAL.y)}, "finite numbers"),
        ({"length": 2 * OVAL.length}, "up to a step before the length"),
    ],
)
def test_what_is_no_track_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        replace(OVAL, **change)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
