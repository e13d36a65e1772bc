"""Whatever a job does to its process, the others are done and the reason is told."""

import multiprocessing
import time

from experiments.faults.misbehaviour import misbehave
from miho.study.workers import Ended, Workers

WAIT = 60.0
MODULES = ("experiments.faults.misbehaviour",)


def all_of(jobs: list[str], workers: Workers[str, str]) -> dict[str, Ended[str, str]]:
    todo, ended, until = list(jobs), {}, time.monotonic() + WAIT
    while (todo or workers.busy) and time.monotonic() < until:
        while todo and workers.idle:
            workers.start(todo.pop(0))
        ended |= {one.job: one for one in workers.wait(1)}
    return ended


def test_a_job_that_goes_wrong_is_lost_alone() -> None:
    bad = {
        "exit": "sys.exit(7)",
        "leave": "its process ended with exit code 9",
        "kill": "killed by SIGKILL, perhaps for want of memory",
        "hang": "no end within 0.5 s, so it was killed",
        "raise": "ValueError: no good",
        "memory": "MemoryError: ",
    }
    good = [f"good {k}" for k in range(14)]
    with Workers(misbehave, 2, time_limit=0.5, modules=MODULES) as workers:
        ended = all_of([*good[:7], *bad, *good[7:]], workers)
        left = [worker.process for worker in workers._workers]
    assert {job: one.result for job, one in ended.items() if one.reason is None} == {
        job: job for job in good
    }
    assert {job: one.reason for job, one in ended.items() if one.reason is not None} == bad
    assert "ValueError: no" in (ended["raise"].detail or "")
    assert not any(process.is_alive() for process in left)


def test_an_interrupt_reaches_the_job_and_a_kill_ends_it() -> None:
    with Workers(misbehave, 2, modules=MODULES) as workers:
        workers.start("hang")
        workers.start("hang")
        assert workers.idle == 0
        assert not workers.wait(0.01)
        time.sleep(0.2)
        until, ended = time.monotonic() + WAIT, []
        while workers.busy and time.monotonic() < until:
            workers.interrupt()
            ended += workers.wait(0.2)
        assert [one.interrupted for one in ended] == [True, True]
        workers.start("hang")
        workers.kill()
        assert workers.busy == 0
    assert not [one for one in multiprocessing.active_children() if "Workers" in one.name]


def test_a_job_that_has_not_begun_is_interrupted_too() -> None:
    with Workers(misbehave, 1, modules=MODULES) as workers:
        workers.start("good")
        workers.interrupt()
        ended, until = [], time.monotonic() + WAIT
        while not ended and time.monotonic() < until:
            ended = workers.wait(1)
        assert [one.interrupted or one.result == "good" for one in ended] == [True]
        workers.start("good")
        assert all_of([], workers)["good"].result == "good"
