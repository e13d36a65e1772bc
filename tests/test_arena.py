"""The arena: what is planned, that it resumes, and what it writes."""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from baselines.arena.results import PLAIN, pages, separation
from experiments import compare as comparing
from experiments.app.build import ConfigError, build, recorded_optimum
from experiments.app.comparing import chosen_problems, plan_arena
from experiments.app.compose import composed
from experiments.app.configured import as_configured
from experiments.app.console import SOME_FAILED
from experiments.app.drawing import draw_arena, read_comparison
from experiments.app.execution import execution_of
from experiments.app.options import CONF, source
from experiments.app.plan import Request
from experiments.app.runs import PlanOutcome
from experiments.app.working import State
from miho import load_runs
from miho.analysis.compare.comparison import COMPARISON
from miho.analysis.compare.leaderboard import family_scores, problem_scores
from miho.analysis.compare.running_time import NEAR_BEST
from miho.analysis.compare.significance import pairwise
from miho.study import Status

ROOT = Path(__file__).parent.parent
ARENA = ["experiment=arena_small", "comparison.repetitions=2", "budget.evaluations=300"]
KEPT = {"random": "batch: 50", "pso_100": "", "miho": "R: 9"}
PROBLEMS = "comparison.problems=[torque_15,brake_static]"
METHODS = [f"++comparison.methods.{name}={{{settings}}}" for name, settings in KEPT.items()]
METHODS += [
    f"~comparison.methods.{name}"
    for name in composed(["experiment=arena_small"]).comparison.methods
    if name not in KEPT
]


def test_runs_come_problem_by_problem_and_methods_side_by_side() -> None:
    overrides = [*ARENA, *METHODS, PROBLEMS]
    plan, left_out = plan_arena(composed(overrides), overrides)
    names = tuple(composed(overrides).comparison.methods)
    identities = [request.identity for request in plan]
    assert [(i.problem, i.seed, i.optimizer) for i in identities] == [
        (problem, seed, name)
        for problem in ("torque_15", "brake_static")
        for seed in range(2)
        for name in names
    ]
    assert len({request.identity.id for request in plan}) == 12
    assert not left_out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("problems", "methods", "found"),
    [
        ("tire_lf,front_axle", 3, "3 methods on problems of 1 families"),
        ("torque_15,brake_static", 2, "2 methods on problems of 2 families"),
    ],
)
def test_what_is_too_small_for_the_tests_is_refused_before_the_first_run(
    problems: str, methods: int, found: str
) -> None:
    overrides = [*ARENA, *METHODS, f"comparison.problems=[{problems}]"]
    cfg = composed(overrides)
    cfg.comparison.methods = {name: {} for name in list(KEPT)[:methods]}
    with pytest.raises(ConfigError, match=f"{found}; expected at least 3 on 2"):
        plan_arena(cfg, overrides)


def test_runs_that_are_lost_are_named_and_nothing_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    overrides = [*ARENA, *METHODS, PROBLEMS]
    planned = plan_arena(composed(overrides), overrides)
    lost = State(planned[0][0], Status.LOST, "it was lost", reason="killed by SIGKILL")
    monkeypatch.setattr("experiments.app.comparing.plan_arena", lambda *_: planned)
    monkeypatch.setattr(comparing, "run", lambda *_, **__: PlanOutcome([lost]))
    monkeypatch.setattr(sys, "argv", ["compare", *overrides, f"root={tmp_path / 'runs'}"])
    with pytest.raises(SystemExit) as end:
        comparing.main()
    assert end.value.code == SOME_FAILED
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "it was lost"
    assert lines[1].startswith("runs missing: 1")
    assert not (tmp_path / "runs" / "figures").exists()


def own_problems(folder: Path, **families: str) -> Path:
    """A folder of options with a problem for each family, and their data by turns."""
    (folder / "problem").mkdir(parents=True)
    for number, (name, family) in enumerate(families.items()):
        dataset = ("torque_15", "brake_pressure")[number % 2]
        (folder / "problem" / f"{name}.yaml").write_text(
            f"# @package _global_\ndefaults: [override /dataset: {dataset}]\n"
            f"problem: {{name: {name}, family: {family}}}\n",
            encoding="utf-8",
        )
    return folder


