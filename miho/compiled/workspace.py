"""Work arrays of Gauss-Newton steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from miho.compiled.phases import CHUNK
from miho.quantities import Array


class SolverScratch(NamedTuple):
    """Work arrays of `miho.compiled.triangular.solve_in_box`, for at most d parameters.

    free (d,): 1, 0 or DEPENDENT; solution (d,); columns (d + 1, 2 d); T (d + 1, d + 1).
    """

    free: Array
    solution: Array
    columns: Array
    T: Array


class Work(NamedTuple):
    """Work arrays for the steps of one candidate with d parameters, m rows and some levels.

    theta, step, low, high, scale (d,): the configuration in units, a step, its bounds and damping.
    sums (levels,): sums of squares. T (d + 1, d + 1): a triangular factor. chunk (d + 1, CHUNK):
    columns to fold into T. residuals (m,): values from the problem.
    """

    theta: Array
    step: Array
    low: Array
    high: Array
    scale: Array
    sums: Array
    T: Array
    chunk: Array
    residuals: Array
    solver: SolverScratch

    @classmethod
    def of(cls, d: int, m: int, levels: int) -> Work:
        """New work arrays."""
        n, zeros = d + 1, np.zeros
        solver = SolverScratch(zeros(d), zeros(d), zeros((n, 2 * d)), zeros((n, n)))
        return cls(
            zeros(d), zeros(d), zeros(d), zeros(d), zeros(d), zeros(levels), zeros((n, n)),
            zeros((n, CHUNK)), zeros(m), solver,
        )  # fmt: skip
