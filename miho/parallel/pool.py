"""Workers in the usual forms: a number, an executor, a map, or the address of a cluster."""

from __future__ import annotations

import contextlib
import functools
import itertools
import multiprocessing
import operator
import os
import sys
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import cloudpickle

from miho.parallel.cluster import cluster, is_address, is_empty, places
from miho.parallel.process_executor import (
    ProcessExecutor,
    WorkerLostError,
    WorkersGoneError,
    processes_of,
)
from miho.parallel.remote import Answer, Raised, shared, work

Workers = int | str | Executor | Callable[..., Iterable[Any]] | None
"""A number of processes (-1: one per core), an executor of `concurrent.futures`, a callable like
`map`, or the address of a cluster (`dask://HOST:PORT`, `dask:4`, `slurm:10`)."""
TRIES = 3
"""Attempts at a call whose worker ends without an answer."""
SMALL = 1 << 14
"""Size [bytes] up to which a pickled function is sent with every call."""
LOOK = 0.1
"""Seconds between two checks for signals and stop requests."""
EXPECTED = (
    "a number of processes, -1 for one per core, an executor, a callable like map, or an address "
    "like 'dask://HOST:PORT', 'dask:4' or 'slurm:10'"
)


DAEMONIC = (
    "this process is daemonic, like the workers of multiprocessing.Pool, and may start no "
    "processes; it makes all evaluations itself, without a time limit. Give a ThreadPoolExecutor "
    "or an address instead"
)


@contextmanager
def open_pool(workers: Workers, time_limit: float | None = None) -> Iterator[Pool | None]:
    """Open a pool of workers for the duration of the context.

    Parameters
    ----------
    workers : int, str, Executor, callable or None
        See `Workers`. A pool that is started here ends with the context; an executor is left open.
    time_limit : float, optional
        Largest duration of a call [s]. Our worker processes are killed if they exceed it. For other
        workers `Pool.limit` holds the limit, and the caller gives the call up.

    Yields
    ------
    Pool or None
        None if this process makes all calls: for one worker without a time limit, and in a daemonic
        process (a worker of `multiprocessing.Pool`), which may start no processes.

    Raises
    ------
    ValueError
        If `workers` has none of these forms.
    """
    limit = time_limit
    with ExitStack() as stack:
        if is_address(workers):
            client: Any = stack.enter_context(cluster(workers))
            executor: Any = client.get_executor(pure=False)
            count = places(client, workers)
        elif isinstance(workers, Executor):
            executor, count = workers, processes_of(workers)
        elif callable(workers) and (workers is map or not isinstance(workers, type)):
            executor, count = MapExecutor(workers), processes_of(workers)
        else:
            count = number_of(workers)
            daemonic = multiprocessing.current_process().daemon
            if daemonic and (count > 1 or time_limit is not None):
                sys.stderr.write(f"miho: workers={workers}: {DAEMONIC}\n")
            if daemonic or (count == 1 and time_limit is None):
                yield None
                return
            executor, limit = ProcessExecutor(count, time_limit), None
            stack.callback(executor.shutdown)
        with contextlib.closing(Pool(executor, count, limit)) as pool:
            if is_address(workers):
                pool.connected = lambda: client.status == "running"
                pool.empty = lambda: is_empty(client)
            yield pool


def number_of(workers: Any) -> int:
    """Number of processes that `workers` means; raises ValueError if it is not a number."""
    try:
        count = 1 if workers is None else int(workers)
        if isinstance(workers, bool) or (count != -1 and count < 1) or count != float(workers or 1):
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"workers is {workers!r}; expected {EXPECTED}") from None
    return len(os.sched_getaffinity(0)) if count == -1 else count


