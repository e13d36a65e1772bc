"""Test whether residuals have a structure that noise lacks: a peak, a period or a trend.

If a search has missed a peak or a period, its residuals resemble their neighbours or contain a
spectral line. Two statistics test this along each input and on a grid of each pair of inputs: the
largest sum of residuals in a window, for windows of doubling sizes at all positions; and the
largest ordinate of the periodogram [1]_.

References
----------
.. [1] R. A. Fisher, "Tests of significance in harmonic analysis", Proceedings of the Royal Society
   A 125 (1929) 54-59.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import scipy  # loads its packages at their first use; importing them here takes a second
from numpy.typing import NDArray

from miho.quantities import Array

LEVEL = 1e-2
"""Largest probability that noise of equal size in all rows counts as structure: half of it for
windows, half for lines, divided among the tests (Bonferroni). Windows overlap, and count as four
times the number that fits side by side."""
CLIPPED = 3.0
"""Largest size of a residual, in standard deviations of normal noise; outliers are no structure."""
FEWEST, MOST = 8, 20_000
"""Smallest number of rows that can show a structure, and largest number that is tested. Longer data
are sampled; a test then takes some 10 ms, and 1 ms for each pair of inputs."""
BLOCKS, FEWEST_IN_BLOCK = 4, 30
"""Blocks of rows along an input that fit side by side, and smallest number of rows of each: a peak
is narrower than a block and hardly changes its median."""
CHANCE = 6.0
"""By chance the ratio of the largest and the smallest median of blocks reaches exp(CHANCE /
sqrt(rows))."""
FARTHEST = 300.0
"""Largest logarithm of a spread; real data do not reach it."""
MEDIAN_TO_DEVIATION = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
CELLS = 64
"""Cells of the grid along each of two inputs: a window of one cell is 1/64 of a range."""
SIDES = [2**k for k in range(6)]
BOXES = [(h, w) for h in SIDES for w in SIDES if h * w > 1 and 1 / 2 <= h / w <= 2]
"""Heights and widths of boxes of cells, of 2 to 1024 of the 4096."""
FEWEST_IN_BOX = 4
"""Number of rows whose clipped residuals have a nearly normal sum."""

Order = NDArray[np.intp]
"""Rows (N,) in the order of an input."""


def has_structure(
    inputs: Sequence[Array],
    residuals: Array,
    order: Order | None = None,
    parts: Array | None = None,
) -> bool:
    """Whether residuals (N,) have a structure along the inputs, (rows,) each, that noise lacks.

    The residuals belong to the first rows in this order. Residuals of priors come after all rows
    and are left out. Each of several `parts` (rows,) of a joint fit is also tested alone.
    """
    places = np.arange(residuals.size) if order is None else order[: residuals.size]
    data = places < inputs[0].size
    inputs, residuals = [x[places[data]] for x in inputs], residuals[data]
    tests = _tests(inputs, residuals)
    if parts is not None:
        own = parts[places[data]]
        for rows in (own == part for part in np.unique(own)):
            tests += _tests([x[rows] for x in inputs], residuals[rows])
    windows = [window for of_test, _ in tests for window in of_test]
    lines = [line for _, line in tests]
    return any(min(logs) <= math.log(LEVEL / 2 / len(logs)) for logs in (windows, lines) if logs)


def _tests(inputs: Sequence[Array], residuals: Array) -> list[tuple[list[float], float]]:
    """Log probabilities of windows and lines along each input and on grids of two, for each."""
    sample = slice(None, None, -(-residuals.size // MOST))
    X = [x[sample] / 2 for x in inputs]  # the range of a half does not overflow
    spans = [np.ptp(x) for x in X]
    shares = [(x - x.min()) / span for x, span in zip(X, spans, strict=True) if span > 0]
    orders = [np.argsort(share, kind="stable") for share in shares]
    z = _standardised(residuals[sample], orders)
    if z.size < FEWEST or not z.any():
        return []
    tests = [_along(share, order, z) for share, order in zip(shares, orders, strict=True)]
    return tests + [_across(a, b, z) for a, b in combinations(shares, 2)]


def _standardised(residuals: Array, orders: Sequence[Order]) -> Array:
    """Residuals (N,) in standard deviations of the bulk, clipped, with mean 0 and variance 1.

    Residuals count less if their spread along an input, given by an order (N,) of rows, is larger
    there. A smaller spread does not increase their weight: parameters moved by noise elsewhere
    leave residuals there that are no structure. So the variance is smaller there.
    """
    z = residuals - median(residuals)
    deviation = MEDIAN_TO_DEVIATION * float(median(np.abs(z)))
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
    """Standard deviation (N,) along an input of residuals with these `sizes` (N,).

    Its logarithm is linear between the middles of overlapping blocks of rows, and beyond the first
    and the last. It is 1 everywhere if blocks differ by no more than chance.
    """
    N = sizes.size
    rows = max(N // BLOCKS, FEWEST_IN_BLOCK)
    if 3 * rows > 2 * N:
        return np.ones(N)
    first = np.linspace(0, N - rows, round(2 * N / rows) - 1).astype(int)
    ordered = sizes[order]
    blocks = ordered[first[:, None] + np.arange(rows)]
    medians = median(blocks)
    if medians.max() <= math.exp(CHANCE / math.sqrt(rows)) * medians.min() or not medians.all():
        return np.ones(N)
    logs = np.log(MEDIAN_TO_DEVIATION * medians)
    logs = np.clip([2 * logs[0] - logs[1], *logs, 2 * logs[-1] - logs[-2]], -FARTHEST, FARTHEST)
    spread = np.empty(N)
    spread[order] = np.exp(np.interp(np.arange(N), [0.0, *(first + rows / 2), N], logs))
    return spread


def median(values: Array) -> Array:
    """Median over the last axis; NumPy's is slower because it checks for NaN."""
    rows = values.shape[-1]
    last = rows // 2
    first = last - 1 + rows % 2
    ordered = np.partition(values, (first, last))
    return (ordered[..., first] + ordered[..., last]) / 2


