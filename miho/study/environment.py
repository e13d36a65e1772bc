"""The environment of a run's timing: machine, versions, threads, load."""

from __future__ import annotations

import datetime
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import threadpoolctl

from miho.core import machine

PACKAGES = ("numpy", "scipy", "optuna", "hydra-core", "pandas")


@contextmanager
def single_thread() -> Iterator[None]:
    """Limit the numerical libraries of this process to one thread."""
    with _pools(len(sys.modules)).limit(limits=1):
        yield


def library_threads() -> list[int]:
    """Number of threads that each numerical library of this process may use now."""
    return [pool["num_threads"] for pool in _pools(len(sys.modules)).info()]


@lru_cache(maxsize=1)
def _pools(modules: int) -> threadpoolctl.ThreadpoolController:
    """The numerical libraries of this process; searched again when more modules are imported."""
    return threadpoolctl.ThreadpoolController()


def environment_stamp() -> dict[str, Any]:
    """Current machine, versions, threads and load, without personal information.

    Returns
    -------
    dict
        Values for a JSON file.
    """
    return {
        "time": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in PACKAGES},
        "system": platform.system(),
        "machine": platform.machine(),
        "processor": _processor(),
        "blas": blas_kernels(),
        "simd": simd_extensions(),
        "formulas": "machine" if machine() else "numpy",
        "cores": os.cpu_count(),
        "load": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
        "threads": library_threads(),
    }


ARITHMETIC = ("processor", "blas", "simd", "formulas")
"""Properties that change the last bits of a loss, in addition to package versions. The same seed
gives the same bits only if they are equal."""


def blas_kernels() -> list[str]:
    """Code that each linear algebra library selected for this CPU ("openblas Haswell")."""
    pools = _pools(len(sys.modules)).info()
    kernels = {
        f"{pool['internal_api']} {pool['architecture']}"
        for pool in pools
        if pool.get("architecture")
    }
    return sorted(kernels)


@cache
def simd_extensions() -> list[str]:
    """Vector instructions that NumPy uses on this machine."""
    config = np.show_config(mode="dicts")
    extensions = config.get("SIMD Extensions", {}) if isinstance(config, dict) else {}
    return [*extensions.get("baseline", []), *extensions.get("found", [])]


def machine_seconds() -> float | None:
    """CPU seconds of all cores since boot; None if the system does not count them.

    They include time that a hypervisor gave to other machines and exclude waiting for disks. The
    counter ticks at 10 ms per core.
    """
    try:
        with Path("/proc/stat").open(encoding="utf-8") as file:
            fields = [int(value) for value in file.readline().split()[1:9]]
    except (OSError, ValueError):
        return None
    user, nice, system, _idle, _disk, irq, softirq, stolen = fields
    return (user + nice + system + irq + softirq + stolen) / os.sysconf("SC_CLK_TCK")


@cache
def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


@cache
def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor()
