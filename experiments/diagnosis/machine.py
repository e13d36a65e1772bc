"""Checks whether this machine can measure seconds now, including a method against itself."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
import threadpoolctl
from numpy.typing import NDArray

from miho.optim import Budget, Parameter, Problem, RandomSearch, RunRecord, Space, minimize
from miho.quantities import Array
from miho.study import single_thread
from miho.study.contention import ReferenceWork, stamped
from miho.study.environment import machine_seconds

PAIRS, SECONDS = 40, 0.02
CPU_RATIO, WALL_RATIO = (0.95, 1.05), (0.90, 1.10)
IDLE_SECONDS, BUSY_CORES = 0.3, 0.25
READINGS, RESOLUTION = 20_000, 1e-6
KERNELS, STEADY = 30, 1.1
ENOUGH_VALID = 0.5
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


def machine_checks(place: Path, *, timing: bool) -> Iterator[Check]:
    """Make the checks one by one; `place` is the folder of results, `timing` adds the A/A test."""
    yield cores()
    yield threads()
    yield load()
    yield clock()
    yield disk(place)
    yield speed()
    yield same_method() if timing else Check("A/A test", Severity.OK, "not run; add --timing")


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


def same_method() -> Check:
    """Compare one optimizer under two names: 40 interleaved runs of 20 ms each."""
    pairs = same_method_twice(evaluations_in())
    message = (
        f"one method by two names: CPU {pairs.cpu_ratio:.3f}, wall {pairs.wall_ratio:.3f}, "
        f"{int(pairs.valid.sum())} of {pairs.valid.size} runs valid"
    )
    if pairs.valid.mean() < ENOUGH_VALID:
        return Check("A/A test", Severity.WARNING, f"{message}; not judged: the machine is busy")
    if pairs.outside():
        message += f"; {' and '.join(pairs.outside())}: do not compare seconds on this machine now"
        return Check("A/A test", Severity.FAILED, message)
    return Check("A/A test", Severity.OK, message)


class Waves(Problem):
    """Mean square of sines at 200 points over (n, 3) amplitudes; a row takes some microseconds."""

    name = "waves"
    space = Space(tuple(Parameter(name, "-", -1.0, 1.0) for name in "abc"))

    def __init__(self) -> None:
        self._basis = np.sin(np.outer([1.0, 2.0, 3.0], np.linspace(0.0, 6.0, 200)))

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,)."""
        values = np.sin(thetas[:, :1] * self._basis[0]) + thetas[:, 1:2] * self._basis[1]
        return np.asarray(((values + thetas[:, 2:] * self._basis[2]) ** 2).mean(axis=1))


@dataclass(frozen=True, eq=False)
class Pairs:
    """Seconds (n, 2) of wall and CPU time under two names, and whether each run was valid."""

    wall: Array
    cpu: Array
    valid: NDArray[np.bool_]

    @property
    def cpu_ratio(self) -> float:
        """Ratio of the total CPU times of the first and the second name."""
        return _ratio(self.cpu)

    @property
    def wall_ratio(self) -> float:
        """Ratio of the total wall times of the first and the second name."""
        return _ratio(self.wall)

    def outside(self) -> list[str]:
        """Texts on the ratios outside their intervals."""
        wrong = []
        for name, ratio, (low, high) in (
            ("CPU", self.cpu_ratio, CPU_RATIO),
            ("wall", self.wall_ratio, WALL_RATIO),
        ):
            if not low <= ratio <= high:
                wrong.append(f"{name} ratio {ratio:.3f} outside {low:g} to {high:g}")
        return wrong


def same_method_twice(
    evaluations: int,
    pairs: int = PAIRS,
    *,
    interleaved: bool = True,
    halfway: Callable[[], None] | None = None,
) -> Pairs:
    """Random search under two names, `pairs` times each, in the order ABBA or all A before all B.

    `halfway` is called between the first half of all runs and the second half.
    """
    order = [(pair, name) for pair in range(pairs) for name in ((0, 1), (1, 0))[pair % 2]]
    if not interleaved:
        order.sort(key=lambda run: run[1])
    wall, cpu = np.empty((pairs, 2)), np.empty((pairs, 2))
    valid = np.zeros((pairs, 2), bool)
    for number, (pair, name) in enumerate(order):
        if number == pairs and halfway is not None:
            halfway()
        with single_thread(), stamped() as stamp:
            record = _search(pair, Budget(evaluations=evaluations))
        wall[pair, name], cpu[pair, name] = record.seconds, record.cpu_seconds
        valid[pair, name] = stamp.judge(record.seconds, record.cpu_seconds).valid
    return Pairs(wall, cpu, valid)


def evaluations_in(seconds: float = SECONDS) -> int:
    """Number of evaluations that take this CPU time here."""
    with single_thread():
        record = _search(0, Budget(evaluations=5000))
        record = _search(0, Budget(evaluations=5000))
    return max(1, int(5000 * seconds / record.cpu_seconds))


def _search(seed: int, budget: Budget) -> RunRecord:
    return minimize(RandomSearch(batch=100), Waves(), budget, seed)


def _ratio(seconds: Array) -> float:
    first, second = seconds.sum(axis=0)
    return float(first / second)
