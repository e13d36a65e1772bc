"""Checks whether this machine can measure seconds now."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
import threadpoolctl

from miho.study import single_thread
from miho.study.contention import ReferenceWork
from miho.study.environment import machine_seconds

IDLE_SECONDS, BUSY_CORES = 0.3, 0.25
READINGS, RESOLUTION = 20_000, 1e-6
KERNELS, STEADY = 30, 1.1
ENOUGH, LITTLE = 2**30, 100 * 2**20


class Severity(StrEnum):
    """Severity of the result of a check."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True)
class Check:
    """Result of a check: its name, its severity, and a message with the remedy."""

    name: str
    severity: Severity
    message: str

    @property
    def line(self) -> str:
        """Line for the terminal."""
        return f"{self.name:<18} {self.severity:<8} {self.message}"


def machine_checks(place: Path) -> Iterator[Check]:
    """Make the checks one by one; `place` is the folder of results."""
    yield cores()
    yield threads()
    yield load()
    yield clock()
    yield disk(place)
    yield speed()


def cores() -> Check:
    """Number of cores, and the number that this process may use."""
    total = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else total
    message = f"{usable} of {total}"
    if usable == 1:
        return Check("cores", Severity.WARNING, f"{message}; any other process disturbs a timing")
    return Check("cores", Severity.OK, message)


def threads() -> Check:
    """Whether the numerical libraries can be limited to one thread."""
    with single_thread():
        pools = threadpoolctl.threadpool_info()
    several = [
        f"{pool['prefix']} {pool['num_threads']}" for pool in pools if pool["num_threads"] > 1
    ]
    if several:
        message = f"{', '.join(several)} although one was requested; set OMP_NUM_THREADS=1"
        return Check("threads", Severity.FAILED, message)
    names = ", ".join(sorted({pool["prefix"] for pool in pools})) or "no library found"
    return Check("threads", Severity.OK, f"one in a run ({names})")


def busy_cores(seconds: float = IDLE_SECONDS) -> float | None:
    """Cores that other processes use while this one sleeps; None if the system has no counters."""
    before, started = machine_seconds(), time.perf_counter()
    time.sleep(seconds)
    after, took = machine_seconds(), time.perf_counter() - started
    return None if before is None or after is None else (after - before) / took


def load() -> Check:
    """Cores that other processes use, and the load average."""
    busy = busy_cores()
    averages = os.getloadavg() if hasattr(os, "getloadavg") else None
    message = f"load average {averages[0]:.2f}" if averages else "no load average here"
    if busy is None:
        return Check("load", Severity.OK, message)
    message = f"other processes use {busy:.2f} cores, {message}"
    if busy > BUSY_CORES:
        return Check("load", Severity.WARNING, f"{message}; time nothing until it has ended")
    return Check("load", Severity.OK, message)


def clock() -> Check:
    """Whether the clock for durations is monotonic, and its resolution."""
    readings = np.array([time.perf_counter() for _ in range(READINGS)])
    steps = np.diff(readings)
    finest = float(steps[steps > 0].min()) if (steps > 0).any() else float("inf")
    info = time.get_clock_info("perf_counter")
    message = f"{info.implementation}, finest step {finest * 1e9:.0f} ns"
    if (steps < 0).any() or not info.monotonic:
        return Check("clock", Severity.FAILED, f"{message}; not monotonic, do not use durations")
    if finest > RESOLUTION:
        return Check("clock", Severity.WARNING, f"{message}; short runs cannot be timed")
    return Check("clock", Severity.OK, message)


def disk(place: Path) -> Check:
    """Free space for the results."""
    free = shutil.disk_usage(place).free
    message = f"{free / 2**30:.1f} GiB free for {place}"
    if free < LITTLE:
        return Check("disk", Severity.FAILED, f"{message}; make room before the next run")
    if free < ENOUGH:
        return Check("disk", Severity.WARNING, f"{message}; a large sweep may not fit")
    return Check("disk", Severity.OK, message)


def speed() -> Check:
    """Whether a fixed computation takes the same time each time."""
    work = ReferenceWork()
    took = []
    for _ in range(KERNELS):
        work.measure()
        took.append(work.last)
    spread = float(np.median(took) / min(took))
    message = f"fixed work {min(took) * 1e3:.3f} ms at best, median {spread:.2f} times as long"
    if spread > STEADY:
        return Check(
            "speed", Severity.WARNING, f"{message}; the cores are shared or change their clock"
        )
    return Check("speed", Severity.OK, message)
