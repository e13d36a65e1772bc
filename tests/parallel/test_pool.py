"""Calls by workers of every kind: what they give, what travels, and how they end."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, redirect_stderr
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from miho.parallel import Workers, open_pool
from miho.parallel.pool import DAEMONIC, EXPECTED, TRIES
from miho.parallel.process_executor import WorkerLostError, WorkersGoneError, processes_of
from miho.parallel.processes import descendants
from miho.parallel.remote import MOST_SHARED, shared, work

CONTEXT = multiprocessing.get_context("forkserver")


@pytest.fixture(autouse=True)
def _collect_pools() -> Iterator[None]:
    """Collect each `multiprocessing.Pool` after its test.

    A pool is part of a reference cycle. Python 3.13 warns if its semaphores are collected while the
    next pool registers semaphores of its own.
    """
    yield
    gc.collect()


@contextmanager
def _processes() -> Iterator[Workers]:
    with ProcessPoolExecutor(2, mp_context=CONTEXT) as executor:
        yield executor


@contextmanager
def _threads() -> Iterator[Workers]:
    with ThreadPoolExecutor(2) as executor:
        yield executor


@contextmanager
def _pool_map() -> Iterator[Workers]:
    with CONTEXT.Pool(2) as pool:
        yield pool.map


@contextmanager
def _itself(workers: Workers) -> Iterator[Workers]:
    yield workers


KINDS: dict[str, Callable[[], Any]] = {
    "number": lambda: _itself(2),
    "text": lambda: _itself("2"),
    "all cores": lambda: _itself(-1),
    "threads": _threads,
    "processes": _processes,
    "map": lambda: _itself(map),
    "pool.map": _pool_map,
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_workers_calls_closures_in_order(kind: str) -> None:
    factor = np.arange(3.0)
    with KINDS[kind]() as workers, open_pool(workers) as pool:
        if pool is None:  # one core
            return
        values = list(pool.map(lambda x: factor * x, range(7)))
        with pytest.raises(ValueError, match=r"^negative: -1$") as raised:
            list(pool.map(_root, [4.0, -1.0]))
    assert np.array_equal(values, [factor * x for x in range(7)])
    assert type(raised.value).__name__ == "OddError"


class OddError(Exception):
    """One that cannot be made anew from its message, as unpickling would."""

    def __init__(self, number: float, reason: str) -> None:
        super().__init__(f"{reason}: {number:g}")


def _root(x: float) -> float:
    if x < 0:
        raise OddError(x, "negative")
    return float(np.sqrt(x))


@pytest.mark.parametrize(
    "workers",
    [0, -2, 1.5, True, "", "two", [], {}, np.inf, np.nan, Ellipsis, ThreadPoolExecutor, "0"],
    ids=repr,
)
def test_workers_that_are_none_are_refused_in_one_line(workers: Any) -> None:
    with pytest.raises(ValueError, match=r"worker|address") as refused, open_pool(workers):
        pass
    assert "\n" not in str(refused.value)
    assert EXPECTED in str(refused.value) or isinstance(workers, str)


def test_one_worker_is_none() -> None:
    for workers in (None, 1, "1", 1.0):
        with open_pool(workers) as pool:
            assert pool is None


def _own_pool(sender: Any) -> None:
    """Send how many workers a pool of this process has, what they give, and what was said."""
    with redirect_stderr(StringIO()) as said, open_pool(2) as pool:
        given = None if pool is None else [*pool.map(abs, (-3, -4))]
        sender.send((pool and pool.size, given, said.getvalue()))


def _fork_own_pool(sender: Any) -> None:
    """As above, and again in a process that is forked from one that has started workers."""
    _own_pool(sender)
    child = os.fork()
    if not child:
        try:
            _own_pool(sender)
        finally:
            os._exit(0)
    os.waitpid(child, 0)


def _answers(target: Callable[[Any], None], daemon: bool, count: int) -> list[Any]:
    """What a process sends that calls the target."""
    receiver, sender = CONTEXT.Pipe(duplex=False)
    process = CONTEXT.Process(target=target, args=(sender,), daemon=daemon)
    process.start()
    sender.close()
    try:
        return [receiver.recv() for _ in range(count)]
    finally:
        process.join()


def test_a_daemonic_process_makes_evaluations_itself_and_says_so() -> None:
    said = f"miho: workers=2: {DAEMONIC}\n"
    assert _answers(_own_pool, daemon=True, count=1) == [(None, None, said)]


def test_a_forked_process_starts_workers_of_its_own() -> None:
    """The server of workers is its parent's, which serves nobody else."""
    assert _answers(_fork_own_pool, daemon=False, count=2) == 2 * [(2, [3, 4], "")]


