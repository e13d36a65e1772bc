"""Jobs in processes of their own: whatever one of them does, the others and the parent go on."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, Generic, TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")

INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Ended(Generic[Job, Result]):
    """How a job ended: with a `result`, or without one for a `reason` in one line.

    `detail` is the traceback, where there is one. `interrupted`: it was told to stop.
    """

    job: Job
    result: Result | None = None
    reason: str | None = None
    detail: str | None = None
    interrupted: bool = False


@dataclass
class _Worker(Generic[Job]):
    process: BaseProcess
    pipe: connection.Connection
    job: Job | None = None
    deadline: float = float("inf")
    begun: bool = False
    stopped: bool = False


class Workers(Generic[Job, Result]):
    """Up to `count` processes, each doing `work` on one job at a time; a context manager.

    `work` and its jobs are pickled to processes that have imported `modules` and nothing of the
    parent's state. A job that takes longer than `time_limit` seconds is killed with its process,
    which is replaced; starting a process does not count. Workers are out of reach of the terminal's
    Ctrl-C: the parent decides (`interrupt`, `kill`). They die with the parent, however it dies.
    """

    def __init__(
        self,
        work: Callable[[Job], Result],
        count: int,
        time_limit: float | None = None,
        modules: Sequence[str] = (),
    ) -> None:
        self._work, self._count = work, count
        self._limit = float("inf") if time_limit is None else time_limit
        self._workers: list[_Worker[Job]] = []
        self._context = _context(modules)

    def __enter__(self) -> Workers[Job, Result]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        self.kill()

    @property
    def idle(self) -> int:
        """How many more jobs can be started now."""
        return self._count - self.busy

    @property
    def busy(self) -> int:
        """How many jobs are being done."""
        return sum(worker.job is not None for worker in self._workers)

    @property
    def jobs(self) -> list[Job]:
        """What is being done."""
        return [worker.job for worker in self._workers if worker.job is not None]

    def start(self, job: Job) -> None:
        """Give a job to an idle worker; call only where `idle` is not 0."""
        worker = next((one for one in self._workers if one.job is None), None)
        if worker is not None:
            try:
                worker.pipe.send(job)
            except OSError:  # it was killed while it had nothing to do
                self._bury(worker)
                worker = None
        if worker is None:
            worker = self._hire()
            worker.pipe.send(job)
        worker.job, worker.begun = job, False

    def wait(self, seconds: float) -> list[Ended[Job, Result]]:
        """The jobs that end within some seconds, as soon as there is one."""
        busy = [worker for worker in self._workers if worker.job is not None]
        if not busy:
            time.sleep(seconds)
            return []
        now = time.monotonic()
        until = min(now + seconds, *(worker.deadline for worker in busy))
        heard = [worker.pipe for worker in busy], [worker.process.sentinel for worker in busy]
        connection.wait([*heard[0], *heard[1]], max(0.0, until - now))
        ended = [self._heard(worker) for worker in busy]
        return [one for one in ended if one is not None]

    def interrupt(self) -> None:
        """Ask all to stop: what they raise or return then is heard by `wait`.

        A process that has not begun its job has nothing to tell and is killed.
        """
        for worker in self._workers:
            if worker.job is None or worker.process.pid is None:
                continue
            if worker.begun or worker.pipe.poll():
                os.kill(worker.process.pid, signal.SIGINT)
            else:
                worker.stopped = True
                worker.process.kill()

    def kill(self) -> None:
        """End all processes now."""
        for worker in list(self._workers):
            self._bury(worker)

    def _hire(self) -> _Worker[Job]:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(self._work, theirs), daemon=True)
        process.start()
        theirs.close()
        worker: _Worker[Job] = _Worker(process, ours)
        self._workers.append(worker)
        return worker

    def _bury(self, worker: _Worker[Job]) -> None:
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()
        self._workers.remove(worker)

    def _heard(self, worker: _Worker[Job]) -> Ended[Job, Result] | None:
        """How a worker's job ended, if it has."""
        job = worker.job
        if job is None:
            return None
        try:
            while worker.pipe.poll():
                answer = worker.pipe.recv()
                if answer is None:  # it has imported everything and begins
                    worker.begun, worker.deadline = True, time.monotonic() + self._limit
                    continue
                worker.job, worker.deadline = None, float("inf")
                return Ended(job, *answer)
        except (EOFError, OSError):
            worker.process.join()
        if worker.process.exitcode is not None and worker.stopped:
            reason = INTERRUPTED
        elif worker.process.exitcode is not None:
            reason = _death(worker.process.exitcode)
        elif time.monotonic() >= worker.deadline:
            reason = f"no end within {self._limit:g} s, so it was killed"
        else:
            return None
        self._bury(worker)
        return Ended(job, reason=reason, interrupted=worker.stopped)


def _context(modules: Sequence[str]) -> Any:
    """Workers are forked from a server that imported everything once, where the system can.

    A process that another library started can have a default that only that library knows, which a
    new process would be told of.
    """
    methods = multiprocessing.get_all_start_methods()
    if multiprocessing.get_start_method(allow_none=True) not in (None, *methods):
        multiprocessing.set_start_method("spawn", force=True)
    if "forkserver" in methods:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([__name__, *modules])
        return context
    return multiprocessing.get_context("spawn")


def _serve(work: Callable[[Job], Result], pipe: connection.Connection) -> None:
    """A worker's life: a job, an answer, the next job."""
    if hasattr(os, "setsid"):
        os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=_die_with_parent, daemon=True).start()
    while True:
        answer: tuple[Result | None, str | None, str | None, bool]
        try:
            job = pipe.recv()
        except (OSError, EOFError, KeyboardInterrupt):
            return
        try:
            pipe.send(None)
            answer = work(job), None, None, False
        except KeyboardInterrupt:
            answer = None, INTERRUPTED, None, True
        except SystemExit as error:
            answer = None, f"sys.exit({error.code!r})", traceback.format_exc(), False
        except BaseException as error:  # noqa: BLE001 -- one job's fault must not end the others
            told = " ".join(str(error).split())
            answer = None, f"{type(error).__name__}: {told}", traceback.format_exc(), False
        try:
            pipe.send(answer)
        except OSError:
            return


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _death(exitcode: int) -> str:
    if exitcode >= 0:
        return f"its process ended with exit code {exitcode}"
    name = signal.Signals(-exitcode).name
    return f"killed by {name}" + ", perhaps for want of memory" * (name == "SIGKILL")