@pytest.mark.slow
def test_problems_of_a_further_folder_keep_their_families(tmp_path: Path) -> None:
    own = own_problems(tmp_path / "own", mine_a="mine", mine_b="mine", mine_c="other")
    chosen = ["comparison.problems=[mine_*]", "comparison.repetitions=1", "budget.evaluations=60"]
    ended = compare(*ARENA, *METHODS, *chosen, f"--config-dir={own}", f"root={tmp_path / 'runs'}")
    assert ended.returncode == 0, ended.stderr
    for text in ("3 problems", "2 families"):
        assert f"Friedman's test over {text} and 3 methods" in ended.stdout


def test_problems_of_a_further_folder_match_patterns_and_the_folder_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = own_problems(tmp_path / "own", mine_a="mine", mine_b="other")
    planned: list[str] = []
    drawn: list[list[str]] = []

    def run(plan: Sequence[Request], *_: object, **__: object) -> PlanOutcome:
        planned.extend(request.identity.problem for request in plan)
        return PlanOutcome()

    def draw(*arguments: Any) -> int:
        drawn.append(arguments[3])
        return 0

    monkeypatch.setattr(comparing, "run", run)
    monkeypatch.setattr(comparing, "draw", draw)
    overrides = [*ARENA, *METHODS, "comparison.problems=[mine_*]", f"root={tmp_path / 'runs'}"]
    chosen = ["--config-dir", str(own), *overrides, "fresh=true"]
    monkeypatch.setattr(sys, "argv", ["compare", *chosen])
    with pytest.raises(SystemExit) as end:
        comparing.main()
    assert not end.value.code
    assert planned == ["mine_a"] * 6 + ["mine_b"] * 6
    assert drawn == [[f"--config-dir={own}", *overrides]]


def _model(cfg: Any) -> str:
    defaults = {str(key): str(value) for entry in cfg.defaults for key, value in entry.items()}
    return defaults["override /model"]


def test_problems_that_are_one_model_in_one_kind_of_box_are_one_family() -> None:
    names = chosen_problems(composed(["experiment=arena"]).comparison.problems)
    files = {name: OmegaConf.create(source("problem", name)) for name in names}
    alike = {name: cfg.problem.family for name, cfg in files.items() if "family" in cfg.problem}
    families = {alike.get(name, name) for name in names}
    assert len(names) >= 45
    assert len(families) == 43
    published = {name for name, cfg in files.items() if "model" in cfg}
    for name in published:
        assert alike[name] == files[name].model.name
    unpublished = {name: family for name, family in alike.items() if name not in published}
    assert len({alike.get(name, name) for name in files.keys() - published}) == 9
    expected = ["tire_physical"] * 2 + ["tire_wide"] * 7 + ["torque"] * 3
    assert sorted(unpublished.values()) == expected
    models = {(family, _model(files[name])) for name, family in unpublished.items()}
    assert sorted(models) == [
        ("tire_physical", "pacejka"), ("tire_wide", "pacejka"), ("torque", "torque_cubic")
    ]  # fmt: skip


def test_errors_below_the_resolution_of_a_problem_are_equal(tmp_path: Path) -> None:
    """Exact data: what is left is rounding, of which no method is to be judged."""
    store(tmp_path, "problem=nist_lanczos1_starts", "budget.evaluations=10")
    stored = load_runs(tmp_path).runs
    configured = composed(["problem=nist_lanczos1_starts"]).problem
    assert configured.optimum < configured.resolution
    runs = as_configured(stored.assign(error=1e-13))
    assert runs["optimum"].tolist() == runs["error"].tolist() == [configured.resolution]
    assert as_configured(stored.assign(error=0.1))["error"].tolist() == [0.1]


def store(root: Path, *overrides: str) -> None:
    execution_of(build(composed([*overrides, "optimizer=random", f"root={root}"])), quiet=True)


