"""What brackets of successive halving over rows of data need, whatever the step of a method is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from miho.optim.space import Parameter, Space
from miho.quantities import Array
from miho.validate import positive_settings, whole, whole_settings

KINDS = "own", "scale", "uniform"
DRAWS = "thirds", *KINDS
DECADES = 3
"""A range that reaches to zero is drawn over so many decades below its end."""


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


def levels(
    rows: int, d: int, *, per_parameter: float, eta: int, jump: float, enough: float = math.inf
) -> tuple[int, ...]:
    """How many of the first rows each level looks at: `eta` times those before, and in the end all.

    The first has `per_parameter` rows for each of d parameters. All rows follow on a level that
    has `enough` of them for each parameter, and where the next one would have more than the
    share `jump` of all.
    """
    ends = [min(rows, max(1, math.ceil(per_parameter * d)))]
    while ends[-1] < rows:
        further = eta * ends[-1]
        last = further > jump * rows or ends[-1] > enough * d
        ends.append(rows if last else further)
    return tuple(ends)


def draw_starts(
    space: Space, n: int, rng: np.random.Generator, first: bool, draws: str = "thirds"
) -> Array:
    """Starts of a bracket in search coordinates, (n, d); of the `first` one the common start leads.

    By the space's `own` distribution, which says where an answer is expected; by `scale` (see
    `by_scale`), for ranges that say no more than an order of magnitude; `uniform`ly; or in `thirds`
    of each.
    """
    low, high = space.bounds
    kinds = KINDS if draws == "thirds" else (draws,)
    starts, u = np.empty((n, len(space))), rng.random((n, len(space)))
    for k, kind in enumerate(kinds):
        of = slice(k, None, len(kinds))
        shares = u[of]
        if kind == "own":
            starts[of] = space.sample(len(shares), rng)
            continue
        if kind == "scale":
            columns = [by_scale(shares[:, i], p) for i, p in enumerate(space.parameters)]
            shares = np.stack(columns, axis=1)
        starts[of] = low + (high - low) * shares
    if first:
        starts[0] = space.initial(1)[0]
    return np.minimum(np.maximum(starts, low), high)


def by_scale(u: Array, parameter: Parameter) -> Array:
    """Shares u (n,) of a range, as shares of it that make the parameter's size even in logarithm.

    So on the linear scale where the range reaches to zero, to less than a tenth of its end or
    across: the last DECADES of each of its sides are as likely each, and both sides are. Other
    ranges stay as they are, and those on the log scale are even already.
    """
    low, high = parameter.low, parameter.high
    if parameter.scale == "log":
        return u
    if low < 0 < high:
        below = u < 0.5
        sizes = np.where(below, -_size(1 - 2 * u, 0.0, -low), _size(2 * u - 1, 0.0, high))
    elif 0 <= 10 * low < high:
        sizes = _size(u, low, high)
    elif low < 10 * high <= 0:
        sizes = -_size(1 - u, -high, -low)
    else:
        return u
    return np.asarray((sizes - low) / (high - low))


def _size(u: Array, low: float, high: float) -> Array:
    """Sizes that are even in logarithm, from low, or from the last DECADES, to high."""
    low = max(low, high * 10.0**-DECADES)
    return np.asarray(low * (high / low) ** np.clip(u, 0.0, 1.0))
