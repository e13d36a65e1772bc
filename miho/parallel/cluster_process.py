"""In a worker of a cluster of Dask: a job, in a process that time limits and interrupts can end."""

from __future__ import annotations

import contextlib
import multiprocessing
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic

from miho.parallel.worker_process import INTERRUPTED, Answer, Job, Result
from miho.parallel.workers import Workers

POLL = 0.1
"""Seconds between two looks whether a job is still wanted."""
GRACE = 1.0
"""Seconds that a job has to keep what it has, once nobody waits for it."""
IDLE = 30.0
"""Seconds that a process waits for the next job of its owner, who may be dead."""


@dataclass(frozen=True)
class Placed(Generic[Job]):
    """A job at the worker that does it, and an empty folder there, which is removed afterwards."""

    job: Job
    folder: str


@dataclass(frozen=True)
class Task(Generic[Job, Result]):
    """What is the same for all jobs of an owner: the arguments of `Workers`."""

    owner: str
    work: Callable[[Placed[Job]], Result]
    time_limit: float | None
    modules: Sequence[str]
    prepare: Callable[[Placed[Job]], object] | None
    alone: Callable[[Placed[Job]], bool] | None


Process = Workers[Placed[Any], Any]
_LOCK = threading.Lock()
_INTERRUPTS: dict[str, int] = {}
"""How often each owner of jobs has interrupted them."""
_WAITING: dict[str, list[tuple[Process, threading.Timer]]] = {}
"""The processes that wait for the next job of an owner: to load again what jobs have in common
takes longer than many a job."""


def run_at_worker(task: Task[Job, Result], job: Job) -> Answer[Result]:
    """In a thread of the worker: have a job done; its result, or the reason why there is none."""
    import distributed

    # Dask's processes are daemons unless its configuration says otherwise, and those may have no
    # children. Ours end with them all the same.
    multiprocessing.current_process().daemon = False
    worker = distributed.get_worker()
    key = worker.get_current_task()
    process = _process_for(task)
    with (
        tempfile.TemporaryDirectory(prefix="miho-", dir=worker.local_directory) as folder,
        contextlib.ExitStack() as ending,
    ):
        ending.callback(process.kill)
        process.start(Placed(job, folder))
        sent, until = 0, float("inf")
        while time.monotonic() < until:
            for ended in process.wait(POLL):
                if until == float("inf"):  # else no more jobs come
                    ending.pop_all()
                    _keep(task.owner, process)
                return ended.result, ended.reason, ended.detail
            times = _INTERRUPTS.get(task.owner, 0)
            state = worker.state.tasks.get(key)
            if until == float("inf") and (state is None or state.state == "cancelled"):
                times, until = sent + 1, time.monotonic() + GRACE
            if times > sent:
                sent = times
                process.interrupt()
    return None, INTERRUPTED, None


def interrupt(owner: str, times: int) -> None:
    """Interrupt the jobs of an owner, also those that come later."""
    _INTERRUPTS[owner] = max(times, _INTERRUPTS.get(owner, 0))


def dismiss(owner: str) -> None:
    """End the processes that wait for jobs of an owner: no more will come."""
    with _LOCK:
        waiting = _WAITING.pop(owner, [])
    for process, timer in waiting:
        timer.cancel()
        process.kill()
    _INTERRUPTS.pop(owner, None)


def _process_for(task: Task[Any, Any]) -> Process:
    """A process that has done jobs of this owner, or else a new one."""
    with _LOCK:
        waiting = _WAITING.get(task.owner)
        if waiting:
            process, timer = waiting.pop()
            timer.cancel()
            return process
    return Workers(
        task.work, 1, task.time_limit, task.modules, prepare=task.prepare, alone=task.alone
    )


def _keep(owner: str, process: Process) -> None:
    """Let a process wait for the next job of its owner."""

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
