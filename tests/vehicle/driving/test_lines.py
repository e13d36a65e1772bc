"""Lines beside lines."""

from __future__ import annotations

import math

import numpy as np
import pytest

from miho.vehicle.driving.lines import Offset, beside, constant
from miho.vehicle.driving.ovals import lvms
from miho.vehicle.driving.segments import Segment, track_of

RADIUS = 100.0
BEND = (1 / RADIUS, 1 / RADIUS)
CIRCLE = track_of("circle", [Segment(length=math.tau * RADIUS, curvature=BEND)])


def test_beside_a_circle_is_a_circle() -> None:
    inner = beside(CIRCLE, constant(5.0), "inner")
    assert inner.name == "inner"
    assert inner.length == pytest.approx(math.tau * 95, rel=1e-9)
    assert inner.curvature == pytest.approx(1 / 95)
    assert inner.width_left == pytest.approx(2.5)
    assert inner.width_right == pytest.approx(12.5)


def test_a_wave_has_the_curvature_of_its_heading() -> None:
    """On the real oval, with changing curvature: d heading / ds by differences."""
    track, waves = lvms(), 7
    k = math.tau * waves / track.length

    def wave(s: np.ndarray) -> Offset:
        phase = k * s
        return Offset(2 * np.sin(phase), 2 * k * np.cos(phase), -2 * k * k * np.sin(phase))

    line = beside(track, wave)
    slopes = (np.roll(line.heading, -1) - np.roll(line.heading, 1))[1:-1] / (2 * line.step)
    # The clothoids' ends, where the curvature has a corner, are half a step wide.
    assert np.abs(slopes - line.curvature[1:-1]).max() < 3e-5
    x, y = line.x[::100], line.y[::100]
    places = [track.project(*point) for point in zip(x, y, strict=True)]
    assert [p.e for p in places] == pytest.approx([2 * math.sin(k * p.s) for p in places], abs=1e-5)


def test_lines_that_leave_the_road_or_turn_on_themselves_are_refused() -> None:
    with pytest.raises(ValueError, match="leaves the road"):
        beside(CIRCLE, constant(7.6))
    with pytest.raises(ValueError, match="reaches the centre of the bend"):
        beside(CIRCLE, constant(99.0))
