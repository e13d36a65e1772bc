"""Tracks from straights, arcs and clothoids, as in road design."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array
from miho.validate import positive
from miho.vehicle.driving.track import Track

PIECE = 20.0
"""Length [m] of a Gauss rule, for an error below 1e-12 m."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A part of a track with a curvature that is linear in the arc length.

    Curvature, bank and width are given at start and end. The curvature is positive to the left,
    equal on arcs and 0 on straights. Bank and width have zero slope at both ends.
    """

    length: float  # [m]
    curvature: tuple[float, float] = (0.0, 0.0)  # [1/m]
    bank: tuple[float, float] = (0.0, 0.0)  # [rad], positive if the left side is lower
    width: tuple[float, float] = (15.0, 15.0)  # of the whole road [m]

    def __post_init__(self) -> None:
        positive("length of a segment", self.length)
        for field in fields(self)[1:]:
            pair = getattr(self, field.name)
            if len(pair) != 2 or not all(map(math.isfinite, pair)):
                raise ValueError(
                    f"{field.name} of a segment is {pair}; expected two numbers, start and end"
                )

    def mirrored(self) -> Segment:
        """Return the segment in reverse order, with the same sign of the curvature."""
        return replace(
            self,
            curvature=self.curvature[::-1], bank=self.bank[::-1], width=self.width[::-1],
        )  # fmt: skip


def track_of(
    name: str,
    segments: Sequence[Segment],
    *,
    step: float = 1.0,
    left: float | None = None,
    slack: float = 1.0,
) -> Track:
    """Return the closed track of successive segments.

    The points have the distance `step` [m], reduced to divide the lap. The line has the distance
    `left` [m] from the left edge of the road, by default half the width.

    Rounded lengths leave a gap. The lengths are changed by the least sum of squares that closes it.
    Raises ValueError if changes by up to `slack` [m] do not close it.
    """
    positive("step", step, "of metres")
    closed = _closed(name, list(segments), slack)
    length = sum(segment.length for segment in closed)
    n = math.ceil(length / step)
    s = np.linspace(0.0, length, n, endpoint=False)
    pieces = [piece for segment in closed for piece in _cut(segment)]
    which, within = _position(s, pieces)
    x, y, heading, curvature = _advance(_poses(pieces)[which], pieces, which, within)
    which, within = _position(s, closed)
    share = within / np.array([segment.length for segment in closed])[which]
    smooth = share * share * (3 - 2 * share)
    bank, width = (
        _between(np.array([getattr(segment, key) for segment in closed])[which], smooth)
        for key in ("bank", "width")
    )
    beside = width / 2 if left is None else np.full_like(width, left)
    return Track(name, length, s, x, y, heading, curvature, bank, beside, width - beside)


def _between(pairs: Array, share: Array) -> Array:
    return np.asarray(pairs[:, 0] + share * (pairs[:, 1] - pairs[:, 0]))


def _closed(name: str, segments: list[Segment], slack: float) -> list[Segment]:
    """Return the segments with lengths that close the track, by Gauss-Newton iterations."""
    turn = sum(sum(segment.curvature) * segment.length for segment in segments)
    whole = math.tau if turn > 0 else -math.tau
    lengths = np.array([segment.length for segment in segments])
    corrected = lengths.copy()
    for _ in range(10):
        trial = [replace(o, length=float(f)) for o, f in zip(segments, corrected, strict=True)]
        miss = _poses(trial)[-1] - np.array([0.0, 0.0, whole])
        if np.abs(miss).max() < 1e-10:
            return trial
        ends = _poses(trial)[1:]
        moved = np.array(
            [_effect(end, ends[-1], part) for end, part in zip(ends, trial, strict=True)]
        )
        corrected = corrected - np.linalg.lstsq(moved.T, miss, rcond=None)[0]
        if np.abs(corrected - lengths).max() > slack or corrected.min() <= 0:
            break
    gap = _poses(segments)[-1]
    raise ValueError(
        f"track {name} does not close: its end is {math.hypot(gap[0], gap[1]):.3g} m from its "
        f"start after a turn of {math.degrees(gap[2]):.5g} degrees; changes of the lengths by up "
        f"to {slack:g} m do not close it; correct the segments"
    )


def _effect(end: Array, last: Array, segment: Segment) -> Array:
    """Return the derivative of the last pose by the length of a segment that ends at `end`.

    A longer segment moves all later segments in its direction, and turns them about its end by its
    mean curvature. The change of shape of a clothoid is neglected; the iterations correct for it.
    """
    bend = sum(segment.curvature) / 2
    x, y = last[0] - end[0], last[1] - end[1]
    return np.array([math.cos(end[2]) - bend * y, math.sin(end[2]) + bend * x, bend])


def _cut(segment: Segment) -> list[Segment]:
    """Cut a segment into parts of equal length, at most `PIECE`, with the curvature only."""
    count = math.ceil(segment.length / PIECE)
    ends = np.linspace(*segment.curvature, count + 1).tolist()
    length = segment.length / count
    return [Segment(length=length, curvature=pair) for pair in pairwise(ends)]


def _position(s: Array, segments: Sequence[Segment]) -> tuple[NDArray[np.intp], Array]:
    """Return the segment of each arc length (n,), and the distance from its start [m]."""
    bounds = np.concatenate([[0.0], np.cumsum([segment.length for segment in segments])])
    which = np.clip(np.searchsorted(bounds, s, side="right") - 1, 0, len(segments) - 1)
    return which, s - bounds[which]


def _poses(segments: Sequence[Segment]) -> Array:
    """Return (x, y, heading) at the start of each segment and the last end, (k + 1, 3)."""
    lengths = np.array([segment.length for segment in segments])
    turned = lengths * np.array([sum(segment.curvature) / 2 for segment in segments])
    starts = np.zeros((len(segments), 3))
    starts[1:, 2] = np.cumsum(turned)[:-1]
    steps = np.stack(_advance(starts, segments, np.arange(len(segments)), lengths)[:2], axis=1)
    ends = np.column_stack([np.cumsum(steps, axis=0), np.cumsum(turned)])
    return np.concatenate([np.zeros((1, 3)), ends])


def _advance(
    poses: Array, segments: Sequence[Segment], which: NDArray[np.intp], within: Array
) -> tuple[Array, Array, Array, Array]:
    """Return x, y, heading and curvature (n,) at distances `within` (n,) from `poses` (n, 3)."""
    pairs = np.array([segment.curvature for segment in segments])[which]
    lengths = np.array([segment.length for segment in segments])
    slope = (pairs[:, 1] - pairs[:, 0]) / lengths[which]
    rules = math.ceil(lengths.max() / PIECE)
    edges = np.arange(rules)[:, None] + (_NODES + 1) / 2
    t = within[:, None] * edges.ravel() / rules
    turned = poses[:, 2, None] + (pairs[:, :1] + slope[:, None] * t / 2) * t
    weights = np.tile(_WEIGHTS / 2, rules) / rules
    x = poses[:, 0] + within * (np.cos(turned) @ weights)
    y = poses[:, 1] + within * (np.sin(turned) @ weights)
    heading = poses[:, 2] + (pairs[:, 0] + slope * within / 2) * within
    return x, y, heading, pairs[:, 0] + slope * within
