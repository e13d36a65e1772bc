"""What a trajectory is computed from."""

from __future__ import annotations

from typing import NamedTuple

from miho.quantities import Array, Integers


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
