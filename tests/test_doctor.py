"""The doctor: what it finds in a machine, an installation and a folder of results."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock

from experiments.diagnosis import machine
from experiments.diagnosis.machine import Check, Severity, package_checks
from experiments.diagnosis.results import move_aside, result_checks
from experiments.doctor import diagnose
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


def checks_of(root: Path, *, quarantine: bool = False) -> dict[str, Check]:
    return {check.name: check for check in result_checks(root, quarantine=quarantine)}


def test_a_sound_root(tmp_path: Path) -> None:
    root, _ = root_with(tmp_path)
    checks = checks_of(root)
    assert {check.severity for check in checks.values()} == {Severity.OK}
    assert checks["runs"].message.startswith("3 finished")


def test_damaged_runs_are_moved_aside_on_request_only(tmp_path: Path) -> None:
    root, folders = root_with(tmp_path)
    curve = folders[1] / "curve.json"
    curve.write_bytes(curve.read_bytes()[:-30])
    damaged = {path.name: path.read_bytes() for path in folders[1].glob("*.json")}
    checks = checks_of(root)
    assert checks["runs"].severity is Severity.FAILED
    assert "1 damaged" in checks["runs"].message
    assert curve.exists()

    assert checks_of(root, quarantine=True)["runs"].severity is Severity.OK
    (aside,) = (root / ".quarantine").iterdir()
    assert aside.name.endswith(f"-{folders[1].name}")
    assert {path.name: path.read_bytes() for path in aside.glob("*.json")} == damaged
    assert not folders[1].exists()
    after = load_runs(root)
    assert (len(after.runs), len(after.damaged)) == (2, 0)
    assert checks_of(root)["runs"].severity is Severity.OK


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
        checks = checks_of(root)
    assert checks["partial runs"].severity is Severity.WARNING
    assert str(folders[0]) in checks["partial runs"].message
    assert checks["temporary files"].message.startswith(
        f"1 left by ended processes: {folders[1]}/.curve.json"
    )
    assert checks["links"].severity is Severity.FAILED
    assert str(root / "elsewhere") in checks["links"].message
    assert str(root / "round") in checks["links"].message
    assert "inner" not in checks["links"].message
    if Path("/proc/locks").exists():
        assert checks["running"].message == f"1 runs: {folders[2]} by process {os.getpid()}"


@pytest.mark.parametrize(
    ("line", "severity", "message"),
    [
        ("numpy>=1", Severity.OK, "1 of 1 installed, in range"),
        ("numpy<1", Severity.FAILED, r"is not <1; run make install"),
        ("no-such-package>=2", Severity.FAILED, "no-such-package>=2 is missing"),
        ("no-such-package; python_version < '3'", Severity.OK, "0 of 0 installed"),
    ],
)
def test_versions(tmp_path: Path, line: str, severity: Severity, message: str) -> None:
    pyproject = tmp_path / "pyproject.toml"
    pyproject.write_text(
        f'[project]\nrequires-python = ">=3.11"\ndependencies = ["{line}"]\n'
        f'[project.optional-dependencies]\nrivals = ["{line}"]\n'
    )
    checks = {check.name: check for check in package_checks(pyproject)}
    assert checks["packages"].severity is severity
    assert message in checks["packages"].message
    absent = "no-such-package>" in line
    assert checks["extra rivals"].severity is (Severity.OK if absent else severity)


def test_this_installation_is_in_range() -> None:
    severities = {check.name: check.severity for check in package_checks()}
    assert severities["packages"] is Severity.OK
    assert severities["extra experiments"] is Severity.OK


def test_a_busy_machine_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "busy_cores", lambda: 1.6)
    assert machine.load().severity is Severity.WARNING
    monkeypatch.setattr(machine, "busy_cores", lambda: 0.01)
    assert machine.load().severity is Severity.OK


def test_a_clock_that_falls_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine.clock().severity is Severity.OK
    ticks = iter(range(10**6))
    monkeypatch.setattr(machine.time, "perf_counter", lambda: -float(next(ticks)))
    assert machine.clock().severity is Severity.FAILED
    monkeypatch.setattr(machine.time, "perf_counter", lambda: float(next(ticks) // 50))
    assert machine.clock().severity is Severity.WARNING


def test_a_full_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Usage:
        free = 2**20

    monkeypatch.setattr(machine.shutil, "disk_usage", lambda _: Usage)
    assert machine.disk(tmp_path).severity is Severity.FAILED


def test_the_machine_in_short(tmp_path: Path) -> None:
    names = [check.name for check in machine.machine_checks(tmp_path)]
    assert names == ["cores", "threads", "load", "clock", "disk", "speed"]


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


def test_the_former_option_names_its_successor(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        diagnose(["--timing"])
    assert "run python -m experiments.faults R12" in capsys.readouterr().err
