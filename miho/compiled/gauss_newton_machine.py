"""Brackets of Gauss-Newton steps on the machine of `miho.core`, for models that it runs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from miho.compiled.kernel import Rows
from miho.core import machine

FINISHED, PAUSED, REACHED = range(3)
"""End of a block of steps: no candidate needs anything; the next evaluation would exceed the
allowed rows, or Ctrl-C; or the target is reached."""


def bracket_of(rows: Rows) -> Callable[..., int]:
    """Machine loop that runs a bracket on these rows to its end, and returns how it ended.

    Its arguments are the arrays of `GNCandidates`, with the derivatives in the next array; `place`
    and `order`; box, rows of each level, minima and settings; the largest number of rows to use,
    the best loss so far, and a target; then output arrays. Each improvement is listed: the rows
    used up to and including it (`at`), its loss and its theta; reaching the target ends the block.
    `tally` (5,) is increased by the rows used, the improvements, the losses that are NaN or
    infinite, and the derivatives that are not finite. `room` is for `work`.
    """
    return partial(machine().run_bracket, rows.calls, rows.kept, rows.X, rows.y)
