"""Workers by the ecosystem's convention: a number, an executor, a map, or a cluster's address."""

from __future__ import annotations

import contextlib
import functools
import itertools
import multiprocessing
import os
import sys
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import ExitStack, contextmanager
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
"""A number of processes (-1: one for each core), an executor of `concurrent.futures`, a callable
like `map`, or the address of a cluster (`dask://HOST:PORT`, `dask:4`, `slurm:10`)."""
TRIES = 3
"""How often a call is tried whose worker ends without an answer."""
SMALL = 1 << 14
"""Bytes of a function that cost nothing to send beside the call itself."""
LOOK = 0.1
"""Seconds between two looks whether anybody wants to stop."""
EXPECTED = (
    "a number of processes, -1 for one per core, an executor, a callable like map, or an address "
    "such as 'dask://HOST:PORT', 'dask:4' or 'slurm:10'"
)


DAEMONIC = (
    "this process is daemonic, as those of multiprocessing.Pool are, and may start no other; it "
    "makes all evaluations itself, without a limit of time. Give a ThreadPoolExecutor or an "
    "address instead"
)


@contextmanager
def open_pool(workers: Workers, time_limit: float | None = None) -> Iterator[Pool | None]:
    """The pool of some workers, which ends with the context if it was begun here; None for one.

    A call that takes longer than `time_limit` seconds is killed, with its process where that is
    ours; of others `Pool.limit` says what they do not end themselves. A daemonic process, such as a
    worker of `multiprocessing.Pool`, may start no other: it has one worker, itself. Raises
    ValueError for workers that are none of the kinds.
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
    """So many processes; raises ValueError where that is no number of them."""
    try:
        count = 1 if workers is None else int(workers)
        if isinstance(workers, bool) or (count != -1 and count < 1) or count != float(workers or 1):
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"workers is {workers!r}; expected {EXPECTED}") from None
    return len(os.sched_getaffinity(0)) if count == -1 else count


class Pool:
    """`size` workers that call shared functions, which travel to each of them once.

    A call that takes longer than `limit` seconds is for its caller to give up; None where the
    workers do so themselves.
    """

    def __init__(self, executor: Executor, size: int, limit: float | None = None) -> None:
        self.size, self.limit = size, limit
        self._executor = executor
        self.connected: Callable[[], bool] = lambda: True
        self.empty: Callable[[], bool] = lambda: False
        self._pending: set[Future[Answer]] = set()
        self._tokens: list[str] = []

    def share(self, function: Callable[[Any], Any]) -> Callable[[Any], Future[Answer]]:
        """What has the function called by a worker, with an argument.

        The answer says what it raised. A call whose worker ended is tried again; if that happens
        TRIES times, the future raises WorkerLostError. It raises WorkersGoneError where no call
        can be done any more: the executor is broken, or the function cannot be sent.
        """
        token = uuid.uuid4().hex
        shared[token] = function  # for workers that are threads of this process
        self._tokens.append(token)
        pickled = functools.cache(functools.partial(_pickled, function))
        calls = itertools.count()
        return lambda argument: self._call(token, pickled, argument, next(calls) < self.size)

    def map(self, function: Callable[[Any], Any], arguments: Iterable[Any]) -> Iterator[Any]:
        """What a function gives for each argument, in their order; raises what it raises."""
        call = self.share(function)
        futures = [call(argument) for argument in arguments]
        self.flush()
        try:
            for future in futures:
                while not future.done():  # so that signals are seen
                    wait([future], LOOK)
                answer = future.result()
                if answer.raised is not None:
                    raise answer.raised.as_error()
                yield answer.value
        finally:
            for future in futures:
                future.cancel()

    def wait(self, news: threading.Event) -> None:
        """Wait until there is `news` of calls, but no longer than until somebody may want to stop.

        What has ended is to be looked for afterwards.
        """
        news.wait(LOOK)
        news.clear()

    def flush(self) -> None:
        """Have calls done that wait for others, where workers take several at once only."""
        if isinstance(self._executor, MapExecutor):
            self._executor.flush()

    def close(self) -> None:
        """Cancel what is not done."""
        for future in list(self._pending):
            future.cancel()
        for token in self._tokens:
            shared.pop(token, None)

    def _call(
        self, token: str, pickled: Callable[[], bytes], argument: Any, first: bool
    ) -> Future[Answer]:
        """A call; the function goes with the `first` ones, so that each worker may get it, and with
        all of them if it is small: calls that lack it wait in the queue a second time."""
        payload = None
        if not isinstance(self._executor, ThreadPoolExecutor):
            with contextlib.suppress(Exception):  # it is told where a worker lacks the function
                payload = pickled() if first or len(pickled()) <= SMALL else None
        if isinstance(self._executor, ProcessExecutor) and not self._executor.started and payload:
            self._executor.load_at_start(payload)
        result: Future[Answer] = Future()
        self._pending.add(result)
        result.add_done_callback(self._pending.discard)
        tries = itertools.count(1)

        def submit(payload: bytes | None) -> None:
            if result.cancelled():
                return
            try:
                inner = self._executor.submit(work, token, payload, argument)
            except Exception as error:  # noqa: BLE001 -- whatever an executor raises that has ended
                _fail(result, WorkersGoneError(_broken(error), again=False))
                return
            inner.add_done_callback(partial_answer)
            result.add_done_callback(lambda _: inner.cancel())  # where it is given up

        def partial_answer(inner: Future[Answer]) -> None:
            try:
                answer = inner.result()
            except WorkerLostError as error:
                if error.again and next(tries) < TRIES:
                    submit(payload)
                else:
                    _fail(result, error)
                return
            except BaseException as error:  # noqa: BLE001 -- of a foreign executor
                _fail(result, _foreign(error))
                return
            if answer.lacks:
                send()
            elif answer.unloadable is not None:
                reason = f"a worker cannot load what it is to evaluate ({answer.unloadable})"
                _fail(result, WorkersGoneError(f"{reason}; install there what it needs", False))
            else:
                with contextlib.suppress(Exception):  # it was cancelled meanwhile
                    result.set_result(answer)

        def send() -> None:
            try:
                payload = pickled()
            except Exception as error:  # noqa: BLE001 -- whatever pickling raises
                reason = f"what is evaluated cannot be sent to workers ({Raised.of(error).line})"
                _fail(result, WorkersGoneError(f"{reason}; give a ThreadPoolExecutor", False))
            else:
                submit(payload)

        submit(payload)
        return result


class MapExecutor(Executor):
    """A callable like `map` behind the interface of executors: calls are done at `flush`."""

    def __init__(self, mapped: Callable[..., Iterable[Any]]) -> None:
        self._map = mapped
        self._waiting: list[tuple[Future[Any], Any]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Remember a call."""
        future: Future[Any] = Future()
        self._waiting.append((future, (fn, args)))
        return future

    def flush(self) -> None:
        """Do all calls, and those that follow from them."""
        while self._waiting:
            calls, self._waiting = self._waiting, []
            calls = [call for call in calls if call[0].set_running_or_notify_cancel()]
            try:
                values = self._map(_apply, [call for _, call in calls])
                for (future, _), value in zip(calls, values, strict=True):
                    future.set_result(value)
            except BaseException as error:
                for future, _ in calls:
                    if not future.done():
                        future.set_exception(WorkersGoneError(_broken(error), again=False))
                if not isinstance(error, Exception):  # such as a second Ctrl-C
                    raise


