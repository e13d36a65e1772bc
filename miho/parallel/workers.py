"""Run jobs in worker processes; no job affects the others or the parent."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import selectors
import signal
import sys
import tempfile
import threading
import time
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from multiprocessing import connection, forkserver
from multiprocessing.process import BaseProcess
from typing import Any, Generic

from miho.parallel.errors import SPURIOUS_INTERRUPT
from miho.parallel.processes import end_family
from miho.parallel.worker_process import INTERRUPTED, Job, Result, exit_reason, serve

THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""Environment variables that numerical libraries read when they are loaded."""
STARTS = 3
"""Attempts at starting a worker, in case the server that forks it dies."""
PAUSE = 0.1
"""Seconds between two attempts."""
LOST = 255
"""Exit code that multiprocessing gives to a process whose server died first."""
MAIN = threading.Lock()
"""Lock of the thread that hides the program's main module."""


class Watch:
    """A set of connections and process sentinels to wait for.

    They are registered once: with many workers, registering them for every wait takes longer than a
    job.
    """

    def __init__(self) -> None:
        self._watched: set[Any] = set()
        self._selector = None if sys.platform == "win32" else selectors.DefaultSelector()

    def add(self, *objects: Any) -> None:
        """Add objects to wait for."""
        for item in objects:
            self._watched.add(item)
            if self._selector is not None:
                self._selector.register(item, selectors.EVENT_READ)

    def remove(self, *objects: Any) -> None:
        """Remove objects; call this before closing them."""
        for item in objects:
            self._watched.discard(item)
            if self._selector is not None:
                self._selector.unregister(item)

    def ready(self, seconds: float) -> set[Any]:
        """Objects that become readable or end within `seconds`."""
        if self._selector is None:
            return set(connection.wait(list(self._watched), seconds))
        return {key.fileobj for key, _ in self._selector.select(seconds)}


@dataclass(frozen=True)
class JobOutcome(Generic[Job, Result]):
    """Outcome of a job: a `result`, or a `reason` in one line for having none.

    `detail` is the traceback, if any. `interrupted` says that the parent interrupted the job,
    `overdue` that it was killed because it exceeded the time limit.
    """

    job: Job
    result: Result | None = None
    reason: str | None = None
    detail: str | None = None
    interrupted: bool = False
    overdue: bool = False


@dataclass
class _Worker(Generic[Job]):
    process: BaseProcess
    pipe: connection.Connection
    job: Job | None = None
    deadline: float = float("inf")
    started: bool = False
    interrupted: bool = False