def _along(share: Array, order: Order, z: Array) -> tuple[list[float], float]:
    """Log probabilities of windows and lines along one input, in shares (N,) of its range."""
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
    """Log probabilities on the grid of two inputs, in shares (N,) of their ranges."""
    N = z.size
    cell = [np.minimum((share * CELLS).astype(np.int64), CELLS - 1) for share in (a, b)]
    flat = cell[0] * CELLS + cell[1]
    total = np.bincount(flat, z, CELLS**2).reshape(CELLS, CELLS)
    count = np.bincount(flat, minlength=CELLS**2).reshape(CELLS, CELLS).astype(float)
    totals, counts = _integral(total.astype(float)), _integral(count)
    windows = []
    for height, width in BOXES:
        inside = _boxes(counts, height, width)
        full = inside >= FEWEST_IN_BOX
        if full.any():
            sums = np.abs(_boxes(totals, height, width)[full])
            places = min(4 * CELLS**2 / (height * width), full.sum())
            windows.append(_of_windows(float((sums / np.sqrt(inside[full])).max()), places))
    # Plane waves of up to as many periods as there are rows along each side of a square, by steps
    # of half a period.
    most = min(CELLS, int(2 * math.sqrt(N)))
    power = np.abs(np.fft.rfft2(total, (2 * CELLS, 2 * CELLS))) ** 2 / N
    power[0, 0] = 0.0
    waves = np.concatenate([power[: most + 1, : most + 1], power[-most + 1 :, : most + 1]])
    return windows, _of_lines(waves)


def _integral(cells: Array) -> Array:
    """Sums of all cells above and to the left, (n + 1, m + 1)."""
    return np.pad(cells.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))


def _boxes(sums: Array, height: int, width: int) -> Array:
    """Sums of the boxes of this size at all positions, from the integral of the cells."""
    inner = sums[height:, width:] + sums[:-height, :-width]
    return np.asarray(inner - sums[height:, :-width] - sums[:-height, width:])


def _of_windows(largest: float, windows: float) -> float:
    """Log probability that the largest of this number of normal variables is larger."""
    return float(math.log(2 * windows) + scipy.special.log_ndtr(-largest))


def _of_lines(power: NDArray[np.float64]) -> float:
    """Log probability that the largest of exponential variables is larger."""
    return float(math.log(power.size) - power.max())
