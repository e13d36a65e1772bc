"""The order of rows for fidelities: random, with early rows that cover the range of the inputs.

If only one row in a hundred determines a parameter, the first rows of a random order hardly
determine it. In this order, about sqrt(m) of the first m rows cover the range of the inputs, and
the others are random. The covering rows have the weight 1 / sqrt(m) in the mean over the first m
rows, so the bias of the mean is no larger than its random error.

Covering rows come from the two halves of the bounding box of the inputs in turn. Each half shrinks
to its rows and is halved in the same way. A box is split at the middle of an input, not at the
median, so that a few remote rows form a half. Among the inputs along which the box is long, the
split uses the one whose halves differ most in their numbers of rows. Rows that determine a
parameter without an extreme input, for example at the beginning of a transient, are as rare as in
a random order.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

Rows = NDArray[np.intp]

POOL = 300_000
"""Number of random rows to choose covering rows from; 30 of them for 1 row in 10,000."""
COVERING = 256
"""Largest number of covering rows: the first 65,536 rows contain all of them."""
RARE = 1 / 4
"""A half with a smaller share of the rows of its box comes first; else chance decides."""
FEW = 8
"""A box with at most this many rows is not split."""
LONG = 1 / 8
"""A box is split along inputs in which it has at least this fraction of its largest length."""


def row_order(inputs: Sequence[Array], rng: np.random.Generator) -> Rows:
    """A permutation (N,) of the rows of input columns (N,), N at least 1, as the module describes.

    The k-th covering row, counted from 0, has place k^2.
    """
    order = rng.permutation(inputs[0].size)
    most = min(COVERING, math.isqrt(order.size - 1) + 1)
    pool, chances = order[:POOL], _uniform(rng)
    columns = [column for column in (_unit(column[pool]) for column in inputs) if column.any()]
    if len(columns) == 1:
        places = np.argsort(columns[0], kind="stable")
        line = _on_line(columns[0][places].tolist(), places, chances, 0, pool.size)
        covering = pool[list(islice(line, most))]
    else:
        covering = np.fromiter(islice(_covering(columns, pool, chances), most), order.dtype)
    return merged(order, covering, np.arange(covering.size) ** 2)


def merged(order: Rows, covering: Rows, places: Rows) -> Rows:
    """`order` (N,) with rows `covering` (k,) at distinct `places` (k,) below N."""
    others = np.ones(order.size, dtype=bool)
    others[covering] = False
    rest = order[others[order]]
    others[:] = True
    others[places] = False
    merged = np.empty_like(order)
    merged[places], merged[others] = covering, rest
    return merged


def _unit(column: Array) -> Array:
    """The column scaled to [0, 1]; zeros if it is constant."""
    low, high = column.min() / 2, column.max() / 2  # the difference of halves does not overflow
    return (column / 2 - low) / (high - low) if high > low else np.zeros_like(column)


def _covering(columns: list[Array], rows: Rows, chances: Iterator[float]) -> Iterator[int]:
    """All rows (n,) of a box with columns (n,) each, from its two halves in turn."""
    split = _split(columns) if rows.size > FEW else None
    if split is None:
        yield from rows.tolist()
        return
    sides = [split, ~split]
    if _lower_first(np.count_nonzero(split) / rows.size, chances):
        sides.reverse()
    halves = []
    for (side,) in map(np.nonzero, sides):
        halves.append(_covering([column[side] for column in columns], rows[side], chances))
    del columns, rows, split, sides, side  # keep one copy of a large pool in memory
    while (row := next(halves[0], None)) is not None:
        yield row
        halves.reverse()
    yield from halves[1]


def _on_line(
    values: list[float], places: Rows, chances: Iterator[float], i: int, j: int
) -> Iterator[int]:
    """The `places` (N,) of sorted values i to j, from both halves of their box in turn."""
    low, high = values[i], values[j - 1]
    if j - i <= FEW or not high > low:
        yield from sorted(places[i:j].tolist())
        return
    middle = low + (high - low) / 2
    cut = bisect_right(values, middle if middle < high else low, i, j)
    half = _on_line(values, places, chances, cut, j)
    other = _on_line(values, places, chances, i, cut)
    if _lower_first((j - cut) / (j - i), chances):
        half, other = other, half
    while (row := next(half, None)) is not None:
        yield row
        half, other = other, half
    yield from other


def _uniform(rng: np.random.Generator) -> Iterator[float]:
    """Random numbers, drawn many at a time."""
    while True:
        yield from rng.random(COVERING).tolist()


def _lower_first(upper: float, chances: Iterator[float]) -> bool:
    """Whether the lower half comes first, if the upper half has this share of the rows."""
    return upper > 1 - RARE or (upper >= RARE and next(chances) < 0.5)


def _split(columns: list[Array]) -> NDArray[np.bool_] | None:
    """Marks of the rows in the upper half of a box; None for a box of zero length."""
    lows = [float(np.minimum.reduce(column)) for column in columns]
    highs = [float(np.maximum.reduce(column)) for column in columns]
    longest = max((high - low for low, high in zip(lows, highs, strict=True)), default=0.0)
    if not longest > 0:
        return None
    splits: list[NDArray[np.bool_]] = []
    for column, low, high in zip(columns, lows, highs, strict=True):
        if high - low >= LONG * longest:
            middle = low + (high - low) / 2
            # The middle of two neighbouring floating-point numbers rounds to high.
            splits.append(column > (middle if middle < high else low))
    imbalances = [abs(2 * np.count_nonzero(split) - split.size) for split in splits]
    return splits[int(np.argmax(imbalances))]
