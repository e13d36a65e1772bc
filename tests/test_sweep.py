"""Sweeps: what is wanted is done once, and what was made of something else is not mixed in."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from omegaconf import DictConfig

from experiments.app.build import ConfigError, plain
from experiments.app.compose import composed
from experiments.app.console import SOME_FAILED
from experiments.app.plan import Request, requests, sweep_settings
from experiments.app.reports import read_sweep, save_sweep
from experiments.app.run_text import print_summary
from experiments.app.runs import run, stored_state
from experiments.app.schema import SweepConfig
from experiments.app.working import State, ended_state
from miho import load_runs
from miho.optim import Budget, RandomSearch, minimize
from miho.parallel.workers import JobOutcome
from miho.study import Status, Store, execute, manifest
from miho.study.manifest import ResumeRefused, refuse_changes
from miho.testing import DecayFit

TINY = ("optimizer=random", "optimizer.batch=5", "budget.evaluations=20")


def config(root: Path, *more: str) -> DictConfig:
    return composed([*TINY, f"root={root}", *more])


def runs_of(root: Path, *more: str, seeds: int = 2) -> list[Request]:
    return requests(config(root, *more), " ".join(more), range(seeds))


def statuses(runs: list[State]) -> list[Status]:
    return [state.status for state in runs]


@pytest.mark.parametrize("setting", ["workers=0", "time_limit=0"])
def test_a_bad_setting_is_one_line(tmp_path: Path, setting: str) -> None:
    with pytest.raises(ConfigError, match=f"sweep.{setting.partition('=')[0]}: is 0"):
        sweep_settings(config(tmp_path, f"sweep.{setting}").sweep)


def test_a_model_that_cannot_be_built_is_lost_alone_where_that_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "pair.py"
    path.write_text("def pair(alpha, *, B, C, D, Sx, Sy):\n    return 1.0, 2.0\n")
    words = ["model=function", f"model.path={path}", "dataset.n=40"]
    reason = r"pair: expected shape \(40,\) for columns \(40,\), got \(2,\)"
    with pytest.raises(ConfigError, match=reason):
        requests(config(tmp_path, *words), "", [0])
    runs = requests(config(tmp_path, *words), "", range(2), lose=True)
    (first, second) = run(runs, SweepConfig()).states
    assert first.status is second.status is Status.LOST
    assert re.search(reason, first.line)


def test_seeds_lost_for_one_reason_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = runs_of(tmp_path, "optimizer.batch=5", seeds=4)
    runs += runs_of(tmp_path, "optimizer.batch=6", seeds=1)
    lost = [
        ended_state(JobOutcome(request, reason=reason))
        for request, reason in zip(runs, "aabaa", strict=True)
    ]
    assert print_summary(lost) == SOME_FAILED
    assert capsys.readouterr().out.splitlines() == [
        "lost: optimizer.batch=5 seed=0,1,3: a",
        "lost: optimizer.batch=5 seed=2: b",
        "lost: optimizer.batch=6 seed=0: a",
        "5 runs: 5 lost",
    ]


def test_what_is_wanted_twice_is_done_once_and_then_done_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [*runs_of(tmp_path), *runs_of(tmp_path)]
    listed = run(runs, SweepConfig(dry_run=True)).states
    assert statuses(listed) == [Status.TO_DO] * 2
    assert list(tmp_path.iterdir()) == []
    assert statuses(run(runs, SweepConfig(workers=2)).states) == [Status.RAN] * 2
    again = run(runs, SweepConfig()).states
    assert statuses(again) == [Status.DONE_BEFORE] * 2
    assert statuses(run(runs, SweepConfig(dry_run=True)).states) == [Status.DONE_BEFORE] * 2
    errors = load_runs(tmp_path).runs["error"].tolist()
    assert sorted(state.error or 0 for state in again) == sorted(errors)
    # Batches of a study may request a run again; the table counts it once.
    capsys.readouterr()
    print_summary([*again, *again])
    assert "pacejka-tire_lf random      2 " in capsys.readouterr().out


def test_a_run_that_was_tried_says_why_it_is_not_done(tmp_path: Path) -> None:
    (request,) = runs_of(tmp_path, seeds=1)
    assert stored_state(request).reason is None
    Store(tmp_path).keep_reason(request.identity, "killed by SIGKILL", None)
    assert stored_state(request).reason == "killed by SIGKILL"
    assert stored_state(request).status is Status.TO_DO


def test_a_result_that_is_gone_is_missed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = runs_of(tmp_path)
    run(runs, SweepConfig(), command="experiments.compare -m", overrides=["seed=0,1"])
    (Store(tmp_path).folder(runs[0].identity) / "result.json").unlink()
    assert manifest.without_result(tmp_path) == ([Store(tmp_path).folder(runs[0].identity)], 2)
    page = save_sweep(read_sweep(tmp_path), tmp_path, tmp_path / "report.html", {})
    warning = "1 of 2 runs of the sweeps here have no result.json"
    err = capsys.readouterr().err
    assert warning in err
    assert "this runs them again: python -m experiments.compare -m seed=0,1\n" in err
    assert warning in page.read_text()
    again = run(runs, SweepConfig()).states
    assert sorted(statuses(again)) == [Status.DONE_BEFORE, Status.RAN]
    assert "1 runs were stored before and have no result.json now" in capsys.readouterr().err
    assert manifest.without_result(tmp_path) == ([], 2)


def test_runs_that_are_done_need_no_worker(tmp_path: Path, monkeypatch: Any) -> None:
    runs = runs_of(tmp_path)
    run(runs, SweepConfig())
    monkeypatch.setattr("experiments.app.runs.Workers", None)
    assert statuses(run(runs, SweepConfig()).states) == [Status.DONE_BEFORE] * 2


MODEL = 'def line(alpha: "rad", *, B: "1/rad", C: "-", D: "N", Sx: "rad", Sy: "N") -> "N":\n'
"""The parameters are those of the configuration's own space."""


