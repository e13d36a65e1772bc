"""Statistics on the use of workers."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, fields
from typing import Any

EXPENSIVE = 0.01
"""Seconds from which an evaluation counts as expensive: it is written to the journal, and no
evaluation is made speculatively."""


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


def span(seconds: float) -> str:
    """Seconds as text in s, ms or µs."""
    if seconds >= 1:
        return f"{seconds:.3g} s"
    return f"{seconds * 1e3:.3g} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.3g} µs"
