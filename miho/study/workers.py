"""Jobs in processes of their own: whatever one of them does, the others and the parent go on."""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import connection, forkserver
from multiprocessing.process import BaseProcess
from types import FrameType, TracebackType
from typing import Any, Generic, NoReturn, TypeVar

from miho.optim.meter import SPURIOUS_INTERRUPT
from miho.study.processes import adopt_orphans, child_has_ended, end_child, end_family, end_of

Job = TypeVar("Job")
Result = TypeVar("Result")
Answer = tuple[Result | None, str | None, str | None]
"""Of a job: its result, or the reason why there is none, in one line, and its traceback."""

INTERRUPTED = "interrupted"
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""What numerical libraries read when they are loaded."""
STARTS = 3
"""How often a worker is started anew where the server that forks it dies meanwhile."""
PAUSE = 0.1
LOST = 255
"""What multiprocessing gives for the exit code of a process whose server died first."""


@dataclass(frozen=True)
class Ended(Generic[Job, Result]):
    """How a job ended: with a `result`, or without one for a `reason` in one line.

    `detail` is the traceback, where there is one. `interrupted`: the parent had asked it to stop.
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
    interrupted: bool = False


class Workers(Generic[Job, Result]):
    """Up to `count` workers, each doing `work` on one job at a time; a context manager.

    A worker is a process that has imported `modules` and nothing of the parent's state. It does
    jobs one after the other, but for those that are to be `alone`: it forks a process for each of
    them, so that nothing that the job does to its process, from a replaced function to a limit on
    the size of files, is there for the next one. Before either, the worker calls `prepare` with the
    job, for what jobs share and may trust; what that raises, the job itself will meet.

    A job that takes longer than `time_limit` seconds is killed; starting a worker does not count.
    With a job that is alone end all processes that it started, with the others when their worker
    ends. Workers are out of reach of the terminal's Ctrl-C: the parent decides (`interrupt`,
    `kill`). They die with the parent, however it dies.
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
        self._count, self._how = count, (work, prepare, alone)
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
        worker.job, worker.begun, worker.interrupted = job, False, False

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

        A worker that has not begun its job has nothing to tell and is killed.
        """
        for worker in self._workers:
            if worker.job is None or worker.process.pid is None:
                continue
            worker.interrupted = True
            if worker.begun or worker.pipe.poll():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(worker.process.pid, signal.SIGINT)
            else:
                worker.process.kill()

    def kill(self) -> None:
        """End all processes now."""
        for worker in list(self._workers):
            self._bury(worker)

    def _hire(self) -> _Worker[Job]:
        for left in reversed(range(STARTS)):
            ours, theirs = self._context.Pipe()
            process = self._context.Process(target=_serve, args=(*self._how, theirs), daemon=True)
            try:
                process.start()
                break
            except (OSError, EOFError):  # the server that forks it was killed; another is started
                ours.close()
                if not left:
                    raise
                time.sleep(PAUSE)  # until the system says that it has ended
            finally:
                theirs.close()
        worker: _Worker[Job] = _Worker(process, ours)
        self._workers.append(worker)
        return worker

    def _bury(self, worker: _Worker[Job]) -> None:
        if worker.process.pid is not None and worker.process.exitcode in (None, LOST):
            end_family(worker.process.pid)
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
                if answer[1] == INTERRUPTED and not worker.interrupted:
                    answer = None, SPURIOUS_INTERRUPT, answer[2]
                result, reason, detail = answer
                return Ended(job, result, reason, detail, worker.interrupted)
        except (EOFError, OSError):
            worker.process.join()
        if worker.process.exitcode is not None and worker.interrupted:
            reason = INTERRUPTED
        elif worker.process.exitcode == LOST:
            reason = "the server of its process was killed, and it with that"
        elif worker.process.exitcode is not None:
            reason = _death(worker.process.exitcode)
        elif time.monotonic() >= worker.deadline:
            reason = f"no end within {self._limit:g} s, so it was killed"
        else:
            return None
        self._bury(worker)
        return Ended(job, reason=reason, interrupted=worker.interrupted)


def _context(modules: Sequence[str]) -> Any:
    """Workers are forked from a server that imported everything once, where the system can.

    A process that another library started can have a default that only that library knows, which a
    new process would be told of.
    """
    methods = multiprocessing.get_all_start_methods()
    if multiprocessing.get_start_method(allow_none=True) not in (None, *methods):
        multiprocessing.set_start_method("spawn", force=True)
    if "forkserver" in methods:
        start_server(modules)
        return multiprocessing.get_context("forkserver")
    return multiprocessing.get_context("spawn")


