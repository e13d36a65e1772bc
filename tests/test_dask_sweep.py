"""A sweep on a cluster of Dask does what it does in processes, whatever dies in between."""

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed", reason="the extra cluster is not installed")

from experiments.app.build import ConfigError
from experiments.app.cluster_runs import cluster_runs
from experiments.app.compose import composed
from experiments.app.plan import Request, requests, sweep_settings
from experiments.app.runs import run
from experiments.app.schema import SweepConfig
from experiments.app.working import State
from miho.study import Status, Store
from miho.study.store import RunInUse
from tests.faults.commands import alive, descendants, identified, started
from tests.parallel.dask_commands import DaskCommands, wait_until

TINY = ("budget.evaluations=400", "dataset.n=40")
SLOW = '''"""A line that waits at its twentieth call, as long as there is a file `hold`."""
import os
import pathlib
import time

HERE = pathlib.Path(__file__).parent
calls = 0


def line(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":
    global calls
    calls += 1
    if calls == 20:
        (HERE / f"pid_{os.getpid()}").touch()
    while calls >= 20 and (HERE / "hold").exists():
        time.sleep(0.01)
    return Sy - B * D * (alpha - Sx)
'''
ALLOWED = 20.0
"""Seconds; on a quiet machine two are enough, and five are promised."""


@pytest.fixture
def commands(tmp_path: Path) -> Iterator[DaskCommands]:
    commands = DaskCommands.started(tmp_path / "dask", 2)
    yield commands
    commands.close()


def runs_of(root: Path, *more: str, seeds: int = 3) -> list[Request]:
    overrides = [*TINY, f"root={root}", *more]
    return requests(composed(overrides), " ".join(more), range(seeds))


def slow_model(folder: Path, *, hold: bool) -> tuple[str, ...]:
    """The overrides that choose a slow model, which is written into a folder."""
    folder.mkdir(exist_ok=True)
    (folder / "slow.py").write_text(SLOW, encoding="utf-8")
    if hold:
        (folder / "hold").touch()
    return ("model=function", f"model.path={folder / 'slow.py'}", "optimizer=random",
            "optimizer.batch=5")  # fmt: skip


def in_progress(folder: Path) -> list[int]:
    """The processes whose runs of the slow model wait."""
    return alive([int(path.name.removeprefix("pid_")) for path in folder.glob("pid_*")])


def contents(root: Path) -> dict[str, Any]:
    """What all runs of a root say, but for seconds."""
    said = {}
    for path in root.glob("*/*/*/result.json"):
        result = json.loads(path.read_bytes())
        curve = json.loads(path.with_name("curve.json").read_bytes())
        said[path.parent.name] = [
            *(result[key] for key in ("loss", "theta", "evaluations", "outcome")),
            *(curve[key] for key in ("loss", "theta", "evaluations")),
        ]
    return said


def statuses(states: list[State]) -> list[Status]:
    return sorted(state.status for state in states)


@pytest.mark.slow
def test_processes_and_clusters_give_the_same_to_the_last_bit(
    tmp_path: Path, commands: DaskCommands
) -> None:
    address = str(commands.address)
    ways: dict[str, dict[str, Any]] = {
        "processes": {"workers": 2},
        "local": {"workers": "dask:2"},
        "sent": {"workers": address},
        "shared": {"workers": address, "shared": True},
    }
    for name, how in ways.items():
        root = tmp_path / name
        plan = [*runs_of(root, "optimizer=random"), *runs_of(root, "optimizer=miho")]
        assert statuses(run(plan, SweepConfig(**how)).states) == [Status.RAN] * 6
        assert statuses(run(plan, SweepConfig(**how)).states) == [Status.DONE_BEFORE] * 6
    expected = contents(tmp_path / "processes")
    assert len(expected) == 6
    for name in ways:
        assert contents(tmp_path / name) == expected, name


def test_what_is_sent_is_stored_once_and_what_another_does_is_waited_for(
    tmp_path: Path, commands: DaskCommands
) -> None:
    plan = runs_of(tmp_path / "runs", "optimizer=random", seeds=2)
    store = Store(tmp_path / "runs")
    claimed = store.claim(plan[0].identity)
    with claimed, cluster_runs(str(commands.address), SweepConfig()) as runs:
        for request in plan:
            runs.start(request)
        states: dict[int, Any] = {}
        while runs.busy:
            states |= {end.job.identity.seed: end.result for end in runs.wait(1)}
            if not store.has_result(plan[1].identity):
                with pytest.raises(RunInUse), store.claim(plan[1].identity):
                    pass
    assert states[0].status is Status.RUNNING_ELSEWHERE
    assert not store.has_result(plan[0].identity)
    assert store.find(plan[1].identity) is not None
    settings = SweepConfig(workers=commands.address)
    assert statuses(run(plan, settings).states) == [Status.DONE_BEFORE, Status.RAN]


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_nothing(tmp_path: Path, commands: DaskCommands) -> None:
    """The runs of the killed worker are done by the other one."""
    model = tmp_path / "model"
    root, settings = f"root={tmp_path / 'runs'}", ["sweep.shared=true"]
    process = started(
        "-m", *TINY, *slow_model(model, hold=True), root, "seed=range(4)", *settings,
        f"sweep.workers={commands.address}",
    )  # fmt: skip
    wait_until(lambda: len(in_progress(model)) == 2)
    commands.workers[0].kill()
    wait_until(lambda: len(in_progress(model)) == 1)
    (model / "hold").unlink()
    assert process.wait(120) == 0
    assert len(contents(tmp_path / "runs")) == 4


