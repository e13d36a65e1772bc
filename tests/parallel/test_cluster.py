"""Workers of a cluster do as those of this machine; what is wrong with one is said in a line."""

import importlib.metadata
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed", reason="the extra cluster is not installed")

from experiments.app.cluster_workers import ClusterWorkers
from miho.parallel.cluster import ClusterError, check_address, cluster, is_address, places
from tests.faults.commands import alive
from tests.parallel.dask_commands import DaskCommands, wait_until
from tests.parallel.dask_jobs import hang, misbehave_there
from tests.parallel.test_workers import WAIT, all_of


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCommands]:
    commands = DaskCommands.started(tmp_path_factory.mktemp("dask"), 2)
    yield commands
    commands.close()


def test_addresses() -> None:
    assert check_address("dask://h:1") == ("dask", "h:1")
    assert check_address("dask:3") == ("dask", 3)
    assert check_address("lsf:12") == ("lsf", 12)
    assert check_address("slurm") == ("slurm", 1)
    assert is_address("slurm:2") and is_address("slurm")
    assert not any(is_address(number) for number in (2, "2", "many"))
    for wrong in ("dask:0", "dask:", "dask://h", "ssh:2", "slurm://h:1", "dask:-1", "dask://a b:1"):
        with pytest.raises(ClusterError, match=r"expected dask://HOST:PORT, dask:N"):
            check_address(wrong)


def test_nobody_at_the_address() -> None:
    with pytest.raises(ClusterError, match="no Dask scheduler answers there within 5 s"):
        cluster("dask://127.0.0.1:9").__enter__()


@pytest.mark.parametrize("library", ["distributed", "dask_jobqueue"])
def test_a_missing_library(monkeypatch: Any, library: str) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ClusterError, match=r"pip install miho\[cluster\]"):
        cluster("slurm:1").__enter__()


@pytest.mark.parametrize("kind", ["slurm", "pbs", "lsf"])
def test_a_machine_that_submits_no_jobs(monkeypatch: Any, tmp_path: Path, kind: str) -> None:
    pytest.importorskip("distributed", reason="the extra cluster is not installed")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ClusterError, match="this machine has no program"):
        cluster(f"{kind}:1").__enter__()


def test_a_worker_of_another_version(monkeypatch: Any, commands: DaskCommands) -> None:
    address = str(commands.address)
    with cluster(address) as client:
        client.wait_for_workers(2, timeout=WAIT)
    real = importlib.metadata.version
    monkeypatch.setattr(
        importlib.metadata, "version", lambda name: "0" if name == "miho" else real(name)
    )
    with pytest.raises(ClusterError, match=r"has miho .*, this process 0; start it with the same"):
        cluster(address).__enter__()


def test_jobs_that_go_wrong_are_lost_alone(commands: DaskCommands) -> None:
    bad = {
        "exit": "sys.exit(7)",
        "kill": "killed by SIGKILL, perhaps out of memory",
        "hang": "no end within 2 s, so it was killed",
        "raise": "ValueError: no good",
    }
    good = [f"good {k}" for k in range(14)]
    with cluster(str(commands.address)) as client:
        client.wait_for_workers(2, timeout=WAIT)
        workers: ClusterWorkers[str, str] = ClusterWorkers(client, misbehave_there, 2)
        with workers:
            ended = all_of([*good[:7], *bad, *good[7:]], workers)
    assert {job: end.result for job, end in ended.items() if end.reason is None} == {
        job: job for job in good
    }
    assert {job: end.reason for job, end in ended.items() if end.reason is not None} == bad
    assert "ValueError: no" in (ended["raise"].detail or "")


@pytest.mark.slow
def test_a_job_that_kills_its_worker_each_time_is_lost_alone(tmp_path: Path) -> None:
    good = [f"good {k}" for k in range(6)]
    renewed = DaskCommands.started(tmp_path, 2, nanny=True)
    with closing(renewed), cluster(str(renewed.address)) as client:
        workers: ClusterWorkers[str, str] = ClusterWorkers(client, misbehave_there)
        with workers:
            ended = all_of([*good[:3], "worker", *good[3:]], workers)
    reason = ended.pop("worker").reason
    assert reason == "each of the 4 Dask workers that began it died, perhaps because of it"
    assert {job: end.result for job, end in ended.items()} == {job: job for job in good}


@pytest.mark.parametrize("how", ["interrupt", "kill"])
def test_an_interrupt_reaches_jobs_and_a_kill_ends_them(
    tmp_path: Path, commands: DaskCommands, how: str
) -> None:
    places = [str(tmp_path / name) for name in "ab"]
    with cluster(str(commands.address)) as client:
        client.wait_for_workers(2, timeout=WAIT)
        workers: ClusterWorkers[str, str] = ClusterWorkers(client, hang)
        with workers:
            for place in places:
                workers.start(place)
            wait_until(lambda: all(Path(place).exists() and pid(place) for place in places))
            processes = [int(pid(place)) for place in places]
            if how == "interrupt":
                workers.interrupt()
                ended = all_of([], workers)
                assert {end.result for end in ended.values()} == {"interrupted 0"}
                assert all(end.interrupted for end in ended.values())
                assert set(ended) == set(places)
        wait_until(lambda: not alive(processes))  # also those that were only waiting


def pid(place: str) -> str:
    return Path(place).read_text(encoding="utf-8")


SUBMIT = """#!/bin/sh
cp "$1" "{folder}/$$.sh"
setsid sh "{folder}/$$.sh" > "{folder}/$$.log" 2>&1 &
echo "$!" >> "{folder}/jobs"
echo "Submitted batch job $!"
"""
CANCEL = """#!/bin/sh
kill -- "-$1"
"""


@pytest.mark.slow
def test_jobs_of_a_queue(
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A queue that begins each job at once, by scripts in the place of SLURM's programs."""
    pytest.importorskip("distributed", reason="the extra cluster is not installed")
    from dask import config

    request.addfinalizer(config.refresh)
    config.refresh(paths=[])  # whatever the user's own files say
    for name, text in (("sbatch", SUBMIT), ("scancel", CANCEL)):
        program = tmp_path / name
        program.write_text(text.format(folder=tmp_path), encoding="utf-8")
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    with pytest.raises(ClusterError, match=r"has no cores; set jobqueue\.slurm"):
        cluster("slurm:2").__enter__()
    queue = {"cores": 3, "memory": "1GB", "interface": "lo", "local-directory": str(tmp_path)}
    settings = {f"jobqueue.slurm.{key}": value for key, value in queue.items()}
    monkeypatch.setattr("miho.parallel.cluster.LOOK", 0.01)
    with config.set(settings), cluster("slurm:2") as client:
        assert places(client, "slurm:2") == 6
        workers: ClusterWorkers[str, str] = ClusterWorkers(client, misbehave_there)
        with workers:
            ended = all_of(["good 1", "good 2"], workers)
        assert {end.result for end in ended.values()} == {"good 1", "good 2"}
    assert "miho: slurm:2: no workers are available; waiting for one\n" in capsys.readouterr().err
    jobs = [int(line) for line in (tmp_path / "jobs").read_text(encoding="utf-8").split()]
    wait_until(lambda: not alive(jobs))
