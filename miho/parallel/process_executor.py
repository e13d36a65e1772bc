"""Worker processes as an executor: each call is done, or its own worker's end is told."""

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
"""Seconds between two looks whether processes that do nothing have died."""
Job = tuple[int, bytes]


class WorkerLostError(RuntimeError):
    """The process of a call has ended without an answer; it may be tried `again`.

    One `overdue` took too long.
    """

    overdue = False

    def __init__(self, reason: str, again: bool = True) -> None:
        super().__init__(reason)
        self.again = again


class OverdueError(WorkerLostError):
    """The call took too long, and was killed."""

    overdue = True


class HungError(WorkerLostError):
    """The call took too long, and was given up; its worker may still be busy with it."""

    overdue = True


class WorkersGoneError(WorkerLostError):
    """No call can be done any more by these workers."""


class ProcessExecutor(Executor):
    """Calls in up to `count` worker processes, which start when there is something to do.

    Where a process dies, the call that it was doing raises WorkerLostError, and no other does; so
    does a call whose result cannot be pickled. A call that takes longer than `time_limit` seconds
    is killed. Functions and arguments have to be picklable by reference. `shutdown` ends all
    processes at once.
    """

    def __init__(self, count: int, time_limit: float | None = None) -> None:
        self._max_workers = count
        self._count, self._limit = count, time_limit
        self._modules: tuple[str, ...] = (__name__,)
        self._waiting: deque[tuple[Future[Any], bytes]] = deque()
        self._futures: dict[int, Future[Any]] = {}  # of calls that are being done
        self._numbers = itertools.count()
        self._closed = self._waking = False
        self._reason = ENDED
        self._lock = threading.Lock()
        self._woken, self._wake = multiprocessing.Pipe(duplex=False)
        self._thread: threading.Thread | None = None

    def load_at_start(self, pickled: bytes) -> None:
        """Have workers begin with the modules of a pickled object, loaded once for all of them.

        Without effect on workers that were started before.
        """
        self._modules = (__name__, *modules_in(pickled))

    @property
    def started(self) -> bool:
        """Whether there was anything to do."""
        return self._thread is not None

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a function called by the next worker that is idle."""
        job = pickle.dumps((fn, args, kwargs), protocol=pickle.HIGHEST_PROTOCOL)
        future: Future[Any] = Future()
        with self._lock:
            if self._closed:
                raise WorkersGoneError(self._reason, again=False)
            self._waiting.append((future, job))
            if self._thread is None:  # where nothing is submitted, nothing is started
                self._thread = threading.Thread(target=self._serve, daemon=True)
                self._thread.start()
            self._wake_up()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all workers now; calls that are not done are cancelled."""
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
        """Have the thread look for what is new; with the lock, which the thread never takes while
        it works, so that neither waits for the other. The pipe holds one message at most: a full
        one would block whoever holds the lock."""
        if not self._waking:
            self._waking = True
            self._wake.send_bytes(b"+")

    def _end_calls(self, cancel: bool) -> None:
        """Cancel calls, or have them raise why there is no worker any more."""
        calls = [*self._futures.values(), *(future for future, _ in self._waiting)]
        self._futures.clear()
        self._waiting.clear()
        for future in calls:
            if cancel and future.cancel():
                continue
            if future.running() or future.set_running_or_notify_cancel():
                future.set_exception(WorkersGoneError(self._reason, again=False))

    def _serve(self) -> None:
        """In a thread: have workers, until all are ended; nothing may wait if this fails."""
        try:
            with Workers[Job, bytes](_call, self._count, self._limit, self._modules) as workers:
                workers.watch.add(self._woken)
                while not self._closed:
                    self._give_and_take(workers)
        except BaseException as error:  # noqa: BLE001 -- it is told to those who wait
            with self._lock:
                self._closed = True
                self._reason = f"what gives work to processes has failed: {Raised.of(error).line}"
            self._end_calls(cancel=False)

    def _give_and_take(self, workers: Workers[Job, bytes]) -> None:
        """Give jobs to idle workers, and hand over what others answer."""
        if self._waking:
            self._woken.recv_bytes()
            self._waking = False  # what is submitted from here on is announced anew
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
            else:  # what has raised would raise again
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
    """In a worker: what a job asks for, pickled here, so that an error of that is the job's own."""
    function, args, kwargs = pickle.loads(job[1])  # noqa: S301 -- of the process that started this
    return pickle.dumps(function(*args, **kwargs), protocol=pickle.HIGHEST_PROTOCOL)


def _set_result(future: Future[Any], pickled: bytes) -> None:
    try:
        result = pickle.loads(pickled)  # noqa: S301 -- of a process that was started here
    except Exception as error:  # noqa: BLE001 -- such as a module that was changed meanwhile
        future.set_exception(WorkerLostError(Raised.of(error).line, again=False))
    else:
        future.set_result(result)


def modules_in(pickled: bytes) -> list[str]:
    """The modules that a pickled object names, but for the program's own."""
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
    """How many calls an executor, a pool or a method of theirs does at a time, if it tells."""
    if workers is map:
        return 1
    for name in ("_max_workers", "max_workers", "_processes"):
        with contextlib.suppress(TypeError, ValueError, AttributeError):
            return max(1, int(getattr(getattr(workers, "__self__", workers), name)))
    return multiprocessing.cpu_count()