def start_server(modules: Sequence[str]) -> None:
    """Start the server from which workers are forked, if it does not run, with these modules.

    Its numerical libraries have one thread from the start: each fork would stop and restart others,
    which takes longer than a small job.
    """
    multiprocessing.get_context("forkserver").set_forkserver_preload([__name__, *modules])
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        forkserver.ensure_running()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _serve(
    work: Callable[[Job], Result],
    prepare: Callable[[Job], object] | None,
    alone: Callable[[Job], bool] | None,
    pipe: connection.Connection,
) -> None:
    """A worker's life: a job, its answer, the next job."""
    if hasattr(os, "fork"):
        os.setsid()
        adopt_orphans()
    threading.Thread(target=_die_with_parent, daemon=True).start()
    orders = _Orders()
    while True:
        try:
            signal.signal(signal.SIGINT, orders.interrupt)
            job = pipe.recv()
            orders.interrupted = False
            pipe.send(None)
            if prepare is not None:
                with contextlib.suppress(Exception):
                    prepare(job)
            if hasattr(os, "fork") and alone is not None and alone(job):
                answer = _in_a_fork(work, job, orders)
            else:
                answer = _here(work, job, orders)
            pipe.send(answer)
        except (OSError, EOFError):  # the parent is gone
            return


class _Orders:
    """What the parent asked of the job in progress: an interrupt goes on to its process."""

    def __init__(self) -> None:
        self.interrupted = False
        self.process: int | None = None

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """A signal handler."""
        self.interrupted = True
        if self.process is not None:
            os.kill(self.process, signal.SIGINT)


def _here(work: Callable[[Job], Result], job: Job, orders: _Orders) -> Answer[Result]:
    """What the job answers, done by the worker itself."""
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        return (None, INTERRUPTED, None) if orders.interrupted else _answered(work, job)
    except KeyboardInterrupt:  # between two lines of ours
        return None, INTERRUPTED, None
    finally:
        signal.signal(signal.SIGINT, orders.interrupt)


def _in_a_fork(work: Callable[[Job], Result], job: Job, orders: _Orders) -> Answer[Result]:
    """What the job answers, or how its process ended without; nothing of it is left then."""
    if orders.interrupted:
        return None, INTERRUPTED, None
    ours, theirs = multiprocessing.Pipe(duplex=False)
    alive, life = os.pipe()  # which ends when this process does
    gc.freeze()  # what is here stays: a collection in the fork would copy it
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    process = os.fork()
    if not process:
        ours.close()
        os.close(life)
        _do(work, job, theirs, alive)
    orders.process = process
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    theirs.close()
    os.close(alive)
    try:
        with end_of(process) as over:
            answer = _answer(ours, process, over)
    finally:
        orders.process = None  # from now on its number may be another's
        status = end_child(process)
        ours.close()
        os.close(life)
    return answer or (None, _death(os.waitstatus_to_exitcode(status)), None)


def _answer(pipe: connection.Connection, process: int, over: Sequence[int]) -> Answer[Any] | None:
    """What comes through the pipe before the process ends."""
    while True:
        connection.wait([pipe, *over], None if over else POLL)
        if pipe.poll():
            try:
                answer: Answer[Any] = pipe.recv()
            except Exception:  # noqa: BLE001 -- cut short by its death, or no answer of ours
                return None
            return answer
        if child_has_ended(process):
            return None


POLL = 0.02
"""Seconds between two looks whether a job's process has ended, where the system cannot tell."""


def _do(
    work: Callable[[Job], Result], job: Job, pipe: connection.Connection, alive: int
) -> NoReturn:
    """In the job's own process: do it, answer and end."""
    code = 1
    try:
        os.setpgid(0, 0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
        threading.Thread(target=_die_with, args=(alive,), daemon=True).start()
        process = os.getpid()
        answer = _answered(work, job)
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(Exception):
                stream.flush()
        if os.getpid() == process:  # not a child that came back from the job as well
            pipe.send(answer)
        code = 0
    finally:
        os._exit(code)


def _answered(work: Callable[[Job], Result], job: Job) -> Answer[Result]:
    try:
        return work(job), None, None
    except KeyboardInterrupt:
        return None, INTERRUPTED, traceback.format_exc()
    except SystemExit as error:
        return None, f"sys.exit({error.code!r})", traceback.format_exc()
    except BaseException as error:  # noqa: BLE001 -- one job's fault must not end the others
        message = " ".join(str(error).split())
        return None, f"{type(error).__name__}: {message}", traceback.format_exc()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        end_family(os.getpid())
        os._exit(1)


def _die_with(alive: int) -> None:
    with contextlib.suppress(OSError):
        os.read(alive, 1)
    with contextlib.suppress(OSError):
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


def _death(exitcode: int) -> str:
    if exitcode >= 0:
        return f"its process ended with exit code {exitcode}"
    name = signal.Signals(-exitcode).name
    return f"killed by {name}" + ", perhaps for want of memory" * (name == "SIGKILL")
