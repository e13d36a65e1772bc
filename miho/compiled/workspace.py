"""Work arrays of Gauss-Newton steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miho.compiled.phases import CHUNK
from miho.quantities import Array


class Work(NamedTuple):
    """Work arrays for the steps of one candidate with d parameters, m rows and some levels.

    theta, step (d,): the configuration in units, and a step. sums (levels,): sums of squares.
    T (d + 1, d + 1): a triangular factor. chunk (d + 1, CHUNK): columns to fold into T.
    residuals (m,): values from the problem.
    """

    theta: Array
    step: Array
    sums: Array
    T: Array
    chunk: Array
    residuals: Array

    @classmethod
    def of(cls, d: int, m: int, levels: int) -> Work:
        """New work arrays."""
        n, zeros = d + 1, np.zeros
        return cls(zeros(d), zeros(d), zeros(levels), zeros((n, n)), zeros((n, CHUNK)), zeros(m))
