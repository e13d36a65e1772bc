"""Executor of worker processes that reports the end of a call's worker to that call alone."""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import pickle
import pickletools
import sys
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from miho.parallel.remote import Raised
from miho.parallel.workers import Workers

ENDED = "the workers have ended"
IDLE = 1.0
"""Seconds between two checks for idle processes that have died."""
Job = tuple[int, bytes]


class WorkerLostError(RuntimeError):
    """The process of a call ended without an answer.

    `again` says whether the call may be repeated, `overdue` whether it exceeded the time limit.
    """

    overdue = False

    def __init__(self, reason: str, again: bool = True) -> None:
        super().__init__(reason)
        self.again = again


class OverdueError(WorkerLostError):
    """The call exceeded the time limit and was killed."""

    overdue = True


class HungError(WorkerLostError):
    """The call exceeded the time limit and was given up; its worker may still be busy."""

    overdue = True


class WorkersGoneError(WorkerLostError):
    """These workers can make no more calls."""


class ProcessExecutor(Executor):
    """Executor with up to `count` worker processes, which start when the first call is submitted.

    If a process dies, only the call that it was making raises WorkerLostError. A call whose result
    cannot be pickled raises it as well. A call that takes longer than `time_limit` seconds is
    killed. Functions and arguments must be picklable by reference. `shutdown` ends all processes at
    once.
    """

    def __init__(self, count: int, time_limit: float | None = None) -> None:
        self._max_workers = count
        self._count, self._limit = count, time_limit
        self._modules: tuple[str, ...] = (__name__,)
        self._waiting: deque[tuple[Future[Any], bytes]] = deque()
        self._futures: dict[int, Future[Any]] = {}  # of calls in progress
        self._numbers = itertools.count()
        self._closed = self._waking = False
        self._reason = ENDED
        self._lock = threading.Lock()
        self._woken, self._wake = multiprocessing.Pipe(duplex=False)
        self._thread: threading.Thread | None = None

    def load_at_start(self, pickled: bytes) -> None:
        """Preload the modules of a pickled object once for all workers that start later."""
        self._modules = (__name__, *modules_in(pickled))

    @property
    def started(self) -> bool:
        """Whether any call was submitted."""
        return self._thread is not None

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have the next idle worker call a function."""
        job = pickle.dumps((fn, args, kwargs), protocol=pickle.HIGHEST_PROTOCOL)
        future: Future[Any] = Future()
        with self._lock:
            if self._closed:
                raise WorkersGoneError(self._reason, again=False)
            self._waiting.append((future, job))
            if self._thread is None:  # started with the first call
                self._thread = threading.Thread(target=self._serve, daemon=True)
                self._thread.start()
            self._wake_up()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all workers now and cancel calls that are not done."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._wake_up()
        if self._thread is not None:
            self._thread.join()
        self._end_calls(cancel=True)
        self._woken.close()
        self._wake.close()

    def _wake_up(self) -> None:
        """Wake the thread up; the caller has the lock.

        The thread never takes the lock while it works, so neither blocks the other. The pipe
        contains at most one message, because a full pipe would block the caller.
        """
        if not self._waking:
            self._waking = True
            self._wake.send_bytes(b"+")

    def _end_calls(self, cancel: bool) -> None:
        """Cancel all calls, or let them raise the reason why no worker is left."""
        calls = [*self._futures.values(), *(future for future, _ in self._waiting)]
        self._futures.clear()
        self._waiting.clear()
        for future in calls:
            if cancel and future.cancel():
                continue
            if future.running() or future.set_running_or_notify_cancel():
                future.set_exception(WorkersGoneError(self._reason, again=False))

    def _serve(self) -> None:
        """Run the workers in a thread; if it fails, all waiting calls raise its error."""
        try:
            with Workers[Job, bytes](_call, self._count, self._limit, self._modules) as workers:
                workers.watch.add(self._woken)
                while not self._closed:
                    self._give_and_take(workers)
        except BaseException as error:  # noqa: BLE001 -- waiting calls raise it
            with self._lock:
                self._closed = True
                self._reason = f"the thread that serves workers failed: {Raised.of(error).line}"
            self._end_calls(cancel=False)

    def _give_and_take(self, workers: Workers[Job, bytes]) -> None:
        """Send jobs to idle workers and deliver the answers of others."""
        if self._waking:
            self._woken.recv_bytes()
            self._waking = False  # later calls wake the thread again
        while workers.idle and self._waiting and not self._closed:
            future, job = self._waiting.popleft()
            if future.set_running_or_notify_cancel():
                self._start(workers, future, job)
        for outcome in workers.wait(IDLE):
            future = self._futures.pop(outcome.job[0])
            if outcome.result is not None:
                _set_result(future, outcome.result)
            elif outcome.overdue:
                future.set_exception(OverdueError(str(outcome.reason), again=False))
            else:  # a call that raised would raise again
                again = outcome.detail is None
                future.set_exception(WorkerLostError(str(outcome.reason), again))

    def _start(self, workers: Workers[Job, bytes], future: Future[Any], job: bytes) -> None:
        number = next(self._numbers)
        self._futures[number] = future
        try:
            workers.start((number, job))
        except (OSError, EOFError) as error:
            reason = f"no worker could be started: {error}"
            self._futures.pop(number).set_exception(WorkersGoneError(reason))


def _call(job: Job) -> bytes:
    """Make a call in a worker; an error of pickling the result belongs to this call."""
    function, args, kwargs = pickle.loads(job[1])  # noqa: S301 -- from the process that started this one
    return pickle.dumps(function(*args, **kwargs), protocol=pickle.HIGHEST_PROTOCOL)


def _set_result(future: Future[Any], pickled: bytes) -> None:
    try:
        result = pickle.loads(pickled)  # noqa: S301 -- from a process that this one started
    except Exception as error:  # noqa: BLE001 -- for example, a module has changed meanwhile
        future.set_exception(WorkerLostError(Raised.of(error).line, again=False))
    else:
        future.set_result(result)


def modules_in(pickled: bytes) -> list[str]:
    """Modules that a pickled object names, except the main module."""
    names, strings = set(), list[str]()
    for opcode, argument, _ in pickletools.genops(pickled):
        if "UNICODE" in opcode.name:
            strings.append(str(argument))
        elif opcode.name == "GLOBAL":
            names.add(str(argument).split()[0])
        elif opcode.name == "STACK_GLOBAL":
            names.update(strings[-2:-1])
    return sorted(name for name in names & set(sys.modules) if name != "__main__")


def processes_of(workers: Any) -> int:
    """Number of calls that an executor, a pool or its method makes at a time, if known."""
    if workers is map:
        return 1
    for name in ("_max_workers", "max_workers", "_processes"):
        with contextlib.suppress(TypeError, ValueError, AttributeError):
            return max(1, int(getattr(getattr(workers, "__self__", workers), name)))
    return multiprocessing.cpu_count()
