"""One published system of residuals: what the tables of them hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from miho.quantities import Array

Values = Any
"""An array, real or complex."""
Residuals = Callable[[Values, int], Values]
"""Residuals (m, k) of k columns of variables (n, k), for m residuals."""


@dataclass(frozen=True)
class System:
    """Residuals of n variables, and where the publication starts.

    `residuals` are analytic functions, so that they have derivatives by the complex step. `start`
    gives the published start (n,) for n variables, and `size` how many residuals there are of n.
    The publication may keep every variable at or above `low` (n,).
    """

    residuals: Residuals
    start: Callable[[int], Sequence[float] | Array]
    size: Callable[[int], int]
    low: Callable[[int], Sequence[float] | Array] | None = None


def counted(n: int) -> Array:
    """1 to n as a column (n, 1)."""
    return np.arange(1.0, n + 1)[:, None]


def same(n: int) -> int:
    """As many residuals as variables."""
    return n


def all_at(value: float) -> Callable[[int], Array]:
    """A start with the same value for every variable."""

    def start(n: int) -> Array:
        return np.full(n, value)

    return start
