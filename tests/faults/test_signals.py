"""R4: sweeps that get a signal."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from experiments.app.compose import composed
from experiments.app.console import run_and_exit
from experiments.app.plan import Request, requests
from experiments.app.runs import run
from experiments.app.schema import SweepConfig
from tests.faults.commands import alive, descendants, forked, prepare, started
from tests.faults.conftest import Figures
from tests.faults.misbehaviour import MODEL

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)
SENT, FEWER_SENT, SPARE, SEEDS, LATEST = 20, 5, 6, 6, 1.3
"""Each signal goes to a sweep over some seeds of its own. It comes at a random time after the first
run has begun, at most so many times what a first run takes, and can find the sweep at its end."""
ALLOWED, AT_ONCE, SECOND = 5.0, 1.0, 0.3
SWEEP = ["optimizer=random", "dataset.n=40", "budget.evaluations=null", "budget.seconds=0.2"]


@dataclass(frozen=True)
class Stopped:
    """How long a sweep's processes lived after the last signal, how many did not end, the code."""

    seconds: float
    left: int
    code: int


@pytest.mark.slow
@pytest.mark.fault(
    row="R4",
    fault=f"SIGINT, SIGTERM, SIGUSR1 to a sweep at {SENT} random times; runs that do not listen",
    promise="all processes gone in 5 s, open runs marked, curves kept, rerun resumes; a second "
    "signal ends at once",
)
def test_signals(tmp_path: Path, measured: Figures, thorough: bool) -> None:
    """Signal sweeps at random times, then go on with all they left; then what ignores a signal.

    A run that does not listen is killed with its process, after some seconds or at the second
    signal. The last sweep is the command in an interpreter of its own, with all it starts.
    """
    times, root = SENT if thorough else FEWER_SENT, tmp_path / "runs"
    prepare()
    stopped, wrong, runs = _at_random_times(root, times)
    before = {path: path.read_bytes() for path in root.glob("*/*/*/result.json")}
    marked, _, opened = _open_runs(root)
    again = forked(partial(_sweep, runs)).end()
    done = len(list(root.glob("*/*/*/result.json")))
    untouched = sum(path.read_bytes() == data for path, data in before.items())
    once, twice = (_deaf(tmp_path / str(count), [signal.SIGINT] * count) for count in (1, 2))
    place = tmp_path / "long"
    of_a_minute = requests(composed([*SWEEP, "budget.seconds=60", f"root={place}"]), "", [0, 1])
    long = _stop(partial(_sweep, of_a_minute), place, [signal.SIGTERM], 5.0)
    curves = _open_runs(place)[1]
    whole = _whole_command(tmp_path / "whole")
    slowest = max(sweep.seconds for sweep in (*stopped, once, long, whole))
    left = sum(sweep.left for sweep in (*stopped, once, twice, long, whole))
    wrong += sum(sweep.code != 130 for sweep in (once, twice, whole))
    measured(
        f"{len(stopped)} signals: gone in {slowest:.1f} s at most, {left} left, {wrong} wrong exit "
        f"codes; {marked} of {opened} open runs marked, {curves} of 2 curves kept; rerun "
        f"exit {again.code}, {done} of {len(runs)} done, {untouched} of {len(before)} untouched; "
        f"second: {twice.seconds:.1f} s"
    )
    assert slowest <= ALLOWED
    assert not left
    assert not wrong
    assert twice.seconds <= AT_ONCE
    assert len(stopped) == times <= opened == marked
    assert curves == 2
    assert again.code == 0
    assert done == len(runs)
    assert untouched == len(before)


