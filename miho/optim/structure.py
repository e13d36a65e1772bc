"""Whether residuals have structure that noise has not: a peak, a period, or a curve left over.

Where a search has missed a peak or a period, its residuals resemble their neighbours, or hold a
spectral line. For each input, and on a grid of each two inputs, this is tested in two ways: by the
sum of the residuals in a window, for windows of doubling sizes in all places; and by the largest
ordinate of the periodogram (Fisher, Proceedings of the Royal Society A 125, 1929). Residuals count
in units of their median size and up to CLIPPED of it, so that outliers make no structure. Where
they are larger than elsewhere along an input, the unit is their median size there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second
from numpy.typing import NDArray

from miho.quantities import Array

LEVEL = 1e-2
"""Noise that is alike in all rows shows as much structure with this probability at most: half of it
is for the windows, half for the lines, and each test has its share of that (Bonferroni). Windows
overlap, and are counted as four times as many as fit next to each other. Noise that grows or falls
by a factor of 50 along 300 rows passes for structure in 0 to 5 % of data sets: where it is small,
parameters that the large noise has moved leave residuals."""
CLIPPED = 3.0
"""Standard deviations of normal noise up to which a residual counts."""
FEWEST, MOST = 8, 20_000
"""The fewest rows that can show a structure, and the most that are tested: of longer data a sample,
which takes some 10 ms, and of many inputs 1 ms for each two."""
BLOCKS, FEWEST_IN_BLOCK = 4, 30
"""Blocks of rows, along an input, that fit next to each other, and rows of each at least: a peak is
narrower than a block, and counts little in its median."""
CHANCE = 6.0
"""The largest median of a block over the smallest is by chance up to exp(CHANCE / sqrt(rows))."""
FARTHEST = 300.0
"""Logarithms of spreads beyond, which numbers hardly have, are taken for this one."""
CELLS = 64
"""Cells of the grid of two inputs along each: a window of one cell is 1/64 of a range."""
SIDES = [2**k for k in range(6)]
BOXES = [(h, w) for h in SIDES for w in SIDES if h * w > 1 and 1 / 2 <= h / w <= 2]
"""Heights and widths of boxes of cells, of 2 to 1024 of the 4096."""
FEWEST_IN_BOX = 4
"""Rows whose clipped residuals add up to a number that is near enough to a normal one."""
MEDIAN_TO_DEVIATION = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

Order = NDArray[np.intp]
"""The rows (N,) in the order of an input."""


def has_structure(inputs: Sequence[Array], residuals: Array) -> bool:
    """Whether residuals (N,) have structure along their inputs, (N,) each, that noise has not."""
    sample = slice(None, None, -(-residuals.size // MOST))
    X = [x[sample] / 2 for x in inputs]  # the range of a half does not overflow
    spans = [np.ptp(x) for x in X]
    shares = [(x - x.min()) / span for x, span in zip(X, spans, strict=True) if span > 0]
    orders = [np.argsort(share, kind="stable") for share in shares]
    z = _standardised(residuals[sample], orders)
    if z.size < FEWEST or not z.any():
        return False
    tests = [_along(share, order, z) for share, order in zip(shares, orders, strict=True)]
    tests += [_across(a, b, z) for a, b in combinations(shares, 2)]
    windows = [window for found, _ in tests for window in found]
    lines = [line for _, line in tests]
    return any(
        min(found) <= math.log(LEVEL / 2 / len(found)) for found in (windows, lines) if found
    )


def _standardised(residuals: Array, orders: Sequence[Order]) -> Array:
    """Residuals (N,) in standard deviations of the bulk, clipped, with mean 0 and variance 1.

    Where their spread is larger along an input, whose order (N,) of rows is given, they count less.
    Where it is smaller, they do not count more: parameters that noise elsewhere has moved leave
    residuals there, which are no structure. So the variance is smaller there.
    """
    z = residuals - median(residuals)
    deviation = MEDIAN_TO_DEVIATION * median(np.abs(z))
    if not deviation > 0:
        z, orders = np.sign(z), ()
    else:
        z /= deviation
    expected = np.ones(z.size)
    for order in orders:
        spread = _spread(order, np.abs(z))
        z /= np.maximum(spread, 1.0)
        expected *= np.minimum(spread, 1.0) ** 2
    z = np.clip(z, -CLIPPED, CLIPPED)
    z -= z.mean()
    variance = float(z**2 @ expected / (expected @ expected))
    return z / math.sqrt(variance) if variance > 0 else z


def _spread(order: Order, sizes: Array) -> Array:
    """The standard deviation (N,) of residuals of these `sizes` (N,) along an input.

    Its logarithm is linear between the middles of overlapping blocks of rows, and beyond the first
    and the last. It is 1 everywhere if blocks differ no more than by chance.
    """
    N = sizes.size
    rows = max(N // BLOCKS, FEWEST_IN_BLOCK)
    if 3 * rows > 2 * N:
        return np.ones(N)
    first = np.linspace(0, N - rows, round(2 * N / rows) - 1).astype(int)
    ordered = sizes[order]
    medians = np.array([median(ordered[k : k + rows]) for k in first])
    if medians.max() <= math.exp(CHANCE / math.sqrt(rows)) * medians.min() or not medians.all():
        return np.ones(N)
    logs = np.log(MEDIAN_TO_DEVIATION * medians)
    logs = np.clip([2 * logs[0] - logs[1], *logs, 2 * logs[-1] - logs[-2]], -FARTHEST, FARTHEST)
    spread = np.empty(N)
    spread[order] = np.exp(np.interp(np.arange(N), [0.0, *(first + rows / 2), N], logs))
    return spread


def median(values: Array) -> float:
    """That of NumPy, which takes longer to find out that none of some numbers is NaN."""
    last = values.size // 2
    first = last - 1 + values.size % 2
    ordered = np.partition(values, (first, last))
    return float(ordered[first] + ordered[last]) / 2


def _along(share: Array, order: Order, z: Array) -> tuple[list[float], float]:
    """The tests along one input, given as shares (N,) of its range: of windows, and of lines."""
    N = z.size
    sums = np.concatenate([[0.0], np.cumsum(z[order])])
    windows, size = [], 2
    while size <= N // 4:
        largest = float(np.abs(sums[size:] - sums[:-size]).max())
        windows.append(_of_windows(largest / math.sqrt(size * (1 - size / N)), 4 * N / size))
        size *= 2
    # Up to N / 2 periods in the range, by steps of half a period, on a grid of cells that are half
    # as wide as rows are apart.
    cells = np.bincount(np.rint(share * (2 * N - 1)).astype(np.int64), z, 2 * N)
    return windows, _of_lines(np.abs(np.fft.rfft(cells, 4 * N)[1 : N + 1]) ** 2 / N)


def _across(a: Array, b: Array, z: Array) -> tuple[list[float], float]:
    """The tests on the grid of two inputs, given as shares (N,) of their ranges."""
    N = z.size
    cell = [np.minimum((share * CELLS).astype(np.int64), CELLS - 1) for share in (a, b)]
    flat = cell[0] * CELLS + cell[1]
    total = np.bincount(flat, z, CELLS**2).reshape(CELLS, CELLS)
    count = np.bincount(flat, minlength=CELLS**2).reshape(CELLS, CELLS).astype(float)
    totals, counts = _integral(total.astype(float)), _integral(count)
    windows = []
    for height, width in BOXES:
        held = _boxes(counts, height, width)
        full = held >= FEWEST_IN_BOX
        if full.any():
            sums = np.abs(_boxes(totals, height, width)[full])
            places = min(4 * CELLS**2 / (height * width), full.sum())
            windows.append(_of_windows(float((sums / np.sqrt(held[full])).max()), places))
    # Plane waves of up to as many periods as there are rows along each side of a square, by steps
    # of half a period.
    most = min(CELLS, int(2 * math.sqrt(N)))
    power = np.abs(np.fft.rfft2(total, (2 * CELLS, 2 * CELLS))) ** 2 / N
    power[0, 0] = 0.0
    waves = np.concatenate([power[: most + 1, : most + 1], power[-most + 1 :, : most + 1]])
    return windows, _of_lines(waves)


def _integral(cells: Array) -> Array:
    """The sums of all cells above and to the left, (n + 1, m + 1)."""
    return np.pad(cells.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))


def _boxes(sums: Array, height: int, width: int) -> Array:
    """The sums of the boxes of this size in all places, by the integral of the cells."""
    inner = sums[height:, width:] + sums[:-height, :-width]
    return np.asarray(inner - sums[height:, :-width] - sums[:-height, width:])


def _of_windows(largest: float, windows: float) -> float:
    """The logarithm of the probability that the largest of so many normal numbers is larger."""
    return float(math.log(2 * windows) + scipy.special.log_ndtr(-largest))


def _of_lines(power: NDArray[np.float64]) -> float:
    """The logarithm of the probability that the largest of exponential numbers is larger."""
    return float(math.log(power.size) - power.max())
