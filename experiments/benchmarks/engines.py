"""Workers for benchmarks: processes or Dask on this machine, started before the measurement."""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec

from miho.parallel import Pool, open_pool
from miho.parallel.process_executor import ProcessExecutor

PROCESSES, DASK = "processes", "Dask"
PATIENCE = 300.0
"""Time limit [s] for the start of all workers."""
NAP = 0.1


def engines() -> list[str]:
    """Names of the engines: processes, and Dask if its libraries are installed."""
    installed = find_spec("distributed") and find_spec("miho.parallel.cluster")
    return [PROCESSES, *([DASK] if installed else [])]


@contextmanager
def started(engine: str, size: int) -> Iterator[Pool]:
    """Yield a pool whose `size` workers have all started.

    Raises RuntimeError if the workers do not start.
    """
    with ExitStack() as stack:
        if engine == PROCESSES:
            executor = ProcessExecutor(size)
            stack.callback(executor.shutdown)
            pool = stack.enter_context(open_pool(executor))
        else:
            pool = stack.enter_context(open_pool(f"dask:{size}"))
        if pool is None:
            raise RuntimeError(f"{engine} gives no pool of {size}")
        _start_all(pool)
        yield pool


def _start_all(pool: Pool) -> None:
    """Wait until each worker of a pool has finished a task."""
    began, nap, seen = time.perf_counter(), NAP, set[int]()
    while len(seen) < pool.size:
        if time.perf_counter() - began > PATIENCE:
            raise RuntimeError(f"{len(seen)} of {pool.size} workers started in {PATIENCE:g} s")
        seen |= set(pool.map(_nap, [nap] * pool.size))
        nap = min(2 * nap, 1.0)  # long enough that no worker gets two while another starts


def _nap(seconds: float) -> int:
    importlib.import_module("experiments.benchmarks.sleeping")  # the evaluations need it
    time.sleep(seconds)
    return os.getpid()