@pytest.mark.slow
def test_a_corrected_optimum_counts_and_another_problem_keeps_its_own(tmp_path: Path) -> None:
    once = ["problem=brake_static", "problem.optimum=1234", "budget.evaluations=100"]
    store(tmp_path / "one", *once)
    store(tmp_path / "one", *once, "problem.name=mine")
    stored = load_runs(tmp_path / "one").runs
    assert stored["optimum"].tolist() == pytest.approx([1234] * 2)
    runs = as_configured(stored)
    assert runs.index.equals(stored.index)
    runs = runs.set_index("problem")
    assert runs["optimum"]["brake_static"] == composed(["problem=brake_static"]).problem.optimum
    assert runs["optimum"]["mine"] == pytest.approx(1234)
    assert runs["family"].tolist() == runs.index.tolist()
    store(tmp_path / "other", *once, "dataset.seed=1")
    other = as_configured(load_runs(tmp_path / "other").runs)
    assert other["optimum"].tolist() == pytest.approx([1234])


def test_an_arena_reads_the_problems_of_a_folder(tmp_path: Path) -> None:
    (tmp_path / "problem").mkdir()
    text = (CONF / "problem" / "brake_static.yaml").read_text().replace("brake_static", "mine")
    text = text.replace("\nproblem:", "\nproblem:\n  family: ours")
    (tmp_path / "problem" / "mine.yaml").write_text(text)
    store(tmp_path, "problem=brake_static", "problem.name=mine", "budget.evaluations=100")
    runs = load_runs(tmp_path).runs
    assert as_configured(runs)["family"].tolist() == ["mine"]
    assert as_configured(runs, tmp_path)["family"].tolist() == ["ours"]


@pytest.mark.slow
def test_who_was_cut_by_seconds(tmp_path: Path) -> None:
    store(tmp_path, "problem=torque_15", "budget.evaluations=100_000_000", "budget.seconds=0.02")
    store(tmp_path, "problem=brake_static", "budget.evaluations=100", "budget.seconds=60")
    store(tmp_path, "problem=torque_05", "budget.evaluations=100")
    runs = as_configured(load_runs(tmp_path).runs).set_index("problem")
    assert runs["outcome"].tolist() == ["budget"] * 3
    assert runs["cut"].to_dict() == {"torque_15": True, "brake_static": False, "torque_05": False}
    assert runs["family"]["torque_15"] == "torque"


def test_runs_end_at_the_target_of_their_problem() -> None:
    overrides = [*ARENA, *METHODS, PROBLEMS, "comparison.target=1.5"]
    plan, _ = plan_arena(composed(overrides), overrides)
    for request in plan:
        optimum = recorded_optimum(composed([f"problem={request.identity.problem}"]))
        assert optimum is not None
        target = json.loads(request.setting)["budget"]["target"]  # of the loss, not of its root
        assert target == pytest.approx((1.5 * optimum) ** 2, rel=1e-12)


def test_a_store_that_is_too_small_to_draw_is_one_sentence(tmp_path: Path) -> None:
    store(tmp_path, "problem=brake_static", "budget.evaluations=100")
    about = {"command": [], "note": "", "runs": load_runs(tmp_path).runs["id"].tolist()}
    (tmp_path / COMPARISON).write_text(json.dumps(about))
    with pytest.raises(ConfigError, match="needs at least 3 on 2"):
        draw_arena(tmp_path, tmp_path / "figures")


def test_problems_without_data_are_left_out_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nowhere = ("http://127.0.0.1:9/x", tmp_path)
    monkeypatch.setattr("miho.vehicle.data.seong.sample_file.__defaults__", nowhere)
    monkeypatch.delenv("MIHO_DATA_DIR", raising=False)
    overrides = [*ARENA, *METHODS, "comparison.problems=[sample_a_wide,torque_15,brake_static]"]
    plan, left_out = plan_arena(composed(overrides), overrides)
    assert {request.identity.problem for request in plan} == {"torque_15", "brake_static"}
    assert "cannot be downloaded" in left_out["sample_a_wide"]
    overrides = [*ARENA, *METHODS, "comparison.problems=[sample_a_wide]"]
    with pytest.raises(ConfigError, match="cannot be downloaded"):
        plan_arena(composed(overrides), overrides)


