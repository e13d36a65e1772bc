"""Brackets of successive halving over rows of data: settings, sizes and starts.

What `MIHOGN` and `MIHOQN` share, whose descents differ in their steps.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from miho.optim.space import Parameter, Space
from miho.quantities import Array
from miho.validate import positive_settings, whole, whole_settings

KINDS = "own", "scale", "uniform"
TURNS = "thirds", "scale", "uniform", "own"
"""The distributions of one bracket after the other: brackets that draw from different ones miss
different basins, so that their agreement says more. The first hedges, by a third of each kind."""
DRAWS = "turns", "thirds", *KINDS
DECADES = 3, 6, 3, 12
"""A range that reaches to zero is drawn by scale over so many decades below its end, in the rounds
of TURNS in turn. Three are enough for bounds that somebody thought of; bounds that mean none, such
as 1e6 for a rate of 1, need more."""


def check_brackets(method: Any) -> None:
    """Raise ValueError unless the settings that all methods of such brackets have can be used."""
    whole("eta", method.eta, 2)
    whole_settings(method, ("least", "most", "steps", "lead", "brackets"), 1)
    positive_settings(
        method,
        ("rows", "jump", "enough", "base", "largest", "tolerance", "level_tolerance", "patience",
         "progress"),
    )  # fmt: skip
    if method.most < method.least:
        raise ValueError(f"most is {method.most}; expected at least {method.least}, which is least")


def luby(k: int) -> int:
    """The k-th of 1 1 2 1 1 2 4 ..., the universal sequence of restarts, for k = 1, 2, ...

    Whatever the best fixed length of a try is, tries of these lengths need no more than its
    logarithm times as much (Luby, Sinclair and Zuckerman, Information Processing Letters 47, 1993).
    """
    while True:
        digits = k.bit_length()
        if k == 2**digits - 1:
            return int(2 ** (digits - 1))
        k -= 2 ** (digits - 1) - 1


def rows_by_level(
    rows: int, d: int, *, per_parameter: float, eta: int, jump: float, enough: float = math.inf
) -> tuple[int, ...]:
    """How many of the first rows each level looks at: `eta` times those before, the last at all.

    The first has `per_parameter` rows for each of d parameters. The last follows on a level with
    more than `enough` rows for each parameter, or where the next one would have more than the share
    `jump` of all.
    """
    level_rows = [min(rows, max(1, math.ceil(per_parameter * d)))]
    while level_rows[-1] < rows:
        larger = eta * level_rows[-1]
        last = larger > jump * rows or level_rows[-1] > enough * d
        level_rows.append(rows if last else larger)
    return tuple(level_rows)


def draw_starts(
    space: Space, n: int, rng: np.random.Generator, bracket: int, draws: str = "turns"
) -> Array:
    """Starts of a bracket in search coordinates, (n, d), led in the first by the common one.

    `bracket` counts from 1. `draws` is the distribution: the space's `own`, which says where an
    answer is expected; `scale` (see `by_scale`), for ranges that say no more than an order of
    magnitude; `uniform`; `thirds` for each of them in turn; or `turns` for that of TURNS whose turn
    it is.
    """
    low, high = space.bounds
    turn, place = divmod(bracket - 1, len(TURNS))
    if draws == "turns":
        draws = TURNS[place]
    u = rng.random((n, len(space)))

    def drawn(kind: str, shares: Array) -> Array:
        if kind == "own":
            return space.sample(len(shares), rng)
        if kind == "scale":
            shares = by_scale(shares, space, DECADES[turn % len(DECADES)])
        return np.minimum(np.maximum(low + (high - low) * shares, low), high)

    if draws == "thirds":
        starts = np.empty_like(u)
        for k, kind in enumerate(KINDS):
            starts[k :: len(KINDS)] = drawn(kind, u[k :: len(KINDS)])
    else:
        starts = drawn(draws, u)
    if bracket == 1:
        starts[0] = space.initial(1)[0]
    return starts


def around(best: Array, starts: Array, rng: np.random.Generator) -> Array:
    """Starts (n, d) that keep about half of the coordinates of the best minimum (d,), but not all.

    Which ones is drawn for each start. A minimum that has missed a peak or a period has the others
    right: from there, the one that is missed is not far.
    """
    redrawn = rng.random(starts.shape) < 0.5
    one = rng.integers(starts.shape[1], size=len(starts))
    redrawn[np.arange(len(starts)), one] = True
    return np.where(redrawn, starts, best)


def by_scale(u: Array, space: Space, decades: int = 3) -> Array:
    """Uniform shares u (n, d) of the ranges as shares whose sizes are log-uniform.

    That is for parameters on the linear scale whose range spans zero, or more than a decade next to
    it: sizes are then drawn from the last `decades` below each end, and both signs are equally
    likely. Shares of any other range are given back as they are; so are those on the log scale,
    which are log-uniform already.
    """
    if decades not in space.scales:
        space.scales[decades] = np.array([_scale(p, decades) for p in space.parameters]).T
    scaled, negative_below, offset, slope, low, width, *ends = space.scales[decades]
    negative = u < negative_below
    near, ratio = np.where(negative, ends[0], ends[1]), np.where(negative, ends[2], ends[3])
    shares = (near * ratio ** np.abs(offset + slope * u) - low) / width
    return shares if scaled.all() else np.where(scaled > 0, shares, u)


def _scale(parameter: Parameter, decades: int) -> tuple[float, ...]:
    """How `by_scale` draws a parameter: whether it does; the share below which values are negative;
    offset and slope of the share of the decades over that of the range; where the range begins, and
    its width; the values nearest to zero, the negative one first, and the ratios of the farthest
    ones to them.
    """
    low, high = parameter.low, parameter.high
    least = 10.0**-decades
    range_ = low, high - low
    smallest = max(-high, -low * least), max(low, high * least)
    if parameter.scale != "log" and low < 0 < high:
        ratios = low / -smallest[0], high / smallest[1]
        return 1.0, 0.5, -1.0, 2.0, *range_, -smallest[0], smallest[1], *ratios
    if parameter.scale != "log" and high <= 0 and low < 10 * high:
        return 1.0, math.inf, 1.0, -1.0, *range_, -smallest[0], 1.0, low / -smallest[0], 1.0
    if parameter.scale != "log" and low >= 0 and 10 * low < high:
        return 1.0, -math.inf, 0.0, 1.0, *range_, 1.0, smallest[1], 1.0, high / smallest[1]
    return 0.0, -math.inf, 0.0, 1.0, *range_, 1.0, 1.0, 1.0, 1.0
