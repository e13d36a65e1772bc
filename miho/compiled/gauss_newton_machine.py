"""Brackets of Gauss-Newton steps by the machine of `miho.core`, for models that it runs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from miho.compiled.kernel import Rows
from miho.core import machine

FINISHED, PAUSED, REACHED = range(3)
"""How a block of steps ended: no candidate needs anything; the next evaluation would cost more rows
than were allowed; or the target is reached."""


def bracket_of(rows: Rows) -> Callable[..., int]:
    """The machine's loop that takes a bracket on these rows to its end; it gives how it ended.

    It takes the arrays of `GNCandidates` but their derivatives, which are in the next one; `place`
    and `order`, box, rows of each level, minima and settings; how many rows it may spend at most,
    the best loss so far, and a target; then arrays to write to. Each improvement is listed: the
    rows spent up to and with it (`at`), its loss and its theta; one that reaches the target ends
    the block. What was done is added to `tally` (5,): rows spent, improvements, losses that are NaN
    or infinite, derivatives that are not finite. `room` is for `work`.
    """
    return partial(machine().run_bracket, rows.calls, rows.kept, rows.X, rows.y)
