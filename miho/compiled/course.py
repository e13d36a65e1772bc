"""Times, inputs and events of a trajectory."""

from __future__ import annotations

from typing import NamedTuple

from miho.quantities import Array, Integers


class Course(NamedTuple):
    """Times t (N,), inputs u (N, q), and the substeps between rows of a trajectory.

    Inputs are linear from row to row, or constant from the earlier row if `held`. At row j the data
    contain output[r] for all r = rows[i] with first[j] <= i < first[j + 1]. At row j the state is
    set to start reset[j] unless this is negative: to `values` (M, S), or to the parameter at
    position `parameters` (M, S) unless this is negative. Outputs at such a row follow the reset;
    with `restart` they precede it, except at row 0.
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
