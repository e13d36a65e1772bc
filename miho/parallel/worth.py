"""Decide from the duration of evaluations whether workers make them and a journal keeps them."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from miho.parallel.usage import EXPENSIVE, Usage
from miho.quantities import Array

WORTH_SENDING = 0.005
"""Shortest duration [s] of the evaluations in one message to a worker: fifty times the cost of
sending it. If all required evaluations take less than twice that, they are made here."""
LEAST = 1e-4
"""Evaluations shorter than this [s] are not sent to workers, because the transfer takes longer."""
FIRST = 3
"""Evaluations that are made here to time them, unless one of them is already expensive."""
REST = 100
"""Short evaluations that are made between two timed ones."""
LATEST = 0.2
"""Weight of the latest evaluation in the running mean of durations."""
ALONE = 1e-3
"""Duration [s] from which a single evaluation is sent to a worker. An asynchronous method spends
0.5 to 0.9 ms of CPU time on a task with one evaluation, and 0.2 ms on an evaluation without
workers."""
IN_A_ROW, AGAIN = 2, 10
"""Evaluations in a row that must take at least ALONE, since the first may have loaded modules. A
shorter one requires so many more (AGAIN), since other programs may delay any evaluation."""


def is_expensive(seconds: float, evaluations: float = 1) -> bool:
    """Return whether evaluations that took so long together are expensive."""
    return seconds >= EXPENSIVE * evaluations


class Worth:
    """Durations of a run's evaluations so far, and the decisions that follow; counts in `usage`.

    If evaluations are `limited` in time, workers make all of them, since only a worker can be
    ended.
    """

    def __init__(self, usage: Usage, *, limited: bool) -> None:
        self._usage, self.limited = usage, limited
        self._rest = self._long = 0

    @property
    def measured(self) -> bool:
        """Whether it is known how long an evaluation takes, and so whether workers make them."""
        each = self._usage.each
        return self.limited or (
            each is not None and (is_expensive(each) or self._usage.here >= FIRST)
        )

    @property
    def short(self) -> bool:
        """Whether evaluations are known to be too short for workers and a journal."""
        return self.measured and not self.limited and (self._usage.each or 0.0) < LEAST

    @property
    def alone(self) -> bool:
        """Whether a single evaluation is known to be worth sending to a worker."""
        return self.limited or self._long >= IN_A_ROW

    @property
    def expensive(self) -> bool:
        """Whether evaluations are known to be expensive, so that a journal keeps them."""
        return is_expensive(self._usage.each or 0.0)

    def chunk(self, rows: int, *, at_once: bool) -> int:
        """Number of rows in each message to a worker, 0 if all rows are evaluated here.

        `at_once` says that the caller waits for the values.
        """
        each = self._usage.each or WORTH_SENDING
        few = each * rows < 2 * WORTH_SENDING or (rows == 1 and self._usage.here < IN_A_ROW)
        if self.short or (few and at_once and not self.limited):
            return 0
        return 1 if self.limited else max(1, int(np.ceil(WORTH_SENDING / each)))

    def remember(self) -> None:
        """Count an evaluation from the journal, which is expensive."""
        self._long += 1

    def resting(self) -> bool:
        """Return whether evaluations are so short that this one is made here, untimed (`brief`)."""
        self._rest -= 1
        return self._rest >= 0

    def rest(self) -> None:
        """Skip the timing of the next evaluations, if they are short."""
        self._rest = REST * self.short

    def brief(self, function: Callable[..., Array], thetas: Array, *inputs: Array) -> Array:
        """Values of an evaluation that should be short; timing resumes if it is not."""
        started = time.perf_counter()
        values = function(thetas, *inputs)
        if time.perf_counter() - started >= LEAST * len(thetas):
            self._rest = 0
        return values

    def count(self, each: float, rows: int, *, here: bool, raised: bool = False) -> None:
        """Count rows that took `each` seconds, `here` or by a worker."""
        usage, quick = self._usage, raised and not is_expensive(each)
        if not quick:
            self._long = self._long + 1 if each >= ALONE else -AGAIN
        if quick:  # a quick error says nothing about the duration of a value
            pass
        elif usage.each is None:
            usage.each = each
        elif here and usage.here < FIRST:  # the first may have loaded something
            usage.each = min(usage.each, each)
        else:
            usage.each += (1 - (1 - LATEST) ** rows) * (each - usage.each)
        if here:
            usage.here += rows
        else:
            usage.evaluations += rows
            usage.seconds += each * rows
