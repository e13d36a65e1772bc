"""Records of published formulas and systems of residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from miho.compiled.kernel import Formula
from miho.quantities import Array

Inputs = tuple[Any, ...]
Theta = tuple[Any, ...]
"""Input columns of a formula, and its parameters b1, b2, ..."""
Values = Any
"""An array, real or complex."""
Residuals = Callable[[Values, int], Values]
"""Residuals (m, k) of k columns of variables (n, k), for m residuals."""


@dataclass(frozen=True)
class Form:
    """A formula of `inputs` columns and `parameters` numbers."""

    value: Formula
    parameters: int
    inputs: int = 1


@dataclass(frozen=True)
class System:
    """Residuals of n variables, with the starting point of the publication.

    `residuals` are analytic functions, so the complex step gives their derivatives. `start` maps n
    to the published start (n,), and `size` maps n to the number of residuals. `low` maps n to
    published lower bounds (n,), if there are any.
    """

    residuals: Residuals
    start: Callable[[int], Sequence[float] | Array]
    size: Callable[[int], int]
    low: Callable[[int], Sequence[float] | Array] | None = None


def counted(n: int) -> Array:
    """Return 1 to n as a column (n, 1)."""
    return np.arange(1.0, n + 1)[:, None]


def same(n: int) -> int:
    """Return n, for systems with as many residuals as variables."""
    return n


def all_at(value: float) -> Callable[[int], Array]:
    """Return a start with the same value for all variables."""

    def start(n: int) -> Array:
        return np.full(n, value)

    return start
