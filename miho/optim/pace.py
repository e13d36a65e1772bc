"""Speed of a run: evaluations per second, busy workers, and the time to its end."""

from __future__ import annotations

import math
import time
from collections import deque

from miho.optim.meter import Budget
from miho.optim.oracle import Oracle

LOGGED = 10.0
"""Seconds between two lines of a log, and window of the rate."""


class Pace:
    """Current speed of a run; call `update` about ten times a second.

    The first line of a log is due after `first` seconds. If the run `began` earlier, at this time
    of `time.monotonic`, it had made no evaluation then.
    """

    def __init__(self, budget: Budget, first: float = LOGGED, began: float | None = None) -> None:
        self._budget = budget
        self._points = deque[tuple[float, float]]() if began is None else deque([(began, 0.0)])
        self._known = 0
        self._logged = (time.monotonic() if began is None else began) + first - LOGGED

    def update(self, oracle: Oracle) -> None:
        """Record the progress; evaluations from the journal do not count as speed."""
        now, usage = time.monotonic(), oracle.workers.usage
        from_journal = 0 if usage is None else usage.known
        if from_journal > self._known:
            self._known = from_journal
            self._points.clear()
        self._points.append((now, oracle.evaluations))
        while now - self._points[0][0] > LOGGED:
            self._points.popleft()

    def line_due(self) -> bool:
        """Whether LOGGED seconds have passed since the last line, or `first` since the start."""
        due = time.monotonic() - self._logged >= LOGGED
        if due:
            self._logged = time.monotonic()
        return due

    @property
    def rate(self) -> float:
        """Recent evaluations per second; 0 before the second update."""
        if len(self._points) < 2:
            return 0.0
        (since, before), (now, count) = self._points[0], self._points[-1]
        return (count - before) / (now - since) if now > since else 0.0

    def seconds_left(self, oracle: Oracle) -> float:
        """Upper estimate of the time to the end in seconds, infinite without a limit."""
        left = math.inf
        if self._budget.evaluations is not None and self.rate > 0:
            left = (self._budget.evaluations - oracle.evaluations) / self.rate
        if self._budget.seconds is not None:
            left = min(left, self._budget.seconds - oracle.meter.seconds)
        return max(0.0, left)

    def words(self, oracle: Oracle) -> str:
        """Rate, workers and remaining time, for example ', 4.9/s, at most 60 s left'."""
        words = f", {self.rate:,.3g}/s" if self.rate else ""
        usage = oracle.workers.usage
        if usage is not None and usage.workers > 1 and usage.efficiency is not None:
            share = f"{min(usage.efficiency, 1.0):.0%} of their time"
            words += f", {oracle.workers.busy} of {usage.workers} workers busy ({share})"
        left = self.seconds_left(oracle)
        return words + (f", at most {left:,.0f} s left" if math.isfinite(left) else "")
