"""Use of workers: statistics, and the decisions that follow from the durations of evaluations."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from miho.parallel.worth import EXPENSIVE, is_expensive, span
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


@dataclass
class Usage:
    """How the evaluations of a run were made.

    Attributes
    ----------
    workers : int
        Number of evaluations that can be made at a time; 1 without workers.
    evaluations : int
        Evaluations that workers made.
    seconds : float
        Duration of these evaluations, summed over workers [s].
    here : int
        Evaluations in the searching process.
    known : int
        Evaluations from the journal of an earlier call.
    each : float or None
        Duration of an evaluation [s]; None before the first.
    at_a_time : int or None
        Evaluations that an asynchronous method had in progress; None for other methods.
    wall : float or None
        Time from the first evaluation by a worker to the end [s]; None before the end, and without
        workers.
    """

    workers: int
    evaluations: int = 0
    seconds: float = 0.0
    here: int = 0
    known: int = 0
    each: float | None = None
    at_a_time: int | None = None
    wall: float | None = None
    _began: float | None = field(default=None, init=False, repr=False, compare=False)

    def begin(self) -> None:
        """Start the clock with the first evaluation by a worker."""
        if self._began is None:
            self._began = time.perf_counter()

    def of_blocks(self, evaluations: float, seconds: float) -> None:
        """Count compiled blocks, unless evaluations were timed one by one."""
        if evaluations and self.each is None and not self.known:
            self.here += round(evaluations)
            self.each = seconds / evaluations

    def end(self) -> None:
        """Stop the clock."""
        if self._began is not None:
            self.wall = time.perf_counter() - self._began

    @property
    def stored(self) -> dict[str, Any]:
        """All attributes by name; `Usage(**stored)` restores the object."""
        return {part.name: getattr(self, part.name) for part in fields(self) if part.init}

    @property
    def efficiency(self) -> float | None:
        """Share of the workers' time spent on evaluations; None before the first."""
        wall = self.wall
        if wall is None and self._began is not None:
            wall = time.perf_counter() - self._began
        return self.seconds / (self.workers * wall) if wall and self.evaluations else None

    def __str__(self) -> str:
        """One line: who made the evaluations, how long each takes, and why no worker made any."""
        known = [f"{self.known:,} evaluations known from before"] if self.known else []
        each = "" if self.each is None else f", {span(self.each)} each"
        now = []
        if self.evaluations:
            busy = f"busy {min(self.efficiency or 0.0, 1.0):.0%} of the time"
            single = self.workers == 1
            who, verb = ("a worker", "was") if single else (f"{self.workers} workers", "were")
            now = [f"{self.evaluations:,} evaluations by {who}{each}, which {verb} {busy}"]
        elif self.here or not known:
            now = [f"evaluations made here{each}{self._why_here}"]
        return "; ".join(known + now)

    @property
    def _why_here(self) -> str:
        """The reason why workers made no evaluation; empty without workers."""
        if self.workers == 1 or self.each is None:
            return ""
        alone = ", so one at a time" if self.at_a_time == 1 else ""
        fault = "few" if self.each >= EXPENSIVE else "short"
        return f": too {fault} for {self.workers} workers{alone}"


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
