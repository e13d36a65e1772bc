"""Whether the seconds of a run may be compared: what else the machine did meanwhile.

The thresholds below separate, on a virtual machine with two cores, runs of 20 ms to 1 s that had a
core to themselves from runs that shared two cores with two to four busy processes. The latter had
36 to 68 % of a core and were interrupted 90 to 340 times a second.
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
"""Involuntary context switches that a run may have: these, and these more for each second."""

SLOWER = 1.25
"""How much longer than its best the fixed work may take, before a run and after it."""

JUDGED_SECONDS = 0.5
"""From here on the work of others is told from the machine's counters, which tick at 10 ms."""

KERNEL_VALUES, KERNEL_REPEATS = 2**14, 3
FRESH_SECONDS = 0.1


@dataclass
class Kernel:
    """Fixed work of about 1 ms, timed: 16,384 sines, the best of three.

    `best` is its shortest time in this process so far; `last` was measured at `at`, and serves as
    well for what starts or ends within 0.1 s, so that many short runs share it.
    """

    best: float = math.inf
    last: float = math.inf
    at: float = -math.inf
    values: tuple[float, ...] = field(
        default=tuple(i / KERNEL_VALUES for i in range(KERNEL_VALUES)), repr=False
    )

    def measure(self) -> float:
        """Seconds now, relative to the best in this process (1 or more)."""
        took = []
        for _ in range(KERNEL_REPEATS):
            started = time.perf_counter()
            sum(map(math.sin, self.values))
            took.append(time.perf_counter() - started)
        self.last, self.at = min(took), time.perf_counter()
        self.best = min(self.best, self.last)
        return self.last / self.best

    def recent(self) -> float:
        """The last measurement if it is fresh, else a new one; relative to the best."""
        fresh = time.perf_counter() - self.at < FRESH_SECONDS
        return self.last / self.best if fresh else self.measure()


@cache
def kernel() -> Kernel:
    """The one of this process."""
    return Kernel()


@dataclass(frozen=True)
class Counters:
    """What the system has counted so far: seconds of wall and CPU time, switches, work of all."""

    wall: float
    cpu: float
    switches: int
    machine: float | None
    load: float | None

    @classmethod
    def now(cls) -> Counters:
        """Read them."""
        return cls(
            time.perf_counter(),
            time.process_time(),
            resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw,
            machine_seconds(),
            os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        )


@dataclass(frozen=True)
class Timing:
    """How a timed run went.

    `load` is the load average of the last minute at start and end, for the record: it lags by a
    minute. `others` is how many cores the rest of the machine kept busy during the run, None where
    the run was too short to tell or the system does not count it. `interruptions` are the process's
    involuntary context switches, `cpu_share` its CPU time by its wall time on the method's clock,
    `kernel` the time of fixed work before and after, relative to the best of the process, and
    `threads` those of each numerical library. `reasons` say in words why the seconds are not valid.
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
        """Whether the seconds may be compared with those of other runs."""
        return not self.reasons

    def as_dict(self) -> dict[str, Any]:
        """For a JSON file."""
        values = {name: value for name, value in vars(self).items() if name != "reasons"}
        listed = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in values.items()
        }
        return {"valid": self.valid, "reasons": list(self.reasons), **listed}


class Stamp:
    """What was read around a run; `judge` says what to think of its seconds."""

    def __init__(self) -> None:
        self._before = kernel().recent()
        self._start = self._end = Counters.now()
        self._after = self._before
        self._threads: tuple[int, ...] = ()

    def close(self) -> None:
        """Read everything for the second time; libraries loaded meanwhile count as well."""
        self._end = Counters.now()
        self._after = kernel().recent()
        self._threads = tuple(library_threads())

    def judge(self, seconds: float, cpu_seconds: float) -> Timing:
        """`seconds` and `cpu_seconds` of the method's clock, without set-up and recording."""
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
    """Watch the machine around a run; takes some 7 ms in all, off the run's clock.

    Enter it within `single_thread`, so that it finds the threads that the run had.
    """
    stamp = Stamp()
    try:
        yield stamp
    finally:
        stamp.close()


def _waiting(seconds: float, cpu_seconds: float) -> Iterator[str]:
    """Whether the run had one core, no less and no more."""
    allowed = max(WAITED_SHARE * seconds, WAITED_SECONDS)
    if seconds - cpu_seconds > allowed:
        share = (seconds - cpu_seconds) / seconds
        yield f"it waited for {share:.0%} of its {seconds:.3g} s"
    if cpu_seconds - seconds > allowed:
        yield f"it kept {cpu_seconds / seconds:.2f} cores busy; expected one thread"


def _sharing(
    interruptions: int, wall: float, others: float | None, load: float | None
) -> Iterator[str]:
    """Whether other work took the core away, or left none."""
    if interruptions > INTERRUPTIONS + INTERRUPTIONS_PER_SECOND * wall:
        yield f"other work interrupted it {interruptions} times in {wall:.3g} s"
    cores = os.cpu_count() or 1
    if others is not None and others > cores - 1 and cores > 1:
        yield f"other work kept {others:.1f} of {cores} cores busy"
    if machine_seconds() is None and load is not None and load > cores:
        yield f"the load average was {load:.1f} on {cores} cores"


def _machine(kernels: tuple[float, float], threads: tuple[int, ...]) -> Iterator[str]:
    """Whether the machine ran at its own speed, on one thread."""
    for when, relative in zip(("before", "after"), kernels, strict=True):
        if relative > SLOWER:
            yield f"fixed work {when} it took {relative:.2f} times as long as at best"
    if any(count > 1 for count in threads):
        yield f"a numerical library had {max(threads)} threads; expected 1"
