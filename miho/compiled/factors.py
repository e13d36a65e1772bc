"""Triangular factors and steps on the machine, or in NumPy where it was not built."""

from __future__ import annotations

import numpy as np

from miho.compiled import triangular
from miho.core import machine
from miho.quantities import Array


def fold(T: Array, columns: Array, count: int, n: int) -> None:
    """As `miho.compiled.triangular.fold`."""
    (machine() or triangular).fold(T, columns, count, n)


def solve_in_box(R: Array, q: Array, scale: Array, low: Array, high: Array, s: Array) -> None:
    """As `miho.compiled.triangular.solve_in_box`."""
    (machine() or triangular).solve_in_box(R, np.ascontiguousarray(q), scale, low, high, s)