class Pool:
    """Workers that call shared functions; each function is sent to a worker once.

    Parameters
    ----------
    executor : Executor
        Makes the calls.
    size : int
        Number of workers.
    limit : float, optional
        Duration [s] after which the caller should give a call up. None if the workers enforce the
        limit themselves.
    """

    def __init__(self, executor: Executor, size: int, limit: float | None = None) -> None:
        self.size, self.limit = size, limit
        self._executor = executor
        self.connected: Callable[[], bool] = lambda: True
        self.empty: Callable[[], bool] = lambda: False
        self._pending: set[Future[Answer]] = set()
        self._tokens: list[str] = []

    def share(self, function: Callable[[Any], Any]) -> Callable[[Any], Future[Answer]]:
        """Return a function that has a worker call `function` with an argument.

        A call whose worker ended is repeated, up to TRIES attempts.

        Parameters
        ----------
        function : callable
            Function of one argument.

        Returns
        -------
        callable
            Maps an argument to a future of an `Answer`, which contains the exception if the
            function raised one. The future raises WorkerLostError if the worker ended in each
            attempt, and WorkersGoneError if no more calls can be made, because the executor is
            broken or the function cannot be sent.
        """
        token = uuid.uuid4().hex
        shared[token] = function  # for workers that are threads of this process
        self._tokens.append(token)
        pickled = functools.cache(functools.partial(_pickled, function))
        calls = itertools.count()
        return lambda argument: self._call(token, pickled, argument, next(calls) < self.size)

    def map(self, function: Callable[[Any], Any], arguments: Iterable[Any]) -> Iterator[Any]:
        """Yield the value of a function at each argument, in order; raise its exceptions."""
        call = self.share(function)
        futures = [call(argument) for argument in arguments]
        self.flush()
        try:
            for future in futures:
                yield value_of(future)
        finally:
            for future in futures:
                future.cancel()

    def wait(self, news: threading.Event) -> None:
        """Wait for `news` of calls, at most as long as a stop request may wait.

        The caller then checks which calls have ended.
        """
        news.wait(LOOK)
        news.clear()

    def flush(self) -> None:
        """Start calls that were collected, for workers that only accept several calls together."""
        if isinstance(self._executor, MapExecutor):
            self._executor.flush()

    def close(self) -> None:
        """Cancel all calls that are not done."""
        for future in list(self._pending):
            future.cancel()
        for token in self._tokens:
            shared.pop(token, None)

    def _call(
        self, token: str, pickled: Callable[[], bytes], argument: Any, first: bool
    ) -> Future[Answer]:
        """Submit a call.

        The function is sent with the `first` calls, so that each worker can receive it, and with
        all calls if it is small, because a call whose worker lacks the function is queued a second
        time.
        """
        payload = None
        if not isinstance(self._executor, ThreadPoolExecutor):
            with contextlib.suppress(Exception):  # an error shows when a worker lacks the function
                payload = pickled() if first or len(pickled()) <= SMALL else None
        if isinstance(self._executor, ProcessExecutor) and not self._executor.started and payload:
            self._executor.load_at_start(payload)
        call = _Call(self._executor, token, pickled, argument)
        self._pending.add(call.result)
        call.result.add_done_callback(self._pending.discard)
        call.submit(payload)
        return call.result


