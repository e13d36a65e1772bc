"""Hydra's launchers do the runs of a sweep, one job for each setting."""

import subprocess
import sys
from pathlib import Path

import pytest

from miho import load_runs

ROOT = Path(__file__).parent.parent
SWEEP = ("optimizer=random", "optimizer.batch=5,10", "seed=0,1,2", "budget.evaluations=20")


def identify(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "experiments.identify", "-m", *SWEEP, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_a_launcher_does_the_runs(launcher: str, tmp_path: Path) -> None:
    plugin = "hydra_joblib_launcher" if launcher == "joblib" else "hydra_submitit_launcher"
    pytest.importorskip(f"hydra_plugins.{plugin}", reason="the extra `launchers` is not installed")
    arguments = [f"hydra/launcher={launcher}", f"root={tmp_path / 'runs'}"]
    process = identify(*arguments)
    assert process.returncode == 0, process.stdout + process.stderr
    assert "6 runs: 6 done before" in process.stdout
    runs = load_runs(tmp_path / "runs").runs
    assert sorted(runs["seed"]) == [0, 0, 1, 1, 2, 2]
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("result.json")}
    assert identify(*arguments).returncode == 0
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("result.json")}
