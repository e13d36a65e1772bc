"""CPU contention: whether other work on the machine distorted the seconds of a run.

The thresholds below were chosen on a virtual machine with two cores. They separate runs of 20 ms to
1 s that had a core to themselves from runs that shared two cores with two to four busy processes.
The latter had 36 to 68 % of a core and were interrupted 90 to 340 times a second.
"""

from __future__ import annotations

import math
import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from miho.study.environment import library_threads, machine_seconds

WAITED_SHARE, WAITED_SECONDS = 0.05, 2e-3
"""A run may wait for a core for this share of its seconds, or this long if that is more."""

INTERRUPTIONS, INTERRUPTIONS_PER_SECOND = 3, 30
"""Involuntary context switches that a run may have: a fixed number, and a number per second."""

SLOWER = 1.25
"""Largest duration of the reference work before and after a run, relative to its best."""

JUDGED_SECONDS = 0.5
"""Shortest run [s] for which the work of other processes is counted: the machine's counters tick at
10 ms."""

SINES, REPEATS = 2**14, 3
FRESH_SECONDS = 0.1
"""Lifetime of a measurement of the reference work [s]."""


@dataclass
class ReferenceWork:
    """Fixed work of about 1 ms, timed: 16,384 sines, the best of three.

    `best` is its shortest time in this process so far. `last` was measured at `at` and is reused
    for 0.1 s, so that many short runs share a measurement.
    """

    best: float = math.inf
    last: float = math.inf
    at: float = -math.inf
    values: tuple[float, ...] = field(default=tuple(i / SINES for i in range(SINES)), repr=False)

    def measure(self) -> float:
        """Duration now, relative to the best in this process (1 or more)."""
        durations = []
        for _ in range(REPEATS):
            started = time.perf_counter()
            sum(map(math.sin, self.values))
            durations.append(time.perf_counter() - started)
        self.last, self.at = min(durations), time.perf_counter()
        self.best = min(self.best, self.last)
        return self.last / self.best

    def recent(self) -> float:
        """The last measurement if it is recent, else a new one; relative to the best."""
        fresh = time.perf_counter() - self.at < FRESH_SECONDS
        return self.last / self.best if fresh else self.measure()


@cache
def reference_work() -> ReferenceWork:
    """The reference work of this process."""
    return ReferenceWork()


@dataclass(frozen=True)
class Counters:
    """System counters: seconds of wall and CPU time, context switches, CPU seconds of all cores."""

    wall: float
    cpu: float
    switches: int
    machine: float | None
    load: float | None

    @classmethod
    def now(cls) -> Counters:
        """Read the counters."""
        return cls(
            time.perf_counter(),
            time.process_time(),
            resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw,
            machine_seconds(),
            os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        )


@dataclass(frozen=True)
class Timing:
    """Disturbances of a timed run, and whether its seconds are valid.

    Attributes
    ----------
    load : tuple of float or None
        Load average of the last minute at the start and the end. It lags, so it is only recorded.
    others : float or None
        Number of cores that other processes kept busy during the run; None if the run was too short
        or the system has no such counter.
    interruptions : int
        Involuntary context switches of the process.
    cpu_share : float
        CPU time divided by wall time, on the method's clock.
    kernel : tuple of float
        Duration of the reference work before and after, relative to the best of the process.
    threads : tuple of int
        Threads of each numerical library.
    reasons : tuple of str
        Reasons why the seconds are not valid.
    """

    load: tuple[float | None, float | None]
    others: float | None
    interruptions: int
    cpu_share: float
    kernel: tuple[float, float]
    threads: tuple[int, ...]
    reasons: tuple[str, ...]

    @property
    def valid(self) -> bool:
        """Whether the seconds may be compared with other runs."""
        return not self.reasons

    def as_dict(self) -> dict[str, Any]:
        """Values for a JSON file."""
        return {"valid": self.valid, **vars(self)}


class Stamp:
    """Counters and reference work before and after a run; `judge` compares them."""

    def __init__(self) -> None:
        self._before = reference_work().recent()
        self._start = self._end = Counters.now()
        self._after = self._before
        self._threads: tuple[int, ...] = ()

    def close(self) -> None:
        """Read all counters after the run, including libraries that it loaded."""
        self._end = Counters.now()
        self._after = reference_work().recent()
        self._threads = tuple(library_threads())

    def judge(self, seconds: float, cpu_seconds: float) -> Timing:
        """Timing of a run with these seconds on the method's clock.

        They exclude set-up and recording.
        """
        start, end = self._start, self._end
        wall, interruptions = end.wall - start.wall, end.switches - start.switches
        others = None
        if start.machine is not None and end.machine is not None and wall >= JUDGED_SECONDS:
            others = max(0.0, end.machine - start.machine - (end.cpu - start.cpu)) / wall
        reasons = [
            *_waiting(seconds, cpu_seconds),
            *_sharing(interruptions, wall, others, end.load),
            *_machine((self._before, self._after), self._threads),
        ]
        return Timing(
            (start.load, end.load),
            others,
            interruptions,
            cpu_seconds / seconds if seconds > 0 else 1.0,
            (self._before, self._after),
            self._threads,
            tuple(reasons),
        )


@contextmanager
def stamped() -> Iterator[Stamp]:
    """Watch the machine during a run; takes about 7 ms in total, off the run's clock.

    Enter it within `single_thread`, so that it sees the number of threads of the run.
    """
    stamp = Stamp()
    try:
        yield stamp
    finally:
        stamp.close()


def _waiting(seconds: float, cpu_seconds: float) -> Iterator[str]:
    """Reasons why the run had less or more than one core."""
    allowed = max(WAITED_SHARE * seconds, WAITED_SECONDS)
    if seconds - cpu_seconds > allowed:
        share = (seconds - cpu_seconds) / seconds
        yield f"it waited for {share:.0%} of its {seconds:.3g} s"
    if cpu_seconds - seconds > allowed:
        yield f"it kept {cpu_seconds / seconds:.2f} cores busy; expected one thread"


def _sharing(
    interruptions: int, wall: float, others: float | None, load: float | None
) -> Iterator[str]:
    """Reasons why other work took the core away or left none."""
    if interruptions > INTERRUPTIONS + INTERRUPTIONS_PER_SECOND * wall:
        yield f"other work interrupted it {interruptions} times in {wall:.3g} s"
    cores = os.cpu_count() or 1
    if others is not None and others > cores - 1 and cores > 1:
        yield f"other work kept {others:.1f} of {cores} cores busy"
    if machine_seconds() is None and load is not None and load > cores:
        yield f"the load average was {load:.1f} on {cores} cores"


def _machine(kernels: tuple[float, float], threads: tuple[int, ...]) -> Iterator[str]:
    """Reasons why the machine was slower than at its best, or ran several threads."""
    for when, relative in zip(("before", "after"), kernels, strict=True):
        if relative > SLOWER:
            yield f"fixed work {when} it took {relative:.2f} times as long as at best"
    if any(count > 1 for count in threads):
        yield f"a numerical library had {max(threads)} threads; expected 1"
