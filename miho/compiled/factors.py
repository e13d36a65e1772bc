"""Triangular factors and steps on the machine, or in NumPy where it was not built."""

from __future__ import annotations

import numpy as np

from miho.compiled import triangular
from miho.compiled.workspace import SolverScratch
from miho.core import machine
from miho.quantities import Array


def fold(T: Array, columns: Array, count: int, n: int) -> None:
    """As `miho.compiled.triangular.fold`."""
    built = machine()
    if built is None:
        triangular.fold(T, columns, count, n)
    else:
        built.fold(T, columns, count, n)


def solve_in_box(
    R: Array, q: Array, scale: Array, low: Array, high: Array, n: int, s: Array,
    scratch: SolverScratch,
) -> None:  # fmt: skip
    """As `miho.compiled.triangular.solve_in_box`."""
    built = machine()
    if built is None:
        triangular.solve_in_box(R, q, scale, low, high, n, s, scratch)
    else:
        built.solve_in_box(R, np.ascontiguousarray(q), scale, low, high, s[:n])