@pytest.mark.parametrize(
    "deed",
    ["raise KeyboardInterrupt", pytest.param("raise BaseException('no')", marks=pytest.mark.slow)],
)
def test_a_model_that_cannot_be_tried_is_lost_alone(tmp_path: Path, deed: str) -> None:
    model = tmp_path / "model.py"
    model.write_text(f"{MODEL}    {deed}\n")
    overrides = ("model=function", f"model.path={model}", "dataset.n=40")
    (request,) = runs_of(tmp_path / "runs", *overrides, seeds=1)
    assert request.lost is not None
    assert statuses(run([request], SweepConfig()).states) == [Status.LOST]
    model.write_text(f"{MODEL}    return Sy - B * D * (alpha - Sx)\n")
    (request,) = runs_of(tmp_path / "runs", *overrides, seeds=1)
    assert statuses(run([request], SweepConfig()).states) == [Status.RAN]


def test_paths_have_one_spelling() -> None:
    spellings = [composed(["dataset=csv", f"dataset.path={p}a.csv"]) for p in ("", "./", ".//")]
    assert [plain(cfg)["dataset"]["path"] for cfg in spellings] == ["a.csv"] * 3


def test_a_seed_below_zero_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="seed: is -3"):
        requests(config(tmp_path), "", [1, -3])


