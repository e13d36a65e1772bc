"""The arena: what is planned, that it resumes, and what it writes."""

import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from experiments.arena import plan
from experiments.build import ConfigError
from experiments.cli import composed
from experiments.comparison import Comparison
from experiments.schema import register
from miho import load_runs

ROOT = Path(__file__).parent.parent
ARENA = ["experiment=arena_small", "comparison.repetitions=2", "budget.evaluations=300"]
KEPT = {"random": "batch: 50", "pso_100": "", "miho": "R: 9"}
PROBLEMS = "comparison.problems=[torque_15,brake_static]"
register()
METHODS = [f"++comparison.methods.{name}={{{settings}}}" for name, settings in KEPT.items()]
METHODS += [
    f"~comparison.methods.{name}"
    for name in composed(["experiment=arena_small"]).comparison.methods
    if name not in KEPT
]


def test_a_plan_has_a_block_for_each_problem_and_seed() -> None:
    overrides = [*ARENA, *METHODS, PROBLEMS]
    planned = plan(composed(overrides), overrides)
    assert [(block.problem, block.seed) for block in planned.blocks] == [
        ("torque_15", 0), ("brake_static", 0), ("torque_15", 1), ("brake_static", 1),
    ]  # fmt: skip
    assert all(len(block.methods) == 3 for block in planned.blocks)
    assert planned.runs == 12
    assert not planned.left_out


def test_problems_without_data_are_left_out_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nowhere = ("http://127.0.0.1:9/x", tmp_path)
    monkeypatch.setattr("miho.data.seong.sample_file.__defaults__", nowhere)
    monkeypatch.delenv("MIHO_DATA_DIR", raising=False)
    overrides = [*ARENA, *METHODS, "comparison.problems=[sample_a_wide,torque_15]"]
    planned = plan(composed(overrides), overrides)
    assert {block.problem for block in planned.blocks} == {"torque_15"}
    assert "cannot be downloaded" in planned.left_out["sample_a_wide"]
    overrides = [*ARENA, *METHODS, "comparison.problems=[sample_a_wide]"]
    with pytest.raises(ConfigError, match="cannot be downloaded"):
        plan(composed(overrides), overrides)


def test_methods_without_their_library_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dehb", None)
    monkeypatch.delitem(sys.modules, "baselines.dehb", raising=False)
    overrides = [*ARENA, *METHODS, PROBLEMS]
    cfg = composed(overrides)
    cfg.comparison.methods = {"dehb": {}, "random": {}}
    planned = plan(cfg, overrides)
    assert all(len(block.methods) == 1 for block in planned.blocks)
    assert planned.left_out == {
        "dehb": "optimizer: dehb needs a library that is missing (dehb); pip install 'miho[rivals]'"
    }


def test_a_wrong_setting_stops_before_the_first_run() -> None:
    overrides = [*ARENA, PROBLEMS, "comparison.methods.miho.R=-1"]
    with pytest.raises(ConfigError, match="R is -1"):
        plan(composed(overrides), overrides)


def compare(*overrides: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "experiments.compare", *overrides]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)


@pytest.mark.slow
def test_an_arena_draws_resumes_and_exports(tmp_path: Path) -> None:
    root = tmp_path / "runs"
    overrides = [*ARENA, *METHODS, PROBLEMS, f"root={root}"]
    first = compare(*overrides)
    assert first.returncode == 0, first.stderr
    assert "Friedman's test over 2 problems and 3 methods" in first.stdout
    figures = root / "figures"
    drawn = {path.stem for path in figures.glob("*.png")}
    assert drawn == {"error_curves", "ert", "ecdf", "profiles", "aocc", "ranks", "speed_up"}
    board = pd.read_csv(figures / "leaderboard.csv")
    assert sorted(board["method"]) == ["miho", "pso_100", "random"]
    provenance = json.loads((figures / "provenance.json").read_text())
    assert "experiment=arena_small" in provenance["command"]

    before = {path: path.stat().st_mtime_ns for path in root.rglob("result.json")}
    assert len(before) == 12
    next(iter(before)).unlink()
    again = compare(*overrides)
    assert again.returncode == 0, again.stderr
    after = {path: path.stat().st_mtime_ns for path in root.rglob("result.json")}
    assert len(after) == 12
    assert sum(before[path] == after[path] for path in after) == 11

    found = Comparison.read(root)
    assert set(found.runs["dimension"]) == {4}
    assert found.note.endswith("at most 300 evaluations per run")
    assert len(load_runs(root).runs) == 12

    export = [sys.executable, "-m", "experiments.export", str(root), str(tmp_path / "ioh")]
    done = subprocess.run(export, cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "ioh").iterdir()} == {"miho", "pso_100", "random"}
    done = subprocess.run(export, cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 2
    assert "not empty" in done.stderr


def test_what_cannot_be_combined_is_refused() -> None:
    done = compare("experiment=arena_small", "problem=tire_lf")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: problem: cannot be chosen here")
    done = compare("experiment=arena_small", "comparison.processes=0")
    assert done.returncode == 2
    assert "comparison.processes: is 0" in done.stderr
