"""R27 to R31: workers that are killed, run out of memory, hang, leave, and are interrupted."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from miho.methods import PSO
from miho.optim import Budget, Outcome, RandomSearch, RunRecord, minimize
from tests.faults.commands import CHECKOUT, alive, descendants, forked
from tests.faults.conftest import Figures
from tests.faults.worker_models import POLL, Failing, logged
from tests.parallel.expensive import same

WORKERS, BUDGET, PATIENCE, ALLOWED = 4, Budget(evaluations=80), 60.0, 5.0
LONG = 600.0
"""Seconds for an evaluation that is not meant to be given up; with a limit, workers make each."""
HUNG = 0.5


@pytest.mark.fault(
    row="R27",
    fault="workers killed with -9 in the middle of an evaluation",
    promise="the run goes on, same result to the last bit, nothing counted twice",
)
def test_killed_workers(tmp_path: Path, measured: Figures) -> None:
    """A tenth of all rows wait until their process is killed, then are evaluated by another."""
    alone = minimize(PSO(particles=10), Failing(_new(tmp_path / "alone"), "doomed"), BUDGET)
    problem = Failing(_new(tmp_path / "shared"), "doomed")
    with _killing(problem.folder) as killed:
        record = minimize(
            PSO(particles=10), problem, BUDGET, workers=WORKERS, evaluation_limit=LONG
        )
    once, done = logged(tmp_path / "alone", "done"), logged(problem.folder, "done")
    measured(
        f"{len(killed)} workers killed in {record.evaluations:g} evaluations: "
        f"{'same' if same(alone, record) else 'another'} result, "
        f"{sum(record.rejected.values())} lost, {(done - once).total()} made twice"
    )
    assert same(alone, record)
    assert len(killed) >= 3
    assert not record.rejected
    assert done == once


@pytest.mark.fault(
    row="R28",
    fault="a worker out of memory, each time for some configurations",
    promise="each is lost in one line, the others go on",
)
def test_workers_out_of_memory(tmp_path: Path, measured: Figures) -> None:
    """One in twenty finds a limit, one in twenty is killed by the system: all else is the same."""
    alone = minimize(RandomSearch(), Failing(_new(tmp_path / "1"), "none", share=0.1), BUDGET)
    problem = Failing(_new(tmp_path / "2"), "memory", "killed", share=0.1)
    record = minimize(RandomSearch(), problem, BUDGET, workers=WORKERS, evaluation_limit=LONG)
    reasons = sorted(record.rejected)
    lost = sum(record.rejected.values())
    measured(
        f"{lost} of {record.evaluations:g} lost: "
        + "; ".join(f"{record.rejected[reason]} x {reason}" for reason in reasons)
    )
    assert len(reasons) == 2
    assert "MemoryError: Unable to allocate" in " ".join(reasons)
    assert reasons[1].startswith("WorkerLostError: killed by SIGKILL, perhaps out of memory; ")
    assert "\n" not in "".join(reasons)
    assert lost == sum(alone.rejected.values())
    _equal_curves(alone, record)


@pytest.mark.fault(
    row="R29",
    fault="evaluations that hang beyond their limit",
    promise="given up and said, the others go on",
)
def test_hung_workers(tmp_path: Path, measured: Figures) -> None:
    """One in ten hangs, and its process is killed."""
    alone = minimize(RandomSearch(), Failing(_new(tmp_path / "1"), "none", share=0.1), BUDGET)
    problem = Failing(_new(tmp_path / "2"), "hang", share=0.1)
    before, began = set(descendants(os.getpid())), time.monotonic()
    record = minimize(RandomSearch(), problem, BUDGET, workers=WORKERS, evaluation_limit=HUNG)
    left = set(descendants(os.getpid())) - before - _servers()
    lost = sum(record.rejected.values())
    measured(
        f"{lost} of {record.evaluations:g} lost in {time.monotonic() - began:.1f} s "
        f"({'; '.join(record.rejected)}); {len(left)} processes left"
    )
    (reason,) = record.rejected
    assert reason.startswith(f"WorkerLostError: no end within {HUNG:g} s, so it was killed; first")
    assert lost == sum(alone.rejected.values()) >= 3
    assert not left
    _equal_curves(alone, record)


@pytest.mark.slow
@pytest.mark.fault(
    row="R30",
    fault="a machine of a Dask cluster leaves in the middle; its scheduler is killed",
    promise="the run goes on; without a scheduler one line, and it goes on with the next cluster",
)
def test_a_cluster_that_leaves(tmp_path: Path, measured: Figures) -> None:
    """A worker is killed while it evaluates, later the scheduler while all workers are busy."""
    pytest.importorskip("distributed")
    alone = minimize(PSO(particles=10), Failing(_new(tmp_path / "1"), "doomed"), BUDGET)
    once = logged(tmp_path / "1", "done")
    first, second = (Failing(_new(tmp_path / k), "doomed", ends=1) for k in ("2", "3"))
    with _cluster(tmp_path / "three", 3) as (address, _), _killing(first.folder) as killed:
        left = minimize(PSO(particles=10), first, BUDGET, workers=address, evaluation_limit=LONG)
    done = logged(first.folder, "done")
    with (
        _cluster(tmp_path / "two", 2) as (address, scheduler),
        _killing(second.folder, lambda _: scheduler.pid),
    ):
        began = time.monotonic()
        ended = minimize(PSO(particles=10), second, BUDGET, workers=address, evaluation_limit=LONG)
        seconds = time.monotonic() - began
    assert ended.checkpoint is not None
    again = minimize(PSO(particles=10), second, BUDGET, checkpoint=ended.checkpoint)
    measured(
        f"{len(killed)} workers left: {'same' if same(alone, left) else 'another'} result, "
        f"{(done - once).total()} made twice; scheduler killed: {ended.outcome} after "
        f"{ended.evaluations:g} evaluations and {seconds:.1f} s ({(ended.error or '').strip()}), "
        f"{'same' if same(alone, again) else 'another'} result when it goes on"
    )
    assert killed
    assert same(alone, left)
    assert ended.outcome is Outcome.FAILED
    assert (ended.error or "").count("\n") == 1
    assert same(alone, again)


@pytest.mark.fault(
    row="R31",
    fault="Ctrl-C with busy workers; kill -9 of the process that searches",
    promise="all over in 5 s, what was found is kept, no orphan process",
)
def test_ends_with_busy_workers(tmp_path: Path, measured: Figures) -> None:
    """Both come when all workers are busy with rows of which some never end."""
    slowest, orphans, lost = 0.0, 0, 0
    codes, known = [], []
    for number in (signal.SIGINT, signal.SIGKILL):
        folder = _new(tmp_path / number.name)
        process = forked(partial(_search, folder))
        _wait(lambda folder=folder: logged(folder, "hangs").total() == WORKERS)  # type: ignore[misc]
        family = [process.pid, *descendants(process.pid)]
        began = time.monotonic()
        os.kill(process.pid, number)
        while (left := alive(family)) and time.monotonic() < began + 2 * ALLOWED:
            time.sleep(POLL)
        slowest, orphans = max(slowest, time.monotonic() - began), orphans + len(left)
        for pid in left:
            os.kill(pid, signal.SIGKILL)
        codes.append(process.end().code)
        journal = (folder / "journal").read_text(encoding="utf-8")
        known.append(len(journal.splitlines()) - 1)
        lost += len(logged(folder, "done")) - known[-1]
    said = (tmp_path / "SIGINT" / "record").read_text(encoding="utf-8")
    measured(
        f"all over in {slowest:.1f} s, {orphans} orphans; after Ctrl-C {said}; {known[0]} and "
        f"{known[1]} values in the journals, {lost} lost"
    )
    assert slowest <= ALLOWED
    assert not orphans
    assert said.startswith("interrupted, True")
    assert min(known) > 0
    assert 0 <= lost <= 2 * WORKERS, "those that came in the same moment"


def _search(folder: Path) -> None:
    """In a process of its own: a run whose workers are all busy for ever, sooner or later."""
    record = minimize(
        RandomSearch(), Failing(folder, "hang", share=0.2, seconds=0.02), Budget(evaluations=500),
        workers=WORKERS, evaluation_limit=LONG, journal=folder / "journal",
    )  # fmt: skip
    text = f"{record.outcome}, {record.checkpoint is not None}, {record.evaluations:g} evaluations"
    (folder / "record").write_text(text, encoding="utf-8")


def _new(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _wait(ready: Callable[[], bool]) -> None:
    until = time.monotonic() + PATIENCE
    while not ready():
        assert time.monotonic() < until
        time.sleep(POLL)


@contextlib.contextmanager
def _killing(folder: Path, victim: Callable[[int], int] = lambda pid: pid) -> Iterator[list[int]]:
    """Meanwhile kill the process of each doomed row, or its `victim`, once it waits for that."""
    killed: list[int] = []
    over = threading.Event()

    def watch() -> None:
        seen: set[Path] = set()
        while not over.wait(POLL):
            for path in set(folder.glob("*.pid")) - seen:
                text = path.read_text()
                if text.endswith(" "):
                    seen.add(path)
                    killed.append(victim(int(text)))
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(killed[-1], signal.SIGKILL)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield killed
    finally:
        over.set()
        thread.join()


@contextlib.contextmanager
def _cluster(folder: Path, workers: int) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler of Dask and workers as processes of their own; its address."""
    folder.mkdir()
    file = folder / "scheduler.json"
    place = ["--scheduler-file", str(file)]
    commands = [
        ["scheduler", *place, "--host", "127.0.0.1", "--port", "0", "--no-dashboard"],
        *(
            ["worker", *place, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
            for _ in range(workers)
        ),
    ]
    with (folder / "log").open("wb") as log:
        processes = [
            subprocess.Popen(
                [sys.executable, "-m", "dask", *command], cwd=CHECKOUT, stdout=log, stderr=log,
                env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
            )
            for command in commands
        ]  # fmt: skip
        try:
            yield _address(file, workers), processes[0]
        finally:
            for process in processes:
                process.kill()
                process.wait()


def _address(file: Path, workers: int) -> str:
    """That of a scheduler with so many workers, once they are there."""
    from distributed import Client

    _wait(file.exists)
    with Client(scheduler_file=str(file), set_as_default=False) as client:
        client.wait_for_workers(workers, PATIENCE)
        return str(client.scheduler.address).replace("tcp://", "dask://")


def _servers() -> set[int]:
    """What serves processes of multiprocessing, until this one ends."""
    from multiprocessing import forkserver, resource_tracker

    return {
        pid
        for pid in (forkserver._forkserver._forkserver_pid, resource_tracker._resource_tracker._pid)
        if pid is not None
    }


def _equal_curves(first: RunRecord, second: RunRecord) -> None:
    assert first.evaluations == second.evaluations
    assert first.trace.loss == second.trace.loss
    assert first.trace.evaluations == second.trace.evaluations