def test_what_a_lost_run_says_keeps_secrets(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setenv("MIHO_TEST_TOKEN", "do-not-tell-this")
    request = requests(composed(["optimizer=random", f"root={tmp_path}"]), "", [0])[0]
    state = ended_state(JobOutcome(request, reason="no login with do-not-tell-this"))
    assert state.status is Status.LOST
    assert "no login with <MIHO_TEST_TOKEN>" in state.line
    assert "do-not-tell-this" not in f"{state.line}{state.reason}"


def test_the_words_of_a_sweep_must_mean_the_same(tmp_path: Path) -> None:
    words = ["optimizer=random"]
    old = {"seed 0": runs_of(tmp_path, seeds=1)[0].identity}
    new = {"seed 0": runs_of(tmp_path, "optimizer.batch=7", seeds=1)[0].identity}
    manifest.write_manifest(tmp_path, words, old)
    refuse_changes(Store(tmp_path), new, fresh=False, overrides=words)  # nothing is done yet
    run(runs_of(tmp_path, seeds=1), SweepConfig(), overrides=words)
    manifest.write_manifest(tmp_path, words, old)
    with pytest.raises(ResumeRefused, match=r"change of optimizer\.batch \(1 runs\)"):
        refuse_changes(Store(tmp_path), new, fresh=False, overrides=words)
    refuse_changes(Store(tmp_path), new, fresh=False, overrides=[*words, "seed=1"])
    refuse_changes(Store(tmp_path), new, fresh=True, overrides=words)
    assert not len(load_runs(tmp_path).runs)
    assert len(list((tmp_path / ".superseded").rglob("result.json"))) == 1


def test_a_manifest_repeats_no_part_of_a_configuration(tmp_path: Path) -> None:
    (request,) = runs_of(tmp_path, seeds=1)

    def sized(batch: int) -> dict[str, Any]:
        config = request.identity.config
        return {**config, "optimizer": {**config["optimizer"], "batch": batch}}

    batches, seeds = range(1, 21), range(50)
    runs = {
        f"batch={batch} seed={seed}": replace(request.identity, config=sized(batch), seed=seed)
        for batch in batches
        for seed in seeds
    }
    manifest.write_manifest(tmp_path, [], runs)
    (path,) = (tmp_path / manifest.MANIFESTS).iterdir()
    once = len(json.dumps(dict(request.identity.config)))
    assert path.stat().st_size < 2 * once + 150 * len(runs)
    about = json.loads(path.read_text())
    assert len(about["configs"]) == len(batches)
    execute(
        Store(tmp_path),
        runs["batch=3 seed=4"],
        lambda: minimize(RandomSearch(), DecayFit(), Budget(evaluations=5), 4),
        DecayFit.space,
        {},
    )
    refuse_changes(Store(tmp_path), runs, fresh=False, overrides=[])
    other = {words: replace(run, config=sized(99)) for words, run in runs.items()}
    with pytest.raises(ResumeRefused, match=r"change of optimizer\.batch \(1 runs\)"):
        refuse_changes(Store(tmp_path), other, fresh=False, overrides=[])


@pytest.mark.parametrize("text", ["", "[]", '{"runs": 3}', '{"runs": {"a": {"place": [1]}}}'])
def test_a_damaged_manifest_is_none(tmp_path: Path, text: str) -> None:
    manifest.write_manifest(tmp_path, [], {})
    (path,) = (tmp_path / manifest.MANIFESTS).iterdir()
    path.write_text(text)
    refuse_changes(Store(tmp_path), {}, fresh=False, overrides=[])


def test_a_manifest_cannot_move_what_is_outside(tmp_path: Path) -> None:
    root, outside = tmp_path / "root", tmp_path / "x" / "y"
    outside.mkdir(parents=True)
    (outside / "result.json").write_text("{}")
    identity = runs_of(root, seeds=1)[0].identity
    manifest.write_manifest(root, [], {"seed 0": identity})
    (path,) = (root / manifest.MANIFESTS).iterdir()
    about = json.loads(path.read_text())
    about["runs"]["seed 0"] = {"place": ["..", "x", "y"], "config": 1}
    about["configs"].append({})
    path.write_text(json.dumps(about))
    with pytest.raises(PermissionError):
        refuse_changes(Store(root), {"seed 0": identity}, fresh=True, overrides=[])
    assert (outside / "result.json").exists()


def test_other_code_data_or_packages_are_refused_and_named(tmp_path: Path) -> None:
    runs = runs_of(tmp_path, seeds=2)
    run(runs, SweepConfig())
    store = Store(tmp_path)
    now = {one.words: one.identity for one in runs}
    refuse_changes(store, now, fresh=False)
    changed = {
        words: replace(one, code="other", data="other", packages={**one.packages, "numpy": "9.9"})
        for words, one in now.items()
    }
    message = r"code \(2 runs\), data \(2 runs\), numpy from \S+ to 9\.9 \(2 runs\); .*fresh=true"
    with pytest.raises(ResumeRefused, match=message):
        refuse_changes(store, changed, fresh=False)
    refuse_changes(store, changed, fresh=True)
    refuse_changes(store, changed, fresh=False)
    assert not len(load_runs(tmp_path).runs)