@pytest.mark.slow
def test_methods_without_their_library_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dehb", None)
    monkeypatch.delitem(sys.modules, "baselines.dehb", raising=False)
    overrides = [*ARENA, *METHODS, PROBLEMS]
    cfg = composed(overrides)
    cfg.comparison.methods = {"dehb": {}} | {name: {} for name in KEPT}
    plan, left_out = plan_arena(cfg, overrides)
    assert {request.identity.optimizer for request in plan} == set(KEPT)
    assert left_out == {
        "dehb": "optimizer: dehb needs a library that is missing (dehb); pip install 'miho[rivals]'"
    }


def test_a_wrong_setting_stops_before_the_first_run() -> None:
    overrides = [*ARENA, PROBLEMS, "comparison.methods.miho.R=-1"]
    with pytest.raises(ConfigError, match="R is -1"):
        plan_arena(composed(overrides), overrides)


def test_the_tests_of_the_published_arena_follow_from_its_running_times() -> None:
    """The tables in the repository against each other, by the code as it is."""
    folder = ROOT / "docs" / "results" / "arena"
    ert, tests = pd.read_csv(folder / "ert.csv"), pd.read_csv(folder / "tests.csv")
    kinds = pd.read_csv(folder / "problems.csv").set_index("problem")["family"]
    plain = problem_scores(ert[ert["axis"] == "evaluations"], None, NEAR_BEST)
    again = pairwise(plain, "miho_gn")
    assert tests["rival"].tolist() == again["rival"].tolist()
    for column, recomputed in (("wins", "wins"), ("losses", "losses"), (PLAIN, "p_holm")):
        np.testing.assert_allclose(tests[column], again[recomputed])
    families = pairwise(family_scores(plain, kinds.to_dict()), "miho_gn")
    np.testing.assert_allclose(tests["p by families"], families["p_holm"])
    counts = separation(tests)
    assert counts == {"rivals": 33, "apart": 33, "apart_aocc": 33}
    text = (folder / "tests.md").read_text(encoding="utf-8")
    assert "from 33 of 33 rivals at 5 %" in text
    assert "p separates it from 33" in text


@pytest.mark.parametrize(
    ("problems", "sizes"), [(1, [1]), (18, [18]), (19, [10, 9]), (108, [18] * 6)]
)
def test_many_problems_are_drawn_on_several_pages(problems: int, sizes: list[int]) -> None:
    names = [f"problem_{number}" for number in range(problems)]
    by_suffix = pages(pd.Series(names).repeat(3))
    assert list(by_suffix) == ["", *(f"_{number}" for number in range(2, len(sizes) + 1))]
    assert [len(page) for page in by_suffix.values()] == sizes
    assert [name for page in by_suffix.values() for name in page] == names


def compare(*overrides: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "experiments.compare", *overrides]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)


@pytest.mark.slow
def test_an_arena_draws_and_resumes(tmp_path: Path) -> None:
    root = tmp_path / "runs"
    overrides = [*ARENA, *METHODS, PROBLEMS, f"root={root}"]
    first = compare(*overrides)
    assert first.returncode == 0, first.stderr
    for what in ("problems", "families"):
        assert f"Friedman's test over 2 {what} and 3 methods" in first.stdout
    figures = root / "figures"
    drawn = {path.stem for path in figures.glob("*.png")}
    assert drawn == {"error_curves", "ert", "ecdf", "profiles", "aocc", "ranks", "speed_up"}
    board = pd.read_csv(figures / "leaderboard.csv")
    assert sorted(board["method"]) == ["miho", "pso_100", "random"]
    assert board["cut by seconds"].between(0, 1).all()
    assert "Methods by mean rank over 2 problems" in first.stdout
    # of 2 families at best both are won: 2 of 4 signs, times 2 rivals
    assert "its p cannot be below 1 after the correction" in first.stdout
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

    comparison = read_comparison(root)
    assert set(comparison.runs["dimension"]) == {4}
    ending = "at most 300 evaluations per run, runs end at 1.0001 times the optimum"
    assert comparison.note.endswith(ending)
    assert len(load_runs(root).runs) == 12
