"""Checks of the machine: can seconds be measured on it, now."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import threadpoolctl

from experiments.doctor.check import Check, State
from experiments.doctor.same_method import evaluations_in, same_method_twice
from miho.study import single_thread
from miho.study.environment import machine_seconds
from miho.study.validity import Kernel

IDLE_SECONDS, BUSY_CORES = 0.3, 0.25
READINGS, RESOLUTION = 20_000, 1e-6
KERNELS, STEADY = 30, 1.1
ENOUGH_VALID = 0.5
ENOUGH, LITTLE = 2**30, 100 * 2**20


def machine_checks(place: Path, *, timing: bool) -> Iterator[Check]:
    """One check after the other; `place` is where results go, `timing` runs the A/A test too."""
    yield cores()
    yield threads()
    yield load()
    yield clock()
    yield disk(place)
    yield speed()
    yield same_method() if timing else Check("A/A test", State.OK, "not run; --timing runs it")


def cores() -> Check:
    """All cores, and those that this process may use."""
    everyone = os.cpu_count() or 1
    ours = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else everyone
    told = f"{ours} of {everyone}"
    if ours == 1:
        return Check("cores", State.WARNING, f"{told}; anything else that runs disturbs a timing")
    return Check("cores", State.OK, told)


def threads() -> Check:
    """Whether the numerical libraries can be held to one thread."""
    with single_thread():
        pools = threadpoolctl.threadpool_info()
    several = [
        f"{pool['prefix']} {pool['num_threads']}" for pool in pools if pool["num_threads"] > 1
    ]
    if several:
        told = f"{', '.join(several)} although one was asked for; set OMP_NUM_THREADS=1"
        return Check("threads", State.FAILED, told)
    names = ", ".join(sorted({pool["prefix"] for pool in pools})) or "no library found"
    return Check("threads", State.OK, f"one in a run ({names})")


def busy_cores(seconds: float = IDLE_SECONDS) -> float | None:
    """How many cores the rest of the machine keeps busy while we sleep; None if nobody counts."""
    before, started = machine_seconds(), time.perf_counter()
    time.sleep(seconds)
    after, took = machine_seconds(), time.perf_counter() - started
    return None if before is None or after is None else (after - before) / took


def load() -> Check:
    """What else runs."""
    busy = busy_cores()
    averages = os.getloadavg() if hasattr(os, "getloadavg") else None
    told = f"load average {averages[0]:.2f}" if averages else "no load average here"
    if busy is None:
        return Check("load", State.OK, told)
    told = f"other work keeps {busy:.2f} cores busy, {told}"
    if busy > BUSY_CORES:
        return Check("load", State.WARNING, f"{told}; time nothing until it has ended")
    return Check("load", State.OK, told)


def clock() -> Check:
    """Whether the clock of all durations never falls, and how finely it ticks."""
    readings = np.array([time.perf_counter() for _ in range(READINGS)])
    steps = np.diff(readings)
    finest = float(steps[steps > 0].min()) if (steps > 0).any() else float("inf")
    info = time.get_clock_info("perf_counter")
    told = f"{info.implementation}, finest step {finest * 1e9:.0f} ns"
    if (steps < 0).any() or not info.monotonic:
        return Check("clock", State.FAILED, f"{told}; it falls: no duration can be trusted")
    if finest > RESOLUTION:
        return Check("clock", State.WARNING, f"{told}; short runs cannot be timed")
    return Check("clock", State.OK, told)


def disk(place: Path) -> Check:
    """Free space where the results go."""
    free = shutil.disk_usage(place).free
    told = f"{free / 2**30:.1f} GiB free for {place}"
    if free < LITTLE:
        return Check("disk", State.FAILED, f"{told}; make room before the next run")
    if free < ENOUGH:
        return Check("disk", State.WARNING, f"{told}; a large sweep may not fit")
    return Check("disk", State.OK, told)


def speed() -> Check:
    """Whether fixed work takes the same time again and again."""
    kernel = Kernel()
    took = []
    for _ in range(KERNELS):
        kernel.measure()
        took.append(kernel.last)
    spread = float(np.median(took) / min(took))
    told = f"fixed work {min(took) * 1e3:.3f} ms at best, median {spread:.2f} times that"
    if spread > STEADY:
        return Check("speed", State.WARNING, f"{told}; the cores are shared or change their clock")
    return Check("speed", State.OK, told)


def same_method() -> Check:
    """One optimizer under two names, interleaved: 40 runs of 20 ms each."""
    found = same_method_twice(evaluations_in())
    told = (
        f"one method by two names: CPU {found.cpu_ratio:.3f}, wall {found.wall_ratio:.3f}, "
        f"{int(found.valid.sum())} of {found.valid.size} runs valid"
    )
    if found.valid.mean() < ENOUGH_VALID:
        return Check("A/A test", State.WARNING, f"{told}; not judged, the machine is busy")
    if found.outside():
        told += f"; {' and '.join(found.outside())}: compare no seconds on this machine now"
        return Check("A/A test", State.FAILED, told)
    return Check("A/A test", State.OK, told)