def test_how_many_calls_at_a_time() -> None:
    with ThreadPoolExecutor(3) as executor, CONTEXT.Pool(2) as pool:
        assert processes_of(executor) == processes_of(executor.map) == 3
        assert processes_of(pool.map) == processes_of(pool.imap) == 2
        assert processes_of(map) == 1


class Travelling:
    """Data that note in a file by which process they were unpacked."""

    def __init__(self, log: Path) -> None:
        self.log, self.table = log, np.arange(10_000.0)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ = state
        with self.log.open("a") as file:
            file.write(f"{os.getpid()}\n")

    def __call__(self, k: int) -> float:
        return float(self.table[k])


def test_data_travel_once_to_each_process(tmp_path: Path) -> None:
    with open_pool(2) as pool:
        assert pool is not None
        assert list(pool.map(Travelling(tmp_path / "log"), range(50))) == list(range(50))
    arrivals = (tmp_path / "log").read_text().split()
    assert len(arrivals) == len(set(arrivals)) <= 2
    with ThreadPoolExecutor(2) as threads, open_pool(threads) as pool:
        assert pool is not None
        assert list(pool.map(Travelling(tmp_path / "none"), range(9))) == list(range(9))
    assert not (tmp_path / "none").exists(), "threads have the data already"
    assert not shared, "what was shared goes with its pool"


def test_a_process_keeps_the_functions_that_it_used_last() -> None:
    import cloudpickle

    pickled = cloudpickle.dumps(abs)
    try:
        for k in range(MOST_SHARED):
            assert work(f"token {k}", pickled, -k).value == k
        assert work("token 0", None, -9).value == 9
        work("one more", pickled, 0)
        assert work("token 0", None, -9).value == 9
        assert work("token 1", None, 0).lacks
        assert len(shared) == MOST_SHARED
    finally:
        shared.clear()


def test_what_cannot_be_pickled_is_said_in_one_line_and_threads_can_do_it() -> None:
    lock = threading.Lock()

    def locked(x: float) -> float:
        with lock:
            return -x

    with open_pool(2) as pool:
        assert pool is not None
        with pytest.raises(WorkersGoneError, match=r"cannot be sent to workers.*lock") as refused:
            list(pool.map(locked, [1.0]))
    assert "\n" not in str(refused.value)
    with ThreadPoolExecutor(2) as threads, open_pool(threads) as pool:
        assert pool is not None
        assert list(pool.map(locked, [1.0])) == [-1.0]


class Unloadable:
    """As of a module that only this machine has."""

    def __reduce__(self) -> Any:
        return __import__, ("not_installed_there",)

    def __call__(self, x: float) -> float:
        return x


def test_what_cannot_be_loaded_by_a_worker_is_said_in_one_line() -> None:
    with open_pool(2) as pool:
        assert pool is not None
        with pytest.raises(WorkersGoneError, match=r"cannot load.*not_installed_there"):
            list(pool.map(Unloadable(), [1.0]))


class MuteError(Exception):
    """One that raises when it is to say what it is."""

    def __str__(self) -> str:
        raise RuntimeError("not even this")


def _mute(x: float) -> float:
    raise MuteError


def test_an_exception_that_says_nothing_is_told_by_its_name() -> None:
    with open_pool(2) as pool:
        assert pool is not None
        with pytest.raises(ValueError, match="no message") as raised:
            list(pool.map(_mute, [1.0]))
        assert list(pool.map(abs, [-1.0])) == [1.0]
    assert type(raised.value).__name__ == "MuteError"


