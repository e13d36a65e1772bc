"""What a trajectory is computed from, in C or compiled: importing this imports no numba."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from miho.quantities import Array, Integers

LANES = 16
"""Parameter rows side by side, in numba's code."""


class Course(NamedTuple):
    """Where a trajectory is asked for: times t (N,), inputs u (N, q) there, substeps between rows.

    Inputs are straight from row to row, or stay at the earlier row's if `held`. Of output[r] at row
    j the data want all r = rows[i] with first[j] <= i < first[j + 1]. At row j the state is set to
    start reset[j] if that is not negative: to `values` (M, S), or to the parameter whose position
    is in `parameters` (M, S), where that is not negative. Outputs at such a row are those after it,
    or if it is a `restart` those before, except at row 0.
    """

    t: Array
    u: Array
    substeps: int
    held: bool
    first: Integers
    rows: Integers
    output: Integers
    reset: Integers
    values: Array
    parameters: Integers
    restart: bool


@dataclass(frozen=True)
class FlatEquations:
    """Right-hand side and outputs as plain functions of flat arrays, which numba compiles.

    All are called (t, u, x, p, out, columns). Of `rates` and `outputs` these are parameter rows:
    state s of row i is x[LANES * s + i], and so are p and out. Of `varied_rates` and
    `varied_outputs` they are the d parameters of one row: behind x (S,) stand its derivatives
    (S, d) with respect to them, row by row, and so they do behind the result in out.
    """

    rates: Callable[..., None]
    outputs: Callable[..., None]
    varied_rates: Callable[..., None]
    varied_outputs: Callable[..., None]
