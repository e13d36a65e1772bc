"""Processes behind the interface of executors: losses, ends, and what must not wait for ever."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from miho.parallel.process_executor import (
    OverdueError,
    ProcessExecutor,
    WorkerLostError,
    WorkersGoneError,
)
from miho.parallel.processes import descendants
from miho.parallel.workers import Workers

WAIT = 60.0


@pytest.fixture
def executor() -> Iterator[ProcessExecutor]:
    with ProcessExecutor(2) as executor:
        yield executor


def _wait_to_be_killed(place: str) -> int:
    Path(place).write_text(str(os.getpid()))
    while not Path(place + ".go").exists():
        time.sleep(0.02)
    return 7


def _written(path: Path) -> int:
    until = time.monotonic() + WAIT
    while time.monotonic() < until:
        if path.exists() and (text := path.read_text()):
            return int(text)
        time.sleep(0.02)
    raise TimeoutError(path)


def test_only_the_call_of_a_killed_process_is_lost(
    executor: ProcessExecutor, tmp_path: Path
) -> None:
    first, second = (
        executor.submit(_wait_to_be_killed, str(tmp_path / name)) for name in ("1", "2")
    )
    os.kill(_written(tmp_path / "1"), signal.SIGKILL)
    with pytest.raises(WorkerLostError, match="SIGKILL") as lost:
        first.result(WAIT)
    assert lost.value.again
    (tmp_path / "2.go").touch()
    assert second.result(WAIT) == 7
    assert executor.submit(abs, -3).result(WAIT) == 3


def _exit_while_loading() -> Any:
    os._exit(5)


class DiesWhileLoading:
    """As a module that ends the process that imports it."""

    def __reduce__(self) -> Any:
        return _exit_while_loading, ()

    def __call__(self) -> None:
        pass


def test_a_process_that_dies_while_it_loads_its_work_is_told(executor: ProcessExecutor) -> None:
    with pytest.raises(WorkerLostError, match="exit code 5"):
        executor.submit(DiesWhileLoading()).result(WAIT)


def _lock() -> Any:
    return threading.Lock()


def _exit() -> None:
    raise SystemExit(7)


@pytest.mark.parametrize(("call", "reason"), [(_lock, "pickle"), (_exit, r"sys.exit\(7\)")])
def test_what_a_call_does_itself_is_told_and_not_tried_again(
    executor: ProcessExecutor, call: Any, reason: str
) -> None:
    with pytest.raises(WorkerLostError, match=reason) as lost:
        executor.submit(call).result(WAIT)
    assert not lost.value.again
    assert "\n" not in str(lost.value)


def test_a_call_that_takes_too_long_is_killed_and_the_others_are_done() -> None:
    with ProcessExecutor(2, time_limit=0.3) as executor:
        long, short = executor.submit(time.sleep, 600), executor.submit(abs, -3)
        with pytest.raises(OverdueError, match=r"no end within 0.3 s") as overdue:
            long.result(WAIT)
        assert not overdue.value.again
        assert short.result(WAIT) == 3


def test_any_number_of_calls_can_wait_while_a_process_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """More than a pipe has room for messages; whoever is blocked by it would hold the lock."""
    executor, started = ProcessExecutor(1), threading.Event()
    monkeypatch.setattr(Workers, "start", lambda workers, job: started.wait(WAIT))
    submitting = threading.Thread(
        target=lambda: [executor.submit(abs, -1) for _ in range(20_000)], daemon=True
    )
    submitting.start()
    submitting.join(WAIT)
    assert not submitting.is_alive()
    started.set()
    executor.shutdown()


def test_processes_that_cannot_be_started_are_told(
    executor: ProcessExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(workers: object, job: object) -> None:
        raise OSError("no memory left")

    monkeypatch.setattr(Workers, "start", fail)
    with pytest.raises(WorkersGoneError, match="could be started: no memory left"):
        executor.submit(abs, -3).result(WAIT)


def test_nobody_waits_for_a_thread_that_has_failed(
    executor: ProcessExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise MemoryError("none left")

    monkeypatch.setattr(Workers, "wait", fail)
    with pytest.raises(WorkersGoneError, match="failed: MemoryError: none left"):
        executor.submit(abs, -3).result(WAIT)
    until = time.monotonic() + WAIT
    while executor._thread is not None and executor._thread.is_alive():
        assert time.monotonic() < until
    with pytest.raises(WorkersGoneError, match="failed: MemoryError: none left"):
        executor.submit(abs, -3)


def test_shutdown_ends_calls_and_processes_at_once(tmp_path: Path) -> None:
    executor = ProcessExecutor(1)
    running = executor.submit(_wait_to_be_killed, str(tmp_path / "1"))
    waiting = executor.submit(abs, -3)
    process = _written(tmp_path / "1")
    executor.shutdown()
    assert waiting.cancelled()
    with pytest.raises(WorkersGoneError, match="have ended"):
        running.result(0)
    assert process not in descendants(os.getpid())
    with pytest.raises(WorkersGoneError, match="have ended"):
        executor.submit(abs, -3)
    executor.shutdown()
