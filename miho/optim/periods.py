"""Parameters of a period, which brackets draw and challenges scan period by period.

The optimum of a period T is about T / n wide, relative to T, if the rows cover n periods. Most
optima along a range of T are therefore in a small part of it. Draws and scans that are uniform in n
reach all of them alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from miho.optim.oracle import Oracle
from miho.optim.space import Space
from miho.quantities import Array, Integers

GRID = np.linspace(0, 1, 513)
"""Places of a range at which angles are compared; formulas give them without an evaluation."""
TURNS = 0.0, 1 / 3, 2 / 3
"""Phases of a scan, in periods: one of them is at most 60 degrees from the right one."""
STEADY = 1e-6
"""A phase changes an angle's range by less than this number of periods."""


class Period(NamedTuple):
    """A parameter on which the period of an angle depends.

    `passed` (513,) is the number of periods by which the angle's range has changed up to each place
    of GRID. `phases` has the parameters that shift the same angle by position, with their shifts
    (513,) at these places, in periods.
    """

    passed: Array
    phases: Mapping[int, Array]

    @property
    def turns(self) -> tuple[float, ...]:
        """Phases to try: a single one if no parameter shifts the angle."""
        return TURNS if self.phases else TURNS[:1]

    def at(self, shares: Array) -> Array:
        """Places of the range at these shares of all periods, (n,)."""
        return np.asarray(np.interp(shares * self.passed[-1], self.passed, GRID))

    def turned(self, x: Array, turn: float) -> Array:
        """Points x (n, d) with phases shifted by `turn` periods, if that is in their ranges."""
        x = x.copy()
        for k, shift in self.phases.items():
            rising = shift if shift[-1] > shift[0] else -shift
            least, most = rising[0], rising[-1]
            wanted = least + (np.interp(x[:, k], GRID, rising) + turn - least) % 1
            x[:, k] = np.where(wanted <= most, np.interp(wanted, rising, GRID), x[:, k])
        return x


def periods_of(oracle: Oracle, space: Space, nonlinear: Integers) -> dict[int, Period]:
    """Parameters of a period by position; empty for a model without one.

    The other parameters have their values at the common start. An angle has at most as many periods
    as rows, because more are not distinct.
    """
    low, high = space.bounds
    start = (space.initial(1)[0] - low) / (high - low)
    if not oracle.traits.angles(space.decode(low + (high - low) * start[None])).size:
        return {}
    x = np.tile(start, (nonlinear.size, GRID.size, 1))
    x[np.arange(nonlinear.size), :, nonlinear] = GRID
    ends = oracle.traits.angles(space.decode(low + (high - low) * x.reshape(-1, start.size)))
    ends = np.nan_to_num(ends, posinf=0.0, neginf=0.0).reshape(-1, 2, *x.shape[:2])
    first, ranges = ends[:, 0], np.minimum(ends[:, 1] - ends[:, 0], oracle.traits.rows or np.inf)
    passed = np.abs(np.diff(ranges, prepend=ranges[..., :1])).cumsum(axis=-1)
    shifts = (passed[..., -1] < STEADY) & (np.ptp(first, axis=-1) >= TURNS[1])
    periods = {}
    for k, position in enumerate(nonlinear.tolist()):
        angle = int(passed[:, k, -1].argmax())
        if passed[angle, k, -1] > 1:
            phases = {int(nonlinear[j]): first[angle, j] for j in shifts[angle].nonzero()[0]}
            periods[position] = Period(passed[angle, k], phases)
    return periods
