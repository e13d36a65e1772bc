"""Structure of residuals on a grid of two inputs, for `miho.optim.structure`."""

from __future__ import annotations

import math

import numpy as np

from miho.optim.structure import of_lines, of_windows
from miho.quantities import Array

CELLS = 64
"""Cells of the grid along each of two inputs: a window of one cell is 1/64 of a range."""
SIDES = [2**k for k in range(6)]
BOXES = [(h, w) for h in SIDES for w in SIDES if h * w > 1 and 1 / 2 <= h / w <= 2]
"""Heights and widths of boxes of cells, of 2 to 1024 of the 4096."""
FEWEST_IN_BOX = 4
"""Number of rows whose clipped residuals have a nearly normal sum."""


def across(a: Array, b: Array, z: Array) -> tuple[list[float], float]:
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
            windows.append(of_windows(float((sums / np.sqrt(inside[full])).max()), places))
    # Plane waves of up to as many periods as there are rows along each side of a square, by steps
    # of half a period.
    most = min(CELLS, int(2 * math.sqrt(N)))
    power = np.abs(np.fft.rfft2(total, (2 * CELLS, 2 * CELLS))) ** 2 / N
    power[0, 0] = 0.0
    waves = np.concatenate([power[: most + 1, : most + 1], power[-most + 1 :, : most + 1]])
    return windows, of_lines(waves)


def _integral(cells: Array) -> Array:
    """Sums of all cells above and to the left, (n + 1, m + 1)."""
    return np.pad(cells.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))


def _boxes(sums: Array, height: int, width: int) -> Array:
    """Sums of the boxes of this size at all positions, from the integral of the cells."""
    inner = sums[height:, width:] + sums[:-height, :-width]
    return np.asarray(inner - sums[height:, :-width] - sums[:-height, width:])
