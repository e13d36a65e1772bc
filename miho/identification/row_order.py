"""The order in which a fidelity takes the rows: random, but soon over the whole range of inputs.

In a random order a parameter that only one row in a hundred determines is not determined by the
first rows: its derivatives are all but zero there. In this one, of the first m rows some sqrt(m)
cover the inputs' range in value, and the others are random: the mean over the first rows is off by
the weight of the covering rows, 1 / sqrt(m), which is no more than the chance in m random rows.

The covering rows of the inputs' bounding box are those of its two halves in turn, each of which is
shrunk to its rows and halved in the same way. A box is split at the middle of an input, not at its
median, so that a few rows far out are a half; of the inputs along which it is long, at the one
whose halves hold the most different numbers of rows. What determines a parameter without being far
out in an input, such as the first moments of a transient, is as rare here as it is at random.
`experiments.check.row_order` compares this order with others.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

Rows = NDArray[np.intp]

POOL = 300_000
"""Random rows among which covering ones are chosen: of rows one in 10,000 there are 30 in it."""
COVERING = 256
"""Covering rows at most: the first 65,536 rows hold all of them."""
RARE = 1 / 4
"""A half with a smaller share of its box's rows comes first; else chance decides."""
FEW = 8
"""A box with at most so many rows is not split."""
LONG = 1 / 8
"""A box is split along an input along which it has at least this much of its largest length."""


def row_order(inputs: Sequence[Array], rng: np.random.Generator) -> Rows:
    """A permutation (N,) of the rows of the input columns (N,), N at least 1: see this module.

    The k-th covering row, counted from 0, has place k^2.
    """
    order = rng.permutation(inputs[0].size)
    most = min(COVERING, math.isqrt(order.size - 1) + 1)
    covering = covering_rows(inputs, order, most, rng)
    return merged(order, covering, np.arange(covering.size) ** 2)


def covering_rows(
    inputs: Sequence[Array], order: Rows, most: int, rng: np.random.Generator
) -> Rows:
    """The `most` rows that come first in covering the inputs' range; `order` (N,) is random."""
    pool = order[:POOL]
    columns = [column for column in (_unit(column[pool]) for column in inputs) if column.any()]
    if len(columns) == 1:
        places = np.argsort(columns[0], kind="stable")
        line = _Line(columns[0][places].tolist(), places, rng)
        return pool[list(islice(line.covering(0, pool.size), most))]
    return np.fromiter(islice(_covering(columns, pool, rng), most), order.dtype)


def merged(order: Rows, covering: Rows, places: Rows) -> Rows:
    """`order` (N,) with the rows of `covering` (k,) at `places` (k,), which differ and are < N."""
    others = np.ones(order.size, dtype=bool)
    others[covering] = False
    rest = order[others[order]]
    others[:] = True
    others[places] = False
    merged = np.empty_like(order)
    merged[places], merged[others] = covering, rest
    return merged


def _unit(column: Array) -> Array:
    """The column moved and scaled to [0, 1]; zeros if it is constant."""
    low, high = column.min() / 2, column.max() / 2  # halves, whose difference is a number
    return (column / 2 - low) / (high - low) if high > low else np.zeros_like(column)


def _covering(columns: list[Array], rows: Rows, rng: np.random.Generator) -> Iterator[int]:
    """All rows (n,) of a box with these columns (n,) each, its two halves in turn."""
    split = _split(columns) if rows.size > FEW else None
    if split is None:
        yield from rows.tolist()
        return
    sides = [split, ~split]
    if _lower_first(np.count_nonzero(split) / rows.size, rng):
        sides.reverse()
    halves = []
    for (side,) in map(np.nonzero, sides):
        halves.append(_covering([column[side] for column in columns], rows[side], rng))
    del columns, rows, split, sides, side  # so that of a large pool each row is in memory once
    yield from _in_turn(halves)


class _Line(NamedTuple):
    """Boxes of one column, which are parts of its sorted values.

    `places` are those of the rows before they were sorted, at random.
    """

    values: list[float]
    places: Rows
    rng: np.random.Generator

    def covering(self, i: int, j: int) -> Iterator[int]:
        """The places of the rows i to j, those of their box's two halves in turn."""
        low, high = self.values[i], self.values[j - 1]
        if j - i <= FEW or not high > low:
            yield from sorted(self.places[i:j].tolist())
            return
        middle = low + (high - low) / 2
        cut = bisect_right(self.values, middle if middle < high else low, i, j)
        halves = [self.covering(cut, j), self.covering(i, cut)]
        if _lower_first((j - cut) / (j - i), self.rng):
            halves.reverse()
        yield from _in_turn(halves)


def _lower_first(upper: float, rng: np.random.Generator) -> bool:
    """Whether the lower half comes first, where the upper one has this share of the rows."""
    return bool(upper > 1 - RARE or (upper >= RARE and rng.random() < 0.5))


def _in_turn(halves: list[Iterator[int]]) -> Iterator[int]:
    """What the halves give, in turn."""
    while halves:
        for half in tuple(halves):
            row = next(half, None)
            if row is None:
                halves.remove(half)
            else:
                yield row


def _split(columns: list[Array]) -> NDArray[np.bool_] | None:
    """Which rows of a box are in its upper half; None for a box without any length."""
    lows = [float(np.minimum.reduce(column)) for column in columns]
    highs = [float(np.maximum.reduce(column)) for column in columns]
    longest = max((high - low for low, high in zip(lows, highs, strict=True)), default=0.0)
    if not longest > 0:
        return None
    splits: list[NDArray[np.bool_]] = []
    for column, low, high in zip(columns, lows, highs, strict=True):
        if high - low >= LONG * longest:
            middle = low + (high - low) / 2
            # Between two neighbouring floating-point numbers there is no middle: it rounds to high.
            splits.append(column > (middle if middle < high else low))
    imbalances = [abs(2 * np.count_nonzero(split) - split.size) for split in splits]
    return splits[int(np.argmax(imbalances))]