class Workers(AbstractContextManager["Workers[Job, Result]"], Generic[Job, Result]):
    """Up to `count` worker processes that each do `work` on one job at a time; a context manager.

    A worker is a process that has imported `modules` and shares no state with the parent. It does
    jobs one after the other. If `alone(job)` is true, the worker forks a process for the job, so
    that side effects of the job, from a replaced function to a limit on file sizes, do not affect
    the next job. Before each job the worker calls `prepare(job)`, to load modules that jobs share;
    exceptions of `prepare` are ignored, because the job will raise them again.

    A job that takes longer than `time_limit` seconds is killed; the time to start a worker does not
    count. Processes that a job started end with the job if it ran alone, else with its worker.
    Workers ignore the terminal's Ctrl-C: the parent decides (`interrupt`, `kill`). They die with
    the parent, however it ends. Other objects that are added to `watch` end a `wait` as well.
    """

    def __init__(
        self,
        work: Callable[[Job], Result],
        count: int,
        time_limit: float | None = None,
        modules: Sequence[str] = (),
        *,
        prepare: Callable[[Job], object] | None = None,
        alone: Callable[[Job], bool] | None = None,
    ) -> None:
        self._count, self._task = count, (work, prepare, alone)
        self._limit = float("inf") if time_limit is None else time_limit
        self._workers: list[_Worker[Job]] = []
        self._context = _context(modules)
        self.watch = Watch()

    def __exit__(self, *_: object) -> None:
        self.kill()

    @property
    def idle(self) -> int:
        """Number of jobs that can be started now."""
        return self._count - self.busy

    @property
    def busy(self) -> int:
        """Number of jobs in progress."""
        return sum(worker.job is not None for worker in self._workers)

    @property
    def jobs(self) -> list[Job]:
        """The jobs in progress."""
        return [worker.job for worker in self._workers if worker.job is not None]

    def start(self, job: Job) -> None:
        """Send a job to an idle worker; requires that `idle` is not 0."""
        worker = next((worker for worker in self._workers if worker.job is None), None)
        if worker is not None:
            try:
                worker.pipe.send(job)
            except OSError:  # it was killed while it had nothing to do
                self._end_worker(worker)
                worker = None
        if worker is None:
            worker = self._start_worker()
            worker.pipe.send(job)
        worker.job, worker.started, worker.interrupted = job, False, False

    def wait(self, seconds: float) -> list[JobOutcome[Job, Result]]:
        """Outcomes of the jobs that end within `seconds`; returns as soon as there is one."""
        now = time.monotonic()
        until = min([now + seconds, *(worker.deadline for worker in self._workers)])
        ready = self.watch.ready(max(0.0, until - now))
        now, outcomes = time.monotonic(), []
        for worker in list(self._workers):
            if worker.pipe in ready or worker.process.sentinel in ready or now >= worker.deadline:
                if worker.job is None:  # it was killed while it had nothing to do
                    self._end_worker(worker)
                    continue
                outcome = self._outcome_of(worker)
                if outcome is not None:
                    outcomes.append(outcome)
        return outcomes

    def interrupt(self) -> None:
        """Interrupt all jobs; `wait` then returns their results or errors.

        A worker that has not begun its job is killed.
        """
        for worker in self._workers:
            if worker.job is None or worker.process.pid is None:
                continue
            worker.interrupted = True
            if worker.started or worker.pipe.poll():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(worker.process.pid, signal.SIGINT)
            else:
                worker.process.kill()

    def kill(self) -> None:
        """End all processes now."""
        alive = [w.process for w in self._workers if w.process.exitcode in (None, LOST)]
        end_family(*(process.pid for process in alive if process.pid is not None))
        for process in alive:
            process.join()
        for worker in list(self._workers):
            self._end_worker(worker)

    def _start_worker(self) -> _Worker[Job]:
        for attempts_left in reversed(range(STARTS)):
            parent_end, worker_end = self._context.Pipe()
            arguments = (*self._task, worker_end)
            process = self._context.Process(target=serve, args=arguments, daemon=True)
            try:
                with without_main():
                    process.start()
                break
            except (OSError, EOFError):  # the forking server was killed; another one starts
                parent_end.close()
                if not attempts_left:
                    raise
                time.sleep(PAUSE)  # until the system reports its end
            finally:
                worker_end.close()
        worker: _Worker[Job] = _Worker(process, parent_end)
        self._workers.append(worker)
        self.watch.add(worker.pipe, process.sentinel)
        return worker

    def _end_worker(self, worker: _Worker[Job]) -> None:
        self.watch.remove(worker.pipe, worker.process.sentinel)
        if worker.process.pid is not None and worker.process.exitcode in (None, LOST):
            end_family(worker.process.pid)
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()
        self._workers.remove(worker)

    def _outcome_of(self, worker: _Worker[Job]) -> JobOutcome[Job, Result] | None:
        """Outcome of a worker's job, or None if it has not ended."""
        job = worker.job
        if job is None:
            return None
        try:
            while worker.pipe.poll():
                answer = worker.pipe.recv()
                if answer is None:  # it has imported all modules and begins
                    worker.started, worker.deadline = True, time.monotonic() + self._limit
                    continue
                worker.job, worker.deadline = None, float("inf")
                if answer[1] == INTERRUPTED and not worker.interrupted:
                    answer = None, SPURIOUS_INTERRUPT, answer[2]
                result, reason, detail = answer
                return JobOutcome(job, result, reason, detail, worker.interrupted)
        except (EOFError, OSError):
            worker.process.join()
        overdue = False
        if worker.process.exitcode is not None and worker.interrupted:
            reason = INTERRUPTED
        elif worker.process.exitcode == LOST:
            reason = "the server that forked its process was killed"
        elif worker.process.exitcode is not None:
            reason = exit_reason(worker.process.exitcode)
        elif time.monotonic() >= worker.deadline:
            reason, overdue = f"no end within {self._limit:g} s, so it was killed", True
        else:
            return None
        self._end_worker(worker)
        return JobOutcome(job, reason=reason, interrupted=worker.interrupted, overdue=overdue)


@contextlib.contextmanager
def without_main() -> Iterator[None]:
    """Context in which processes start without running the main file again.

    Multiprocessing runs it so that functions defined there can be unpickled. A program that starts
    workers without the guard `if __name__ == "__main__"` would then start processes without end.
    """
    with MAIN:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            yield
        finally:
            sys.modules["__main__"] = main


def _context(modules: Sequence[str]) -> Any:
    """Multiprocessing context of workers: forked from a preloaded server if the system supports it.

    A process that another library started may have that library's start method as its default,
    which is unknown in a new process. A forked process inherits its parent's server, which serves
    only the parent.
    """
    methods = multiprocessing.get_all_start_methods()
    if multiprocessing.get_start_method(allow_none=True) not in (None, *methods):
        multiprocessing.set_start_method("spawn", force=True)
    if "forkserver" in methods:
        with contextlib.suppress(ChildProcessError):
            start_server(modules)
            return multiprocessing.get_context("forkserver")
    return multiprocessing.get_context("spawn")


def start_server(modules: Sequence[str]) -> None:
    """Start the server that forks workers with these modules, unless it is running.

    Its numerical libraries have one thread from the start. Otherwise each fork would stop and
    restart their threads, which takes longer than a small job. It ignores Ctrl-C from the start,
    which would print the line that it imports.
    """
    multiprocessing.get_context("forkserver").set_forkserver_preload([__name__, *modules])
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    handler = signal.getsignal(signal.SIGINT)  # None if a program in C embeds Python
    ours = handler is not None and threading.current_thread() is threading.main_thread()
    try:
        if ours:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        forkserver.ensure_running()
    except OSError as error:
        folder = tempfile.gettempdir()
        if "AF_UNIX" not in str(error):  # the error has no number
            raise
        raise OSError(
            f"TMPDIR: {folder} is too long for the sockets of workers ({len(folder)} characters); "
            "set it to a shorter path, for example /tmp"
        ) from None
    finally:
        if ours:
            signal.signal(signal.SIGINT, handler)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
