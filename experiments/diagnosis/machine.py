"""Checks whether this machine can measure seconds now, and has the packages of pyproject.toml."""

import os
import platform
import shutil
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import threadpoolctl
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

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


PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
NEEDED = "experiments"
"""The extra that all commands need; missing packages of other extras are no failure."""


def package_checks(pyproject: Path = PYPROJECT) -> Iterator[Check]:
    """Check Python, the dependencies, and each extra."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    supported, running = SpecifierSet(project["requires-python"]), platform.python_version()
    if running in supported:
        yield Check("python", Severity.OK, running)
    else:
        yield Check("python", Severity.FAILED, f"{running}; install one that is {supported}")
    yield _group("packages", project["dependencies"], needed=True)
    for extra, lines in project.get("optional-dependencies", {}).items():
        yield _group(f"extra {extra}", lines, needed=extra == NEEDED)


def _group(name: str, lines: list[str], *, needed: bool) -> Check:
    """Check which requirements are met, missing, or have a version out of range."""
    absent, out_of_range = [], []
    requirements = [Requirement(line) for line in lines]
    applicable = [r for r in requirements if r.marker is None or r.marker.evaluate()]
    for requirement in applicable:
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            absent.append(str(requirement))
            continue
        if not requirement.specifier.contains(installed, prereleases=True):
            out_of_range.append(f"{requirement.name} {installed} is not {requirement.specifier}")
    message = f"{len(applicable) - len(absent)} of {len(applicable)} installed"
    if out_of_range or (absent and needed):
        faults = [*out_of_range, *(f"{line} is missing" for line in absent if needed)]
        return Check(name, Severity.FAILED, f"{message}: {', '.join(faults)}; run make install")
    if absent:
        return Check(name, Severity.OK, f"{message}; without {', '.join(absent)}")
    return Check(name, Severity.OK, f"{message}, in range")
