"""Whatever a job does to its process, the others are done and the reason is told."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import pytest

from miho.parallel.pool import open_pool
from miho.parallel.processes import descendants
from miho.parallel.worker_process import INTERRUPTED
from miho.parallel.workers import JobOutcome, Workers, start_server
from tests.faults.misbehaviour import misbehave, spoil

if TYPE_CHECKING:
    from experiments.app.cluster_workers import ClusterWorkers

Result = TypeVar("Result")
WAIT = 120.0
MODULES = ("tests.faults.misbehaviour",)


def all_of(
    jobs: list[str], workers: Workers[str, Result] | ClusterWorkers[str, Result]
) -> dict[str, JobOutcome[str, Result]]:
    """Outcomes of the jobs, of which each begins as soon as a worker is idle."""
    ended: dict[str, JobOutcome[str, Result]] = {}
    todo, until = list(jobs), time.monotonic() + WAIT
    while (todo or workers.busy) and time.monotonic() < until:
        while todo and workers.idle:
            workers.start(todo.pop(0))
        ended |= {outcome.job: outcome for outcome in workers.wait(1)}
    return ended


def wait_for(places: list[Path], workers: Workers[str, None]) -> None:
    until = time.monotonic() + WAIT
    while not all(place.exists() for place in places):
        assert not workers.wait(0.05)
        assert time.monotonic() < until


def with_workers(job: str) -> int:
    """A job whose function is called by worker processes of its own."""
    with open_pool(2) as pool:
        assert pool is not None
        return sum(pool.map(len, [job, job]))


@pytest.mark.parametrize("alone", [None, bool])
def test_a_job_may_have_workers_of_its_own(alone: Callable[[str], bool] | None) -> None:
    with Workers(with_workers, 1, alone=alone, modules=MODULES) as workers:
        ended = all_of(["four"], workers)
    assert ended["four"].result == 8, ended["four"].reason


def test_a_job_that_goes_wrong_is_lost_alone() -> None:
    bad = {
        "exit": "sys.exit(7)",
        "leave": "its process ended with exit code 9",
        "kill": "killed by SIGKILL, perhaps out of memory",
        "hang": "no end within 2 s, so it was killed",
        "raise": "ValueError: no good",
        "memory": "MemoryError: ",
    }
    good = [f"good {k}" for k in range(14)]
    with Workers(misbehave, 2, time_limit=2, modules=MODULES) as workers:
        ended = all_of([*good[:7], *bad, *good[7:]], workers)
        left = [worker.process for worker in workers._workers]
    assert {job: outcome.result for job, outcome in ended.items() if outcome.reason is None} == {
        job: job for job in good
    }
    assert {
        job: outcome.reason for job, outcome in ended.items() if outcome.reason is not None
    } == bad
    assert "ValueError: no" in (ended["raise"].detail or "")
    assert not any(process.is_alive() for process in left)


def test_an_interrupt_reaches_the_job_and_a_kill_ends_it(tmp_path: Path) -> None:
    """Each job leaves a file when it has begun, and then hangs, in many short sleeps: a signal that
    comes just before one, after Python last looked for signals, is heard when it is over.
    """
    hang = "import pathlib, time\npathlib.Path({!r}).touch()\nwhile True: time.sleep(0.05)"
    begun = [tmp_path / name for name in ("first", "second", "third")]
    with Workers[str, None](exec, 2) as workers:
        for place in begun[:2]:
            workers.start(hang.format(str(place)))
        assert workers.idle == 0
        wait_for(begun[:2], workers)
        workers.interrupt()
        ended = all_of([], workers)
        assert [outcome.interrupted for outcome in ended.values()] == [True, True]
        assert {outcome.reason for outcome in ended.values()} == {INTERRUPTED}
        workers.start(hang.format(str(begun[2])))
        wait_for(begun[2:], workers)
        workers.kill()
        assert workers.busy == 0
    assert not [
        outcome for outcome in multiprocessing.active_children() if "Workers" in outcome.name
    ]


def test_a_job_that_has_not_begun_is_interrupted_too() -> None:
    with Workers(misbehave, 1, modules=MODULES) as workers:
        workers.start("good")
        workers.interrupt()
        ended, until = [], time.monotonic() + WAIT
        while not ended and time.monotonic() < until:
            ended = workers.wait(1)
        assert [outcome.interrupted or outcome.result == "good" for outcome in ended] == [True]
        workers.start("good")
        assert all_of([], workers)["good"].result == "good"


def test_jobs_that_are_alone_leave_nothing_behind() -> None:
    with Workers(spoil, 1, modules=MODULES, alone=bool) as workers:
        jobs = ["spoil", "first", "second"]
        ended = {}
        for job in jobs:
            ended |= all_of([job], workers)
        (worker,) = workers._workers
        assert worker.process.pid is not None
        assert descendants(worker.process.pid) == [], "what a job started has ended with it"
    values = {job: outcome.result for job, outcome in ended.items() if outcome.result is not None}
    assert {job: value[1] for job, value in values.items()} == {
        "spoil": 0.5, "first": math.e, "second": math.e
    }  # fmt: skip
    assert len({value[0] for value in values.values()}) == 3


def test_a_temporary_folder_too_long_for_sockets_is_said_in_one_line(tmp_path: Path) -> None:
    folder = tmp_path / ("d" * 100)  # the address of a socket has 108 bytes
    folder.mkdir()
    program = "from miho.parallel.workers import start_server; start_server([])"
    ended = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | {"TMPDIR": str(folder)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.stderr.splitlines()[-1] == (
        f"OSError: TMPDIR: {folder} is too long for the sockets of workers ({len(str(folder))} "
        "characters); set it to a shorter path, for example /tmp"
    )


def test_the_server_ignores_interrupts_while_it_imports(monkeypatch: pytest.MonkeyPatch) -> None:
    handlers: list[object] = []
    start = lambda: handlers.append(signal.getsignal(signal.SIGINT))  # noqa: E731
    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr("multiprocessing.forkserver.ensure_running", start)
    start_server([])
    assert handlers == [signal.SIG_IGN]
    assert signal.getsignal(signal.SIGINT) is before


def test_the_server_starts_in_a_program_that_embeds_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python cannot set a handler of Ctrl-C that it does not know."""
    monkeypatch.setattr("multiprocessing.forkserver.ensure_running", lambda: None)
    monkeypatch.setattr("signal.getsignal", lambda number: None)
    start_server([])
