"""How well workers are used."""

from __future__ import annotations

import time
from dataclasses import dataclass, field


@dataclass
class Usage:
    """Evaluations that workers made, the `seconds` that these took.

    `here` were made in the searching process, where one takes `each` seconds; `known` came from a
    journal.
    """

    workers: int
    evaluations: int = 0
    seconds: float = 0.0
    here: int = 0
    known: int = 0
    each: float | None = None
    _began: float | None = field(default=None, repr=False)

    def begin(self) -> None:
        """Workers have something to do from now on."""
        if self._began is None:
            self._began = time.perf_counter()

    @property
    def efficiency(self) -> float | None:
        """The share of the workers' time that went into evaluations; None before there are any."""
        if self._began is None or not self.evaluations:
            return None
        return self.seconds / (self.workers * (time.perf_counter() - self._began))

    def __str__(self) -> str:
        """In a few words."""
        each = "" if self.each is None else f", {span(self.each)} each"
        known = f"{self.known:,} evaluations known from before; " if self.known else ""
        if not self.evaluations:
            alone = self.workers == 1 or self.each is None
            remark = "" if alone else f": too short for {self.workers} workers"
            return f"{known}evaluations made here{each}{remark}"
        busy = f"busy {min(self.efficiency or 0.0, 1.0):.0%} of the time"
        who = "a worker" if self.workers == 1 else f"{self.workers} workers"
        verb = "was" if self.workers == 1 else "were"
        return f"{known}{self.evaluations:,} evaluations by {who}{each}, which {verb} {busy}"


def span(seconds: float) -> str:
    """Seconds in a unit that suits."""
    if seconds >= 1:
        return f"{seconds:.3g} s"
    return f"{seconds * 1e3:.3g} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.3g} µs"
