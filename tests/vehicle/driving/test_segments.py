"""Tracks from straights, arcs and clothoids."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import fresnel

from miho.vehicle.driving.segments import Segment, track_of


def test_a_clothoid_is_the_fresnel_integral() -> None:
    """x + iy = a sqrt(pi) (C + iS)(s / (a sqrt(pi))) with a^2 = R L."""
    length, corners = 80.0, 3
    sharpest = math.tau / corners / length
    into = Segment(length=length, curvature=(0.0, sharpest))
    track = track_of("triangle", corners * [into, into.mirrored()], step=0.5)
    assert track.length == pytest.approx(2 * corners * length, abs=1e-9), "closed by symmetry"
    s = track.s[track.s < length]
    scale = math.sqrt(math.pi * length / sharpest)
    S, C = fresnel(s / scale)
    assert track.x[: s.size] == pytest.approx(scale * C, abs=1e-9)
    assert track.y[: s.size] == pytest.approx(scale * S, abs=1e-9)


def test_bank_and_width_ramp_without_a_kink() -> None:
    bend = (0.01, 0.01)
    half = [
        Segment(length=50.0 * math.pi, curvature=bend, bank=(0.0, 0.3), width=(10.0, 14.0)),
        Segment(length=50.0 * math.pi, curvature=bend, bank=(0.3, 0.0), width=(14.0, 10.0)),
    ]
    track = track_of("bowl", half + half, step=0.5)
    assert track.bank.max() == pytest.approx(0.3, abs=1e-3)
    assert track.width_left + track.width_right == pytest.approx(10 + 4 * track.bank / 0.3)
    slope = np.diff(track.bank, append=track.bank[0]) / track.step
    # A smoothstep has the largest second derivative 6 rise / length^2, so slopes change by less.
    largest = 6 * 0.3 / (50 * math.pi) ** 2 * track.step
    assert np.abs(np.diff(slope, append=slope[0])).max() < 1.1 * largest


def test_the_left_edge_can_be_near() -> None:
    bend = (0.01, 0.01)
    track = track_of("ring", [Segment(length=200 * math.pi, curvature=bend)], left=1.0)
    assert (track.width_left == 1.0).all()
    assert track.width_right == pytest.approx(14.0)


@pytest.mark.parametrize("length", [590.0, 700.0])
def test_segments_that_do_not_close_are_refused(length: float) -> None:
    with pytest.raises(ValueError, match=r"track open does not close: its end is .* correct the"):
        track_of("open", [Segment(length=length, curvature=(0.01, 0.01))])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"length": 0.0}, "length of a segment is 0.0"),
        ({"length": 5.0, "bank": (0.0, math.nan)}, "bank of a segment is"),
        ({"length": 5.0, "width": (3.0,)}, "width of a segment is"),
    ],
)
def test_a_segment_says_what_is_wrong(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Segment(**settings)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="step is 0"):
        track_of("ring", [Segment(length=628.0, curvature=(0.01, 0.01))], step=0.0)
