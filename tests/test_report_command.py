"""The report of stored runs: what it writes, what it refuses."""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments import report
from experiments.build import ConfigError, build, rebuild
from experiments.cli import composed
from experiments.run import run
from experiments.schema import register
from miho.models import Pacejka
from miho.models.identified import read_parameters
from miho.study import StoredRun, load_runs

register()
TIRE = ("dataset=tire_lf", "dataset.n=300")
FAST = ("optimizer=least_squares", "optimizer.rounds=1")


def stored_run(root: Path, *overrides: str) -> StoredRun:
    execution = run(build(composed([*FAST, f"root={root}", *overrides])))
    assert execution.run is not None
    return execution.run


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    for overrides in (["seed=0"], ["seed=1", "optimizer.screen=10", "optimizer.starts=1"]):
        stored_run(folder, *TIRE, *overrides)
    return folder


def called(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["report", *map(str, arguments)])
    report.main()


def test_the_best_run_of_a_root(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    called(monkeypatch, root, "--bootstrap", 20)
    told = capsys.readouterr().out
    for words in ("95 % interval", "B and C are hard to tell apart", "kN/rad", "report.html"):
        assert words in told
    best = load_runs(root).runs.sort_values("error").iloc[0]
    (folder,) = (root / "reports" / "pacejka-tire_lf").iterdir()
    assert folder.name == f"least_squares-{best['id'][:12]}"
    found = read_parameters(folder / "parameters.json", Pacejka())
    assert found.theta.tolist() == [best[f"theta.{name}"] for name in Pacejka.parameters]
    assert found.provenance["seed"] == best["seed"]
    assert found.provenance["interval"] == "profile"
    page = (folder / "report.html").read_text(encoding="utf-8")
    for words in (
        "bootstrap replicates",
        "leave a fifth of Fz out",
        "Correlation",
        "Profiles",
        "numpy",
    ):
        assert words in page
    derived = pd.read_csv(folder / "derived.csv")
    assert (derived["bootstrap low"] < derived["bootstrap high"]).all()
    again = json.loads((folder / "parameters.json").read_text(encoding="utf-8"))
    called(monkeypatch, root, "--no-profile")
    assert json.loads((folder / "parameters.json").read_text())["parameters"].keys() == (
        again["parameters"].keys()
    )
    assert load_runs(root).damaged.empty


@pytest.mark.slow
def test_one_run_and_another_folder(
    root: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    worst = load_runs(root).runs.sort_values("error").iloc[-1]
    called(monkeypatch, worst["folder"], "--output", tmp_path, "--level", 0.5)
    (page,) = tmp_path.rglob("report.html")
    assert worst["id"][:12] in str(page)
    assert "50 % intervals" in page.read_text(encoding="utf-8")


def test_what_has_changed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "mine.csv"
    alpha = np.linspace(-0.2, 0.2, 60)
    force = -4000 * np.tanh(15 * alpha)
    pd.DataFrame({"alpha": alpha, "Fy": force}).to_csv(path, index=False)
    run_ = stored_run(tmp_path / "runs", "dataset=csv", f"dataset.path={path}")
    path.write_text(path.read_text() + "0.1,-3000\n")
    with pytest.raises(ConfigError, match="data have changed since"):
        rebuild(run_)
    tmp_path.joinpath("empty").mkdir()
    with pytest.raises(ConfigError, match="holds no finished run"):
        called(monkeypatch, tmp_path.joinpath("empty"))


def test_a_compressed_problem_is_made_again_as_such(root: Path) -> None:
    for switch in (True, False):
        made = build(composed([*FAST, *TIRE, f"root={root}", f"problem.compressed={switch}"]))
        result = {"data": made.problem.dataset.digest}
        stored = StoredRun(root, made.identity.config, {}, {}, result)
        assert rebuild(stored).compressed is switch


def test_code_of_the_users_runs_only_if_trusted(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text('def line(alpha: "rad", *, a: "N/rad") -> "N":\n    return a * alpha\n')
    overrides = ["model=function", f"model.path={path}", "~space", *TIRE]
    space = "+space={a: {unit: N/rad, low: -1e6, high: 0}}"
    stored = stored_run(tmp_path / "runs", *overrides, space)
    path.write_text(f"import os\nos.mkdir({str(tmp_path / 'canary')!r})\n" + path.read_text())
    with pytest.raises(ConfigError, match=r"its model is code in .*mine.py; add --trust"):
        rebuild(stored)
    assert not (tmp_path / "canary").exists()
    assert rebuild(stored, trusted=True).model.name == "line"


@pytest.mark.slow
def test_a_run_that_cannot_be_reported_stops_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "runs"
    for name, rows in (("few", 3), ("many", 60)):
        alpha = np.linspace(-0.2, 0.2, rows)
        data = pd.DataFrame({"alpha": alpha, "Fy": -4000 * np.tanh(15 * alpha)})
        for folder in ("x", "y"):
            path = tmp_path / folder / f"{name}.csv"
            path.parent.mkdir(exist_ok=True)
            data.assign(Fy=data["Fy"] * (1.1 if folder == "y" else 1)).to_csv(path, index=False)
            stored_run(root, "dataset=csv", f"dataset.path={path}")
    monkeypatch.setattr(sys, "argv", ["report", str(root)])
    assert report.main() == 3
    told = capsys.readouterr()
    assert told.err.count("3 rows for ") == 2
    assert told.out.count("report.html") == 2, "other data of the same name is another problem"
