"""The doctor: what it finds in a machine, an installation and a folder of results."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from experiments import machine
from experiments.doctor import diagnose, move_aside, package_checks, result_checks
from experiments.machine import Check, Pairs, State, same_method_twice
from miho import Budget, load_runs, minimize
from miho.optim import RandomSearch
from miho.study import Identity, Store, execute
from miho.testing import DecayFit

FINE = "x" * 16


def root_with(tmp_path: Path, runs: int = 3) -> tuple[Path, list[Path]]:
    """A results root and its run folders."""
    store = Store(tmp_path / "runs")
    folders = []
    for seed in range(runs):
        identity = Identity("decay", "random", seed, {}, code="c0de", data="da7a")
        execute(
            store,
            identity,
            lambda seed=seed: minimize(RandomSearch(), DecayFit(), Budget(evaluations=50), seed),
            DecayFit.space,
            {"unit": "V"},
        )
        folders.append(store.folder(identity))
    return store.root, folders


def found(root: Path, *, quarantine: bool = False) -> dict[str, Check]:
    return {check.name: check for check in result_checks(root, quarantine=quarantine)}


def test_a_sound_root(tmp_path: Path) -> None:
    root, _ = root_with(tmp_path)
    checks = found(root)
    assert {check.state for check in checks.values()} == {State.OK}
    assert checks["runs"].message.startswith("3 finished")


def test_damaged_runs_are_moved_aside_on_request_only(tmp_path: Path) -> None:
    root, folders = root_with(tmp_path)
    curve = folders[1] / "curve.json"
    curve.write_bytes(curve.read_bytes()[:-30])
    damaged = {path.name: path.read_bytes() for path in folders[1].glob("*.json")}
    checks = found(root)
    assert checks["runs"].state is State.FAILED
    assert "1 damaged" in checks["runs"].message
    assert curve.exists()

    assert found(root, quarantine=True)["runs"].state is State.OK
    (aside,) = (root / ".quarantine").iterdir()
    assert aside.name.endswith(f"-{folders[1].name}")
    assert {path.name: path.read_bytes() for path in aside.glob("*.json")} == damaged
    assert not folders[1].exists()
    after = load_runs(root)
    assert (len(after.runs), len(after.damaged)) == (2, 0)
    assert found(root)["runs"].state is State.OK


def test_a_second_damage_of_one_run_gets_a_folder_of_its_own(tmp_path: Path) -> None:
    root, folders = root_with(tmp_path, runs=2)
    first = move_aside(root, folders[0])
    folders[0].mkdir(parents=True)
    second = move_aside(root, folders[0])
    assert first is not None
    assert second is not None
    assert second.name == f"{first.name}-2"


def test_nothing_in_use_or_outside_is_moved(tmp_path: Path) -> None:
    root, folders = root_with(tmp_path, runs=1)
    with FileLock(folders[0] / "lock"):
        assert move_aside(root, folders[0]) is None
    outside = tmp_path / "outside"
    outside.mkdir()
    assert move_aside(root, outside) is None
    assert outside.exists()
    link = root / "decay" / "random" / FINE
    link.symlink_to(outside)
    aside = move_aside(root, link)
    assert aside is not None
    assert aside.is_symlink()
    assert outside.is_dir()


def test_partial_runs_temporary_files_locks_and_links(tmp_path: Path) -> None:
    root, folders = root_with(tmp_path)
    (folders[0] / "result.json").rename(folders[0] / "partial.json")
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
    (folders[1] / f".curve.json.{ended.pid}").write_text("{")
    (folders[1] / f".config.json.{os.getpid()}").write_text("{")
    (root / "elsewhere").symlink_to(tmp_path)
    (root / "inner").symlink_to(root / "decay")
    (root / "round").symlink_to(root / "round")
    with FileLock(folders[2] / "lock"):
        checks = found(root)
    assert checks["partial runs"].state is State.WARNING
    assert str(folders[0]) in checks["partial runs"].message
    assert checks["temporary files"].message.startswith(
        f"1 of processes that have ended: {folders[1]}/.curve.json"
    )
    assert checks["links"].state is State.FAILED
    assert str(root / "elsewhere") in checks["links"].message
    assert str(root / "round") in checks["links"].message
    assert "inner" not in checks["links"].message
    if Path("/proc/locks").exists():
        assert checks["running"].message == f"1 runs: {folders[2]} by process {os.getpid()}"


@pytest.mark.parametrize(
    ("line", "state", "message"),
    [
        ("numpy>=1", State.OK, "1 of 1 there, in range"),
        ("numpy<1", State.FAILED, r"is not <1; run make install"),
        ("no-such-package>=2", State.FAILED, "no-such-package>=2 is missing"),
        ("no-such-package; python_version < '3'", State.OK, "0 of 0 there"),
    ],
)
def test_versions(tmp_path: Path, line: str, state: State, message: str) -> None:
    pyproject = tmp_path / "pyproject.toml"
    pyproject.write_text(
        f'[project]\nrequires-python = ">=3.11"\ndependencies = ["{line}"]\n'
        f'[project.optional-dependencies]\nrivals = ["{line}"]\n'
    )
    checks = {check.name: check for check in package_checks(pyproject)}
    assert checks["packages"].state is state
    assert message in checks["packages"].message
    absent = "no-such-package>" in line
    assert checks["extra rivals"].state is (State.OK if absent else state)


def test_this_installation_is_in_range() -> None:
    states = {check.name: check.state for check in package_checks()}
    assert states["packages"] is State.OK
    assert states["extra experiments"] is State.OK


def test_a_busy_machine_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "busy_cores", lambda: 1.6)
    assert machine.load().state is State.WARNING
    monkeypatch.setattr(machine, "busy_cores", lambda: 0.01)
    assert machine.load().state is State.OK


def test_a_clock_that_falls_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine.clock().state is State.OK
    ticks = iter(range(10**6))
    monkeypatch.setattr(machine.time, "perf_counter", lambda: -float(next(ticks)))
    assert machine.clock().state is State.FAILED
    monkeypatch.setattr(machine.time, "perf_counter", lambda: float(next(ticks) // 50))
    assert machine.clock().state is State.WARNING


def test_a_full_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Usage:
        free = 2**20

    monkeypatch.setattr(machine.shutil, "disk_usage", lambda _: Usage)
    assert machine.disk(tmp_path).state is State.FAILED


def test_the_machine_in_short(tmp_path: Path) -> None:
    names = [check.name for check in machine.machine_checks(tmp_path, timing=False)]
    assert names == ["cores", "threads", "load", "clock", "disk", "speed", "A/A test"]


def pairs(ratio: float, valid: bool) -> Pairs:
    both = np.tile([ratio, 1.0], (4, 1))
    return Pairs(both, both, np.full((4, 2), valid))


@pytest.mark.parametrize(
    ("ratio", "valid", "state"),
    [
        (1.01, True, State.OK),
        (1.07, True, State.FAILED),
        (0.93, True, State.FAILED),
        (2.0, False, State.WARNING),
    ],
)
def test_a_difference_from_itself_is_told(
    monkeypatch: pytest.MonkeyPatch, ratio: float, valid: bool, state: State
) -> None:
    monkeypatch.setattr(machine, "same_method_twice", lambda _: pairs(ratio, valid))
    assert machine.same_method().state is state


@pytest.mark.parametrize("interleaved", [True, False])
def test_both_names_run_as_often_and_the_middle_is_the_middle(interleaved: bool) -> None:
    calls: list[int] = []
    found = same_method_twice(
        100, pairs=3, interleaved=interleaved, halfway=lambda: calls.append(1)
    )
    assert calls == [1]
    assert found.wall.shape == found.cpu.shape == found.valid.shape == (3, 2)
    assert (found.cpu > 0).all()


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, folders = root_with(tmp_path)
    assert diagnose([str(root)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].endswith("warnings")
    (folders[0] / "curve.json").write_text("{}")
    assert diagnose([str(root)]) == 3
    assert "1 failed" in capsys.readouterr().out.splitlines()[-1]
    assert diagnose([str(root), "--quarantine"]) == 0


def test_bad_input() -> None:
    with pytest.raises(FileNotFoundError, match="no such folder of runs"):
        diagnose(["/no/such/root"])
    with pytest.raises(SystemExit) as ended:
        diagnose(["--quarantine"])
    assert ended.value.code == 2