@pytest.mark.slow
@pytest.mark.parametrize("where", ["dask:2", "scheduler"])
def test_ctrl_c_ends_all_in_five_seconds_and_keeps_what_there_is(
    tmp_path: Path, commands: DaskCommands, where: str
) -> None:
    model, root = tmp_path / "model", tmp_path / "runs"
    address = str(commands.address) if where == "scheduler" else where
    process = started(
        "-m", *TINY, *slow_model(model, hold=True), f"root={root}", "seed=range(4)",
        "sweep.shared=true", f"sweep.workers={address}",
    )  # fmt: skip
    wait_until(lambda: len(in_progress(model)) == 2)
    family = [process.pid, *descendants(process.pid), *in_progress(model)]
    began = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    assert process.wait(60) == 128 + signal.SIGINT
    wait_until(lambda: not alive(family))
    seconds = time.monotonic() - began
    assert seconds < ALLOWED
    kept = [json.loads(path.read_bytes()) for path in root.glob("*/*/*/partial.json")]
    assert [partial["outcome"] for partial in kept] == ["interrupted"] * 2
    assert all(partial["curve"]["loss"] for partial in kept)


@pytest.mark.slow
def test_a_killed_client_leaves_no_run_and_no_process(
    tmp_path: Path, commands: DaskCommands
) -> None:
    model, root = tmp_path / "model", tmp_path / "runs"
    process = started(
        "-m", *TINY, *slow_model(model, hold=True), f"root={root}", "seed=range(2)",
        "sweep.shared=true", f"sweep.workers={commands.address}",
    )  # fmt: skip
    wait_until(lambda: len(in_progress(model)) == 2)
    process.kill()
    process.wait()
    wait_until(lambda: not in_progress(model))
    assert contents(root) == {}


@pytest.mark.slow
def test_a_scheduler_that_dies_loses_only_what_was_in_progress(
    tmp_path: Path, commands: DaskCommands, capfd: pytest.CaptureFixture[str]
) -> None:
    model, root = tmp_path / "model", tmp_path / "runs"
    slow = slow_model(model, hold=False)
    plan = runs_of(root, *slow, seeds=5)
    assert statuses(run(plan[:2], SweepConfig(workers=2)).states) == [Status.RAN] * 2
    before = contents(root)
    slow_model(model, hold=True)
    process = started(
        "-m", *TINY, *slow, f"root={root}", "seed=range(5)", "sweep.shared=true",
        f"sweep.workers={commands.address}",
    )  # fmt: skip
    wait_until(lambda: len(in_progress(model)) == 2)
    commands.scheduler.kill()
    assert process.wait(60) == 3
    assert contents(root) == before
    wait_until(lambda: not in_progress(model))
    reasons = [Store(root).reason(request.identity) for request in plan]
    # the worker saves its interrupted run in the same store, before or after the sweep's reason
    ended = ("the connection to the Dask scheduler broke", "interrupted")
    assert sum(str(reason).startswith(ended) for reason in reasons) == 2
    (model / "hold").unlink()
    states = run(plan, SweepConfig(workers=2)).states
    assert statuses(states) == [Status.DONE_BEFORE] * 2 + [Status.RAN] * 3


@pytest.mark.slow
def test_a_run_that_takes_too_long_is_lost_alone(tmp_path: Path, commands: DaskCommands) -> None:
    held, free = slow_model(tmp_path / "held", hold=True), slow_model(tmp_path / "free", hold=False)
    settings = SweepConfig(workers=commands.address, shared=True, time_limit=15)
    plan = [*runs_of(tmp_path, *held, seeds=1), *runs_of(tmp_path, *free, seeds=2)]
    states = run(plan, settings).states
    assert statuses(states) == [Status.LOST, Status.RAN, Status.RAN]
    assert [s.reason for s in states if s.reason] == ["no end within 15 s, so it was killed"]
    assert not in_progress(tmp_path / "held")


def test_code_of_the_users_needs_machines_that_see_it(tmp_path: Path) -> None:
    plan = runs_of(tmp_path, *slow_model(tmp_path / "model", hold=False), seeds=1)
    with pytest.raises(ConfigError, match=r"add sweep\.shared=true"):
        run(plan, SweepConfig(workers="dask://127.0.0.1:9"))


def test_the_former_name_and_a_wrong_address(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"sweep\.processes: is now sweep\.workers"):
        composed(["sweep.processes=3"])
    for wrong in ("sweep.workers=dask:0", "sweep.workers=two", "sweep.workers=true"):
        with pytest.raises(ConfigError, match=r"sweep\.workers: .*dask://HOST:PORT, dask:N"):
            sweep_settings(composed([wrong]).sweep)


def test_the_folder_of_config_dir_can_name_a_cluster(tmp_path: Path) -> None:
    """It is the user's own, as SECURITY.md says; the command line goes before it."""
    folder = tmp_path / "own" / "experiment"
    folder.mkdir(parents=True)
    text = "# @package _global_\nsweep:\n  workers: dask://127.0.0.1:9\n"
    (folder / "mine.yaml").write_text(text, encoding="utf-8")
    typed = ("--config-dir", str(folder.parent), "-m", "experiment=mine", f"root={tmp_path}")
    ended = identified(*typed)
    assert ended.code == 2
    assert "dask://127.0.0.1:9: no Dask scheduler answers there" in ended.complaint
    assert "sweep.workers" in identified(*typed, "sweep.workers=two").complaint
