"""What an evaluation takes, and so who makes it: whether it is worth a worker, or a line of a
journal."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from miho.parallel.usage import DEAR, Usage

Array = NDArray[np.float64]

WORTH_SENDING = 0.005
"""Seconds of evaluations that are sent to a worker together, at least: fifty times what it costs
to send them. Where all that is needed takes less than twice that, no worker is asked."""
LEAST = 1e-4
"""Seconds that an evaluation takes which is sent at all: its values travel in less."""
FIRST = 3
"""So many are made here to see how long they take, unless one shows that they are dear."""
REST = 100
"""So many short evaluations are made until the next is timed."""
LATEST = 0.2
"""What the latest evaluation counts in the mean of what they take."""
ALONE = 1e-3
"""Seconds from which on one evaluation is worth a worker of its own: an asynchronous method spends
0.5 to 0.9 ms of CPU on a task of one, and 0.2 ms on an evaluation without workers."""
IN_A_ROW, AGAIN = 2, 10
"""So many evaluations in a row have to take ALONE, the first of which may have loaded something; so
many more where one did not, since any may be held up by other programs."""


def is_dear(seconds: float, evaluations: float = 1) -> bool:
    """Whether so many evaluations, which took so long together, are dear."""
    return seconds >= DEAR * evaluations


class Worth:
    """What the evaluations of a run have taken so far, which it counts in their `usage`.

    Where they are `limited` to some seconds, workers make all of them, since only a worker can be
    ended.
    """

    def __init__(self, usage: Usage, *, limited: bool) -> None:
        self._usage, self.limited = usage, limited
        self._rest = self._long = 0

    @property
    def measured(self) -> bool:
        """Whether it is known how long an evaluation takes, and so whether workers make them."""
        each = self._usage.each
        return self.limited or (each is not None and (is_dear(each) or self._usage.here >= FIRST))

    @property
    def short(self) -> bool:
        """Whether evaluations are known to be too short for a worker or a journal."""
        return self.measured and not self.limited and (self._usage.each or 0.0) < LEAST

    @property
    def alone(self) -> bool:
        """Whether one evaluation is known to be worth a worker of its own."""
        return self.limited or self._long >= IN_A_ROW

    @property
    def dear(self) -> bool:
        """Whether evaluations are known to be worth a line of a journal."""
        return is_dear(self._usage.each or 0.0)

    def chunk(self, rows: int, *, at_once: bool) -> int:
        """How many of so many rows one worker makes together, 0 if none is worth asking.

        If they are needed `at_once`, nothing else is done meanwhile.
        """
        each = self._usage.each or WORTH_SENDING
        few = each * rows < 2 * WORTH_SENDING or (rows == 1 and self._usage.here < IN_A_ROW)
        if self.short or (few and at_once and not self.limited):
            return 0
        return 1 if self.limited else max(1, int(np.ceil(WORTH_SENDING / each)))

    def remember(self) -> None:
        """One evaluation is known from before, since it was dear."""
        self._long += 1

    def resting(self) -> bool:
        """Whether evaluations are so short that this one is made here, untimed (`brief`)."""
        self._rest -= 1
        return self._rest >= 0

    def rest(self) -> None:
        """Time no more of them for a while, if they are short."""
        self._rest = REST * self.short

    def brief(self, function: Callable[..., Array], thetas: Array, *inputs: Array) -> Array:
        """Values of an evaluation that is expected to be short; the rest is over if it is not."""
        started = time.perf_counter()
        values = function(thetas, *inputs)
        if time.perf_counter() - started >= LEAST * len(thetas):
            self._rest = 0
        return values

    def count(self, each: float, rows: int, *, here: bool, raised: bool = False) -> None:
        """Some rows took so many seconds each, `here` or by a worker."""
        usage, quick = self._usage, raised and not is_dear(each)
        if not quick:
            self._long = self._long + 1 if each >= ALONE else -AGAIN
        if quick:  # which says nothing of how long a value takes
            pass
        elif usage.each is None:
            usage.each = each
        elif here and usage.here < FIRST:  # the very first may have loaded something
            usage.each = min(usage.each, each)
        else:
            usage.each += (1 - (1 - LATEST) ** rows) * (each - usage.each)
        if here:
            usage.here += rows
        else:
            usage.evaluations += rows
            usage.seconds += each * rows
