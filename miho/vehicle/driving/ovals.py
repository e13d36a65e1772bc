"""The two ovals of the paper's field tests, from published data of their design."""

from __future__ import annotations

import math

from miho.vehicle.driving.segments import Segment, track_of
from miho.vehicle.driving.track import Track

_DEGREE = math.pi / 180


def ims(step: float = 1.0) -> Track:
    """Return the Indianapolis Motor Speedway (4023.36 m), from the middle of the front straight.

    The line is the measurement line of the 2.5 miles in drawings, with turns of 90 degrees and a
    radius of 256.135 m. In a survey (TUM), it is 0.7 m from the left edge of a road that is 15.2 m
    wide, and 18.3 m in the turns; `beside` gives driving lines. The bank is 9.2 degrees in the
    turns, with transitions of 160 m to the flat long straights, and 7 degrees on the short
    straights; the transitions and the bank of the short straights are from the survey.

    Parameters
    ----------
    step : float, optional
        Distance of the points [m].

    Returns
    -------
    Track
        The measurement line.
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


def lvms(step: float = 1.0, flat: bool = False) -> Track:
    """Return the Las Vegas Motor Speedway (2471 m), from the middle of the back straight.

    The turns have a radius of 234 m and a bank of 20 degrees, the back straight a bank of 6
    degrees, and the front a radius of 488.4 m and a bank of 9 degrees. Clothoids connect them, with
    changing bank; the road is 15 m wide. Radii and lengths are fitted to a survey (TUM), with a
    mean distance of 0.75 m.

    Parameters
    ----------
    step : float, optional
        Distance of the points [m].
    flat : bool, optional
        Whether the road has no bank, so that the tires limit the speed.

    Returns
    -------
    Track
        The middle of the road.
    """
    turn, front = 1 / 234.0, 1 / 488.4
    steep, back, middle = 20 * _DEGREE, 6 * _DEGREE, 9 * _DEGREE
    if flat:
        steep = back = middle = 0.0
    half = [
        Segment(length=163.75, bank=(back, back)),
        Segment(length=151.5, curvature=(0.0, turn), bank=(back, steep)),
        Segment(length=527.4, curvature=(turn, turn), bank=(steep, steep)),
        Segment(length=26.8, curvature=(turn, 0.0), bank=(steep, 0.725 * steep)),
        Segment(length=60.0, bank=(0.725 * steep, middle)),
        Segment(length=117.0, curvature=(0.0, front), bank=(middle, middle)),
        Segment(length=189.0, curvature=(front, front), bank=(middle, middle)),
    ]
    return track_of("lvms", [*half, *(segment.mirrored() for segment in reversed(half))], step=step)