@dataclass(eq=False)
class _Call:
    """A call of a shared function; it is repeated if its worker ends or lacks the function."""

    executor: Executor
    token: str
    pickled: Callable[[], bytes]
    argument: Any
    tries: int = 0
    result: Future[Answer] = field(default_factory=Future)

    def submit(self, payload: bytes | None) -> None:
        """Submit the call; `payload` contains the function if the worker may lack it."""
        if self.result.cancelled():
            return
        try:
            attempt = self.executor.submit(work, self.token, payload, self.argument)
        except Exception as error:  # noqa: BLE001 -- any error of an executor that has ended
            self._fail(WorkersGoneError(_broken(error), again=False))
            return
        attempt.add_done_callback(functools.partial(self._end, payload))
        self.result.add_done_callback(lambda _: attempt.cancel())  # if the call is given up

    def _end(self, payload: bytes | None, attempt: Future[Answer]) -> None:
        """Take the answer of an attempt, or make another one."""
        try:
            answer = attempt.result()
        except WorkerLostError as error:
            self.tries += 1
            if error.again and self.tries < TRIES:
                self.submit(payload)
            else:
                self._fail(error)
        except (BrokenExecutor, CancelledError) as error:
            self._fail(WorkersGoneError(_broken(error), again=False))
        except Exception as error:  # noqa: BLE001 -- from another library's executor
            self._fail(WorkerLostError(Raised.of(error).line, again=False))
        except BaseException as error:  # noqa: BLE001 -- the same
            self._fail(WorkersGoneError(_broken(error), again=False))
        else:
            if answer.lacks:
                self._send()
            elif answer.unloadable is not None:
                reason = f"a worker cannot load the function ({answer.unloadable})"
                self._fail(WorkersGoneError(f"{reason}; install its modules there", False))
            else:
                with contextlib.suppress(Exception):  # it was cancelled meanwhile
                    self.result.set_result(answer)

    def _send(self) -> None:
        """Repeat the call with the function, which the worker lacks."""
        try:
            payload = self.pickled()
        except Exception as error:  # noqa: BLE001 -- any error of pickling
            reason = f"the function cannot be sent to workers ({Raised.of(error).line})"
            self._fail(WorkersGoneError(f"{reason}; give a ThreadPoolExecutor", False))
        else:
            self.submit(payload)

    def _fail(self, error: WorkerLostError) -> None:
        with contextlib.suppress(Exception):  # it was cancelled meanwhile
            self.result.set_exception(error)


def value_of(future: Future[Answer], check: Callable[[], object] = lambda: None) -> Any:
    """Wait for the value of a call in steps, so that signals are handled; raise its exception.

    `check` is called after each step, and may raise.
    """
    while not future.done():
        wait([future], LOOK)
        check()
    answer = future.result()
    if answer.raised is not None:
        raise answer.raised.as_error()
    return answer.value


class MapExecutor(Executor):
    """Executor around a callable like `map`: `flush` makes the calls."""

    def __init__(self, mapped: Callable[..., Iterable[Any]]) -> None:
        self._map = mapped
        self._waiting: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Store a call until `flush`."""
        future: Future[Any] = Future()
        self._waiting.append((future, functools.partial(fn, *args, **kwargs)))
        return future

    def flush(self) -> None:
        """Make all stored calls, and calls that these submit."""
        while self._waiting:
            calls, self._waiting = self._waiting, []
            calls = [call for call in calls if call[0].set_running_or_notify_cancel()]
            try:
                values = self._map(operator.call, [call for _, call in calls])
                for (future, _), value in zip(calls, values, strict=True):
                    future.set_result(value)
            except BaseException as error:
                for future, _ in calls:
                    if not future.done():
                        future.set_exception(WorkersGoneError(_broken(error), again=False))
                if not isinstance(error, Exception):  # for example, a second Ctrl-C
                    raise


def _pickled(function: Callable[[Any], Any]) -> bytes:
    # Multiprocessing has a second name for the main file. Workers would use it to look up objects
    # that the main file imports or that name no module, for example functions of SciPy.
    main = sys.modules.pop("__mp_main__", None)
    try:
        return bytes(cloudpickle.dumps(function))
    finally:
        if main is not None:
            sys.modules["__mp_main__"] = main


def _broken(error: BaseException) -> str:
    """The reason why an executor accepts no more calls, in one line."""
    if isinstance(error, WorkerLostError):
        return str(error)
    import asyncio  # only here: it is slow to import

    if isinstance(error, (CancelledError, asyncio.CancelledError)):
        return "the workers or their scheduler have left; give new workers"
    return f"the executor is broken ({Raised.of(error).line}); give a new one"


def lost(error: BaseException) -> Raised:
    """Failure that stands for a value whose worker has ended."""
    overdue = getattr(error, "overdue", False)
    return Raised(WorkerLostError.__name__, str(error), of_machine=True, overdue=overdue)
