"""Run a job in a Dask worker, in a process that time limits and interrupts can end."""

from __future__ import annotations

import contextlib
import multiprocessing
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic

from miho.parallel.worker_process import INTERRUPTED, Job, Reply
from miho.parallel.workers import Workers

POLL = 0.1
"""Seconds between two checks whether a job was cancelled."""
GRACE = 1.0
"""Seconds that a cancelled job has to save its results."""
IDLE = 30.0
"""Seconds that an idle process waits for its owner's next job; the owner may have died."""


@dataclass(frozen=True)
class Placed(Generic[Job]):
    """A job at its worker, with an empty folder that is removed after the job."""

    job: Job
    folder: str


Process = Workers[Placed[Any], Any]
_LOCK = threading.Lock()
_INTERRUPTS: dict[str, int] = {}
"""Number of interrupts that each owner has sent to its jobs."""
_WAITING: dict[str, list[tuple[Process, threading.Timer]]] = {}
"""Idle processes of each owner. They are kept because loading the jobs' common modules again takes
longer than many jobs."""


def run_at_worker(owner: str, started: Callable[[], Process], job: Job) -> Reply[Any]:
    """Run a job in a thread of the worker; return its result, or the reason for having none.

    `started` returns a new process for the jobs of this owner.
    """
    import distributed

    # Dask's workers are daemons by default, and daemons may have no children. Ours end with them
    # all the same.
    multiprocessing.current_process().daemon = False
    worker = distributed.get_worker()
    key = worker.get_current_task()
    process = _idle_process(owner) or started()
    with (
        tempfile.TemporaryDirectory(prefix="miho-", dir=worker.local_directory) as folder,
        contextlib.ExitStack() as ending,
    ):
        ending.callback(process.kill)
        process.start(Placed(job, folder))
        sent, until = 0, float("inf")
        while time.monotonic() < until:
            for ended in process.wait(POLL):
                if until == float("inf"):  # else the owner sends no more jobs
                    ending.pop_all()
                    _keep(owner, process)
                return ended.result, ended.reason, ended.detail
            times = _INTERRUPTS.get(owner, 0)
            state = worker.state.tasks.get(key)
            if until == float("inf") and (state is None or state.state == "cancelled"):
                times, until = sent + 1, time.monotonic() + GRACE
            if times > sent:
                sent = times
                process.interrupt()
    return None, INTERRUPTED, None


def interrupt(owner: str, times: int) -> None:
    """Interrupt an owner's jobs, including jobs that start later."""
    _INTERRUPTS[owner] = max(times, _INTERRUPTS.get(owner, 0))


def dismiss(owner: str) -> None:
    """End an owner's idle processes: no more jobs will come."""
    with _LOCK:
        waiting = _WAITING.pop(owner, [])
    for process, timer in waiting:
        timer.cancel()
        process.kill()
    _INTERRUPTS.pop(owner, None)


def _idle_process(owner: str) -> Process | None:
    """An idle process of this owner, if any."""
    with _LOCK:
        waiting = _WAITING.get(owner)
        if not waiting:
            return None
        process, timer = waiting.pop()
        timer.cancel()
        return process


def _keep(owner: str, process: Process) -> None:
    """Keep a process idle for its owner's next job."""

    def expire() -> None:
        with _LOCK:
            waiting = _WAITING.get(owner, [])
            if (process, timer) not in waiting:
                return
            waiting.remove((process, timer))
        process.kill()

    timer = threading.Timer(IDLE, expire)
    timer.daemon = True
    with _LOCK:
        _WAITING.setdefault(owner, []).append((process, timer))
    timer.start()