def _at_random_times(root: Path, times: int) -> tuple[list[Stopped], int, list[Request]]:
    """The sweeps that a signal stopped, how many had a wrong exit code, and all that was wanted."""
    chance = random.Random(4)
    runs = requests(composed([*SWEEP, f"root={root}"]), "", range((times + SPARE + 1) * SEEDS))
    process = forked(partial(_sweep, runs[:SEEDS]))
    _wait_for(root, "lock", 1)
    began = time.monotonic()
    _wait_for(root, "result.json", 1)
    latest = LATEST * (time.monotonic() - began)
    process.end()
    stopped: list[Stopped] = []
    wrong, sweeps = 0, 1
    while len(stopped) < times and sweeps <= times + SPARE:
        job = partial(_sweep, runs[SEEDS * sweeps : SEEDS * (sweeps + 1)])
        number = SIGNALS[sweeps % 3]
        ended = _stop(job, root, [number], chance.uniform(0, latest))
        stopped += [ended] * (ended.code != 0)
        wrong += ended.code not in (0, 128 + number)
        sweeps += 1
    return stopped, wrong, runs[: SEEDS * sweeps]


def _deaf(root: Path, numbers: list[signal.Signals]) -> Stopped:
    """Signal a run that takes no notice."""
    root.mkdir()
    model = root / "deaf.py"
    model.write_text(MODEL.format(how="deaf"), encoding="utf-8")
    overrides = ["model=function", f"model.path={model}", "optimizer.batch=1", f"root={root}"]
    plan = requests(composed([*SWEEP, *overrides]), "", [0])
    return _stop(partial(_sweep, plan), root, numbers, 1.0)


def _sweep(runs: Sequence[Request]) -> None:
    """What the command does once it is clear which runs are wanted."""
    run_and_exit(lambda: run(runs, SweepConfig(workers=2)).raise_if_stopped())


def _stop(
    job: Callable[[], None], root: Path, numbers: list[signal.Signals], wait: float
) -> Stopped:
    """Signal a sweep `wait` seconds after it has begun its first run; then with the others."""
    locks, serving = _count(root, "lock"), set(descendants(os.getpid()))
    process = forked(job)
    _wait_for(root, "lock", locks + 1)
    time.sleep(wait)
    family = [pid for pid in descendants(os.getpid()) if pid not in serving]
    os.kill(process.pid, numbers[0])
    for number in numbers[1:]:
        time.sleep(SECOND)
        os.kill(process.pid, number)
    seconds, left = _outlived(family)
    return Stopped(seconds, left, process.end().code)


def _whole_command(root: Path) -> Stopped:
    process = started("-m", *SWEEP, "sweep.workers=2", "seed=range(100)", f"root={root}")
    _wait_for(root, "lock", 2)
    family = [process.pid, *descendants(process.pid)]
    os.kill(process.pid, signal.SIGINT)
    seconds, left = _outlived(family)
    return Stopped(seconds, left, process.wait())


def _outlived(family: list[int]) -> tuple[float, int]:
    """Seconds until all these have ended, and how many did not; those are killed."""
    began = time.monotonic()
    while (left := alive(family)) and time.monotonic() < began + 2 * ALLOWED:
        time.sleep(0.02)
    seconds = time.monotonic() - began
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    return seconds, len(left)


def _open_runs(root: Path) -> tuple[int, int, int]:
    """Of the runs that began and are not done: marked interrupted, with a curve, in all."""
    marked = curves = opened = 0
    for lock in root.glob("*/*/*/lock"):
        if lock.with_name("result.json").exists():
            continue
        opened += 1
        path = lock.with_name("partial.json")
        partial = json.loads(path.read_bytes()) if path.exists() else {}
        marked += partial.get("outcome") == "interrupted"
        curves += len((partial.get("curve") or {"loss": []})["loss"]) > 0
    return marked, curves, opened


def _count(root: Path, name: str) -> int:
    return len(list(root.glob(f"*/*/*/{name}")))


def _wait_for(root: Path, name: str, count: int) -> None:
    """Until so many runs have a file of this name."""
    until = time.monotonic() + 60
    while _count(root, name) < count and time.monotonic() < until:
        time.sleep(0.02)