def _large(megabytes: int) -> Any:
    return np.full(megabytes << 17, 1.5)


def test_large_results_come_whole() -> None:
    with open_pool(2) as pool:
        assert pool is not None
        assert [value.nbytes for value in pool.map(_large, [16, 1])] == [16 << 20, 1 << 20]


def _die(x: float) -> float:
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def test_a_call_that_kills_its_worker_each_time_is_lost_alone() -> None:
    with open_pool(2) as pool:
        assert pool is not None
        call = pool.share(_die)
        futures = [call(float(x)) for x in range(6)]
        with pytest.raises(WorkerLostError, match="SIGKILL"):
            futures[3].result(60)
        others = [f.result(60).value for k, f in enumerate(futures) if k != 3]
    assert others == [0, 1, 2, 4, 5]


def test_idle_processes_that_were_killed_are_replaced() -> None:
    with open_pool(2) as pool:
        assert pool is not None
        for process in set(pool.map(_pid, range(8))):
            os.kill(process, signal.SIGKILL)
        assert list(pool.map(abs, [-1, -2])) == [1, 2]


class ByHand(Executor):
    """Calls that are done when the test says so."""

    def __init__(self) -> None:
        self.calls: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.calls.append((future, lambda: fn(*args, **kwargs)))
        return future


def test_a_call_is_tried_so_many_times_and_is_not_more() -> None:
    executor = ByHand()
    with open_pool(executor) as pool:
        assert pool is not None
        future = pool.share(abs)(-2)
        for k in range(TRIES):
            assert len(executor.calls) == k + 1
            executor.calls[-1][0].set_exception(WorkerLostError("it is gone"))
        with pytest.raises(WorkerLostError, match="it is gone"):
            future.result(0)
        future = pool.share(abs)(-2)
    assert future.cancelled()
    assert executor.calls[-1][0].cancelled()


def test_a_broken_executor_says_so_in_one_line() -> None:
    with ProcessPoolExecutor(1, mp_context=CONTEXT) as executor, open_pool(executor) as pool:
        assert pool is not None
        for arguments in ([3.0], [1.0]):  # it stays broken
            with pytest.raises(WorkersGoneError, match=r"broken.*give a new one"):
                list(pool.map(_die, arguments))
    threads = ThreadPoolExecutor(1)
    threads.shutdown()
    with (
        open_pool(threads) as pool,
        pytest.raises(WorkersGoneError, match=r"broken.*give a new one"),
    ):
        assert pool is not None
        list(pool.map(abs, [1.0]))


def test_calls_that_an_executor_drops_do_not_wait_for_ever() -> None:
    executor = ByHand()
    with open_pool(executor) as pool:
        assert pool is not None
        future = pool.share(abs)(-2)
        executor.calls[0][0].cancel()
        with pytest.raises(WorkersGoneError, match="have left"):
            future.result(0)


@pytest.mark.parametrize(
    "broken", [lambda function, calls: 1 / 0, lambda function, calls: []], ids=["raises", "stops"]
)
def test_a_map_that_fails_does_not_leave_calls_waiting(broken: Any) -> None:
    with open_pool(broken) as pool:
        assert pool is not None
        with pytest.raises(WorkersGoneError, match="broken"):
            list(pool.map(abs, [1.0, 2.0]))


def test_pools_of_several_threads_do_not_disturb_each_other() -> None:
    """Each starts processes, for which the main module is hidden for a moment."""
    main, sums = sys.modules["__main__"], []

    def use_one() -> None:
        with open_pool(2) as pool:
            assert pool is not None
            sums.append(sum(pool.map(lambda x: x + 1, range(10))))

    threads = [threading.Thread(target=use_one) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert sums == [55] * 3
    assert sys.modules["__main__"] is main


def test_processes_end_with_their_pool() -> None:
    before = set(descendants(os.getpid()))
    with open_pool(2) as pool:
        assert pool is not None
        pids = set(pool.map(_pid, range(8)))
    assert pids
    assert not pids & set(descendants(os.getpid())) - before


def _pid(_: int) -> int:
    return os.getpid()
