"""The two ovals of the paper's field tests, from what is published of their design."""

from __future__ import annotations

import math

from miho.driving.segments import Segment, track_of
from miho.driving.track import Track

_DEGREE = math.pi / 180


def ims(step: float = 1.0) -> Track:
    """Indianapolis Motor Speedway (4023.36 m), from the middle of the front straight.

    The line is the one along which the 2.5 miles are measured, as drawings have it: turns of 90
    degrees and radius 256.135 m. A survey (TUM) finds it 0.7 m off the left edge of a road that is
    15.2 m wide, 18.3 m in the turns; `beside` gives lines to drive on. The turns are banked by 9.2
    degrees; next to the long straights, which are flat, they lean in over 160 m. The short
    straights keep 7 degrees; both are of the survey, for want of a drawing.
    """
    radius, steep, turn, narrow, wide = 256.135, 9.2 * _DEGREE, 402.336, 15.2, 18.3
    bend, short = (1 / radius, 1 / radius), 7.0 * _DEGREE
    leaning = [
        Segment(length=160.0, curvature=bend, bank=(0.0, steep), width=(narrow, wide)),
        Segment(length=turn - 220, curvature=bend, bank=(steep, steep), width=(wide, wide)),
        Segment(length=60.0, curvature=bend, bank=(steep, short), width=(wide, narrow)),
    ]
    half = Segment(length=502.92, width=(narrow, narrow))
    chute = Segment(length=201.168 / 2, bank=(short, short), width=(narrow, narrow))
    quarter = [half, *leaning, chute]
    back = [segment.mirrored() for segment in reversed(quarter)]
    return track_of("ims", [*quarter, *back, *quarter, *back], step=step, left=0.7)


def lvms(step: float = 1.0) -> Track:
    """Las Vegas Motor Speedway (2471 m), from the middle of the back straight.

    Turns of radius 234 m banked by 20 degrees, the back straight by 6; the front is a curve of
    488.4 m banked by 9. Clothoids lie between them, over which the bank changes; 15 m wide. The
    radii and lengths are fitted to a survey (TUM): mean distance 0.75 m.
    """
    turn, front = 1 / 234.0, 1 / 488.4
    steep, back, middle = 20 * _DEGREE, 6 * _DEGREE, 9 * _DEGREE
    half = [
        Segment(length=163.75, bank=(back, back)),
        Segment(length=151.5, curvature=(0.0, turn), bank=(back, steep)),
        Segment(length=527.4, curvature=(turn, turn), bank=(steep, steep)),
        Segment(length=26.8, curvature=(turn, 0.0), bank=(steep, 14.5 * _DEGREE)),
        Segment(length=60.0, bank=(14.5 * _DEGREE, middle)),
        Segment(length=117.0, curvature=(0.0, front), bank=(middle, middle)),
        Segment(length=189.0, curvature=(front, front), bank=(middle, middle)),
    ]
    return track_of("lvms", [*half, *(segment.mirrored() for segment in reversed(half))], step=step)
