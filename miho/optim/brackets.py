"""Brackets of successive halving over rows of data: settings, sizes and starts.

Shared by `MIHOGN` and `MIHOQN`, which differ in the steps of their descents.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from miho.optim.space import Parameter, Space
from miho.quantities import Array, Integers
from miho.validate import positive_settings, whole, whole_settings

if TYPE_CHECKING:
    from miho.optim.periods import Period

KINDS = "own", "scale", "uniform"
TURNS = "thirds", "scale", "uniform", "own"
"""Distributions of consecutive brackets. Brackets with different distributions miss different
basins, so that their agreement is stronger evidence. The first bracket draws a third from each
kind."""
DRAWS = "turns", "thirds", *KINDS
DECADES = 3, 6, 3, 12
"""Decades below the end of a range that reaches zero, for draws by scale, in the rounds of TURNS in
turn. Three are enough for well-chosen bounds; nominal bounds, for example 1e6 for a rate of 1, need
more."""


@dataclass(frozen=True)
class Brackets:
    """Settings of brackets, and the sizes that follow from them; see `MIHOGN`."""

    eta: int = 3
    rows_per_parameter: float = 4.0
    full_data_share: float = 0.5
    max_rows_per_parameter: float = 200.0
    base_cost: float = 0.5
    max_cost: float = 32.0
    min_candidates: int = 3
    max_candidates: int = 243
    steps_per_rung: int = 3
    leader_steps: int = 20
    max_step: float = 0.25
    tolerance: float = 1e-8
    level_tolerance: float = 0.1
    patience: float = 4.0
    min_progress: float = 0.05
    max_brackets: int = 200

    def rows_by_level(self, rows: int, d: int) -> tuple[int, ...]:
        """Number of first rows of each level: `eta` times the previous level's, at last all."""
        level_rows = [min(rows, max(1, math.ceil(self.rows_per_parameter * d)))]
        while level_rows[-1] < rows:
            larger, enough = self.eta * level_rows[-1], self.max_rows_per_parameter * d
            last = larger > self.full_data_share * rows or level_rows[-1] > enough
            level_rows.append(rows if last else larger)
        return tuple(level_rows)

    def sizes(self, bracket: int, d: int, look_cost: float) -> tuple[float, int]:
        """Evaluations of a rung, and starts of a bracket whose first evaluations cost `look_cost`.

        `bracket` counts from 1.
        """
        budget = float((d + 1) * min(self.base_cost * luby(bracket), self.max_cost))
        n = min(max(round(budget / look_cost), self.min_candidates), self.max_candidates)
        return budget, n


def check_brackets(settings: Brackets) -> None:
    """Raise ValueError if a setting of brackets is not possible."""
    whole("eta", settings.eta, 2)
    whole_settings(
        settings,
        ("min_candidates", "max_candidates", "steps_per_rung", "leader_steps", "max_brackets"),
        1,
    )
    positive_settings(
        settings,
        (
            "rows_per_parameter", "full_data_share", "max_rows_per_parameter", "base_cost",
            "max_cost", "max_step", "tolerance", "level_tolerance", "patience", "min_progress",
        ),
    )  # fmt: skip
    if settings.max_candidates < settings.min_candidates:
        raise ValueError(
            f"max_candidates is {settings.max_candidates}; expected at least min_candidates, "
            f"{settings.min_candidates}"
        )


def luby(k: int) -> int:
    """Element k = 1, 2, ... of 1 1 2 1 1 2 4 ..., the universal sequence of restarts [1]_.

    Tries of these lengths need at most a logarithmic factor more than the best fixed length.

    References
    ----------
    .. [1] M. Luby, A. Sinclair, D. Zuckerman, "Optimal speedup of Las Vegas algorithms",
       Information Processing Letters 47 (1993) 173-180.
    """
    while True:
        digits = k.bit_length()
        if k == 2**digits - 1:
            return int(2 ** (digits - 1))
        k -= 2 ** (digits - 1) - 1