def _apply(call: tuple[Callable[..., Any], Sequence[Any]]) -> Any:
    function, args = call
    return function(*args)


def _pickled(function: Callable[[Any], Any]) -> bytes:
    # Multiprocessing has another name for the main file, by which workers would look for what that
    # imports and what has no module of its own, such as SciPy's functions.
    main = sys.modules.pop("__mp_main__", None)
    try:
        return bytes(cloudpickle.dumps(function))
    finally:
        if main is not None:
            sys.modules["__mp_main__"] = main


def _foreign(error: BaseException) -> WorkerLostError:
    """What it means that an executor of another library gives this instead of an answer."""
    if isinstance(error, (BrokenExecutor, CancelledError)) or not isinstance(error, Exception):
        return WorkersGoneError(_broken(error), again=False)
    return WorkerLostError(Raised.of(error).line, again=False)


def _broken(error: BaseException) -> str:
    """In one line what it means that an executor takes no more calls."""
    if isinstance(error, WorkerLostError):
        return str(error)
    import asyncio  # only here: it is slow to import

    if isinstance(error, (CancelledError, asyncio.CancelledError)):
        return "the workers or their scheduler have left; give workers anew"
    return f"the executor is broken ({Raised.of(error).line}); give a new one"


def _fail(result: Future[Answer], error: WorkerLostError) -> None:
    with contextlib.suppress(Exception):  # it was cancelled meanwhile
        result.set_exception(error)


def lost(error: BaseException) -> Raised:
    """What is told of a value whose worker is gone."""
    overdue = getattr(error, "overdue", False)
    return Raised(WorkerLostError.__name__, str(error), of_machine=True, overdue=overdue)