def draw_starts(
    space: Space,
    n: int,
    rng: np.random.Generator,
    bracket: int,
    draws: str = "turns",
    periods: Mapping[int, Period] | None = None,
) -> Array:
    """Starts of a bracket in search coordinates, (n, d).

    `bracket` counts from 1; the first bracket begins with the common start. `draws` is the
    distribution: "own" is the initial distribution of the space; "scale" is log-uniform in size
    (see `by_scale`), for ranges that are only an order of magnitude; "uniform" fills the bounds,
    and its parameters in `periods` are uniform in the number of periods; "thirds" uses each of them
    in turn; "turns" chooses from TURNS by the number of the bracket.
    """
    low, high = space.bounds
    turn, place = divmod(bracket - 1, len(TURNS))
    if draws == "turns":
        draws = TURNS[place]
    u = rng.random((n, len(space)))

    def draw(kind: str, shares: Array) -> Array:
        if kind == "own":
            return space.quantiles(rng.random(shares.shape))
        if kind == "scale":
            shares = by_scale(shares, space, DECADES[turn % len(DECADES)])
        return np.minimum(np.maximum(low + (high - low) * shares, low), high)

    if draws == "thirds":
        starts = np.empty_like(u)
        for k, kind in enumerate(KINDS):
            starts[k :: len(KINDS)] = draw(kind, u[k :: len(KINDS)])
    else:
        if draws == "uniform":
            for k, period in (periods or {}).items():
                u[:, k] = period.at(u[:, k])
        starts = draw(draws, u)
    if bracket == 1:
        starts[0] = space.initial(1)[0]
    return starts


def around(best: Array, starts: Array, rng: np.random.Generator) -> Array:
    """Starts (n, d) with about half of the coordinates of the best minimum (d,), but not all.

    The coordinates are drawn for each start. A minimum that has missed one peak or period has the
    others right, and the missing one is near such a start.
    """
    redrawn = rng.random(starts.shape) < 0.5
    always = rng.integers(starts.shape[1], size=len(starts))
    redrawn[np.arange(len(starts)), always] = True
    return np.where(redrawn, starts, best)


def alike(space: Space, nonlinear: Integers) -> list[list[int]]:
    """Positions of nonlinear parameters with similar bounds, such as the widths of two peaks.

    Empty unless there are two such groups: a single value is as easily drawn anew as exchanged.
    """
    groups: list[list[int]] = []
    for k in nonlinear.tolist():
        similar = [g for g in groups if _similar(space.parameters[g[0]], space.parameters[k])]
        if similar:
            similar[0].append(k)
        else:
            groups.append([k])
    several = [group for group in groups if len(group) > 1]
    return several if len(several) > 1 else []


def _similar(a: Parameter, b: Parameter) -> bool:
    """Whether units and scales are equal, and ranges share more than half of their union."""
    shared = min(a.high, b.high) - max(a.low, b.low)
    union = max(a.high, b.high) - min(a.low, b.low)
    return (a.unit, a.scale) == (b.unit, b.scale) and shared > union / 2


def by_scale(u: Array, space: Space, decades: int = 3) -> Array:
    """Convert uniform shares u (n, d) of the ranges to shares whose sizes are log-uniform.

    This applies to parameters on the linear scale whose range contains zero, or covers more than a
    decade. Sizes are then drawn from the last `decades` below each end, with equal probabilities of
    both signs. Shares of other ranges stay the same, as on the log scale, which is log-uniform
    already.
    """
    if decades not in space.scales:
        space.scales[decades] = tuple(np.array([_scale(p, decades) for p in space.parameters]).T)
    scaled, negative_below, offset, slope, low, width, *ends = space.scales[decades]
    negative = u < negative_below
    near, ratio = np.where(negative, ends[0], ends[1]), np.where(negative, ends[2], ends[3])
    shares = slope * u  # in place: a batch is small, and each new array takes time
    shares += offset
    np.power(ratio, np.abs(shares, out=shares), out=shares)
    shares *= near
    shares -= low
    shares /= width
    return shares if scaled.all() else np.where(scaled > 0, shares, u)


def _scale(parameter: Parameter, decades: int) -> tuple[float, ...]:
    """Constants of `by_scale` for a parameter.

    They are: whether it is drawn by scale; the share below which values are negative; offset and
    slope of the share of the decades over the share of the range; the lower bound and the width;
    the values nearest to zero, the negative one first; and the ratios of the farthest values to
    them.
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
