"""The report of stored runs: what it writes, what it refuses."""

import json
import re
import sys
from dataclasses import asdict, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments import report
from experiments.app.build import ConfigError, build, rebuild
from experiments.app.compose import composed
from experiments.app.execution import execution_of
from experiments.app.optimum import OTHER_METHODS, descents_of, remedy, report_of, save_run
from experiments.app.run_text import _ending, result_text
from miho.analysis.pages.run import report_folder
from miho.models.identified import read_parameters
from miho.optim import Descents
from miho.study import StoredRun, load_runs, read_run
from miho.vehicle.models import Pacejka
from tests.analysis.sweep_synthetic import embedded

TIRE = ("dataset=tire_lf", "dataset.n=300", "space=seong_physical")
FAST = ("optimizer=least_squares", "optimizer.rounds=1")


def stored_run(root: Path, *overrides: str) -> StoredRun:
    execution = execution_of(build(composed([*FAST, f"root={root}", *overrides])))
    assert execution.run is not None
    return execution.run


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    for overrides in (["seed=0"], ["seed=1", "optimizer.screen=10", "optimizer.starts=1"]):
        stored_run(folder, *TIRE, *overrides)
    return folder


def test_a_report_writes_through_no_link_that_was_left_there(tmp_path: Path) -> None:
    stored = stored_run(tmp_path / "runs", *TIRE)
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "private.png").write_text("mine")
    problem = rebuild(stored)
    folder = report_folder(stored)
    folder.mkdir(parents=True)
    (folder / "fit.png").symlink_to(outside / "private.png")
    save_run(report_of(problem, stored), stored, folder)
    assert (outside / "private.png").read_text() == "mine"
    assert (folder / "fit.png").read_bytes().startswith(b"\x89PNG")
    folder.rename(tmp_path / "moved")
    folder.symlink_to(outside)
    with pytest.raises(PermissionError, match="leads out of the folder of results"):
        report_folder(stored)


def called(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["report", *map(str, arguments)])
    report.main()


def test_a_posterior_on_request(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file of groups, whose attributes name the run; its means are near the optimum."""
    if find_spec("emcee") is None or find_spec("arviz") is None:
        pytest.skip("the extra `posterior` is not installed")
    import xarray

    stored = stored_run(tmp_path, *TIRE)
    called(monkeypatch, stored.folder, "--posterior", "--no-profile", "--output", tmp_path / "page")
    output = capsys.readouterr().out
    path = Path(re.findall(r"^posterior (.*)", output, re.MULTILINE)[0])
    assert path.parent.is_relative_to(tmp_path / "page")
    with xarray.open_dataset(path, group="posterior") as samples:
        for name, value in zip("BC", stored.result["theta"], strict=False):
            assert abs(samples[name].mean() - value) < samples[name].std()
    with xarray.open_dataset(path) as whole:
        assert json.loads(whole.attrs["provenance"])["data"] == stored.result["data"]
    with pytest.raises(SystemExit):
        called(monkeypatch, tmp_path, "--posterior")
    assert "--posterior is for one run; name its folder" in capsys.readouterr().err


def test_the_best_run_of_a_root(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    called(monkeypatch, root, "--bootstrap", 20)
    output = capsys.readouterr().out
    for words in ("95 % interval", "B and C are hard to distinguish", "kN/rad", "report.html"):
        assert words in output
    best = load_runs(root).runs.sort_values("error").iloc[0]
    (folder,) = (root / "reports" / "pacejka-tire_lf").iterdir()
    assert folder.name == f"least_squares-{best['id'][:12]}"
    identified = read_parameters(folder / "parameters.json", Pacejka())
    assert identified.theta == pytest.approx(
        [best[f"theta.{name}"] for name in Pacejka.parameters], rel=1e-5
    )
    for value in identified.parameters.values():
        assert value.low < value.value < value.high
    assert identified.provenance["degrees_of_freedom"] == 295
    deviation = identified.provenance["residual_standard_deviation"]
    assert deviation == pytest.approx(identified.provenance["error"] * np.sqrt(300 / 295))
    evidence = "Converged: 10 of 10 descents (500 starting points screened) found this optimum. "
    assert identified.provenance["optimum"].startswith(evidence)
    assert identified.provenance["seed"] == best["seed"]
    assert identified.provenance["interval"] == "profile"
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert (folder / "descents.png").read_bytes().startswith(b"\x89PNG")
    ends = pd.read_csv(folder / "descents.csv")
    assert (ends["ended here"] == "yes").all()
    assert ends["error"].to_numpy() == pytest.approx(identified.provenance["error"], rel=1e-4)
    for words in (
        "bootstrap replicates",
        "10 descents ended, from the best of 500 configurations",
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


def test_the_page_of_all_runs(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    broken = stored_run(root, *TIRE, "seed=2").folder
    (broken / "curve.json").write_text("{}")
    called(monkeypatch, root, "--quick", "--output", tmp_path)
    assert capsys.readouterr().out == f"all runs {tmp_path / 'report.html'}\n"
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in (
        f"Runs of {root.name}",
        f"python -m experiments.report {root.name} --quick",
        "Intervals were not computed",
        "1 run folder is damaged and is omitted",
        broken.relative_to(root).as_posix(),
        "sample_tir",
        "least squares",
    ):
        assert words in page, words
    assert embedded(page, "curves-0")["recorded"] is False, "the best of these runs, if anything"
    assert str(root) not in page, "the page may be shown to others"
    assert "reports/" not in page
    called(monkeypatch, root)
    page = (root / "report.html").read_text(encoding="utf-8")
    (link,) = re.findall(r'href="(reports/[^"]*)"', page)
    assert (root / link).is_file()
    assert "95 % interval (profile)" in page
    called(monkeypatch, root, "--no-detail")
    page = (root / "report.html").read_text(encoding="utf-8")
    assert f'href="{link}"' in page, "the detailed page of the same run is still there"


def test_a_comparison_has_its_claims_and_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    ids = []
    for optimizer in ("least_squares", "miho"):
        overrides = [*TIRE, f"optimizer={optimizer}", "budget.evaluations=200", f"root={tmp_path}"]
        for seed in (0, 1):
            stored = execution_of(build(composed([*overrides, f"seed={seed}"]))).run
            assert stored is not None
            ids.append(stored.result["id"])
    about = {"command": ["python", "-m", "x"], "note": "small <b>", "runs": ids}
    (tmp_path / "comparison.json").write_text(json.dumps(about))
    called(monkeypatch, tmp_path, "--quick")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in ("python -m x", "small &lt;b&gt;", "Claims of the paper", "494×", "verdict"):
        assert words in page, words
    (tmp_path / "comparison.json").write_text(json.dumps(about | {"runs": [*ids, "gone"]}))
    called(monkeypatch, tmp_path, "--quick")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Runs of the comparison are missing (1)" in page
    assert "Claims of the paper" not in page


def test_quick_is_for_roots(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        called(monkeypatch, load_runs(root).runs["folder"][0], "--quick")
    assert "the folder of one run" in capsys.readouterr().err


def test_a_check_by_name_adds_descents_from_other_starts(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """In two seconds there is time for more descents than the ten of the run."""
    folder = load_runs(root).runs.set_index("seed").loc[0, "folder"]
    called(monkeypatch, folder, "--no-profile", "--output", tmp_path)
    ended = r": (?:only )?(\d+) of (\d+) descents \([\d,]+ starting points screened\) found"
    ((before, first),) = re.findall(ended, capsys.readouterr().out)
    called(monkeypatch, folder, "--check", 2, "--no-profile", "--output", tmp_path)
    out = capsys.readouterr().out
    ((here, finished),) = re.findall(ended, out)
    assert int(finished) > int(first) == 10
    assert int(before) <= int(here) <= int(finished)
    with pytest.raises(SystemExit, match="2"):
        called(monkeypatch, folder, "--check", 0)


def test_an_optimum_in_doubt_comes_with_what_to_type(tmp_path: Path) -> None:
    """A search of one start for a frequency, which ends in one of many local optima."""
    path = tmp_path / "wave.py"
    path.write_text(
        "import numpy as np\n"
        'def wave(alpha: "rad", *, a: "N", b: "1/rad") -> "N":\n'
        "    return a * np.sin(b * alpha)\n"
    )
    data = tmp_path / "wave.csv"
    alpha = np.linspace(-0.4, 0.4, 100)
    pd.DataFrame({"alpha": alpha, "Fy": 3000 * np.sin(20 * alpha)}).to_csv(data, index=False)
    overrides = ["model=function", f"model.path={path}", "dataset=csv", f"dataset.path={data}"]
    space = "+space={a: {unit: N, low: 0, high: 9000}, b: {unit: 1/rad, low: 60, high: 900}}"
    poor = ["optimizer.screen=5", "optimizer.starts=2", f"root={tmp_path / 'runs'}"]
    experiment = build(composed([*FAST, *overrides, "~space", space, *poor]))
    stored = execution_of(experiment).run
    assert stored is not None
    text = result_text(experiment, stored)
    assert "the optimum is in doubt" in text
    assert "optimizer.screen=50 optimizer.starts=10" in text
    assert "space.a.scale=log space.a.low=0.009" in text
    assert f"python -m experiments.report {stored.folder} --check --trust" in text
    assert "of this local optimum" in text
    for blame in ("wrong shape", "check units", "not identifiable", "told from 0"):
        assert blame not in text
    page = (report_folder(stored) / "report.html").read_text(encoding="utf-8")
    assert "optimizer.screen=50 optimizer.starts=10" in page
    assert "wrong shape" not in page


def test_the_gap_is_of_what_is_reported_and_of_the_run(tmp_path: Path) -> None:
    """A cubic has a closed form: the report is of it, however poor the run was."""
    poor = ["dataset=torque_15", "optimizer=random", "budget.evaluations=30"]
    experiment = build(composed([*poor, f"root={tmp_path / 'runs'}"]))
    stored = execution_of(experiment).run
    assert stored is not None
    text = result_text(experiment, stored)
    best = np.sqrt(experiment.facts["optimum"])
    ratio = 100 * (np.sqrt(stored.result["loss"]) / best - 1)
    assert ratio > 1
    assert f"(closed form), gap 0.0000 %; of the run itself {ratio:.4f} %" in text
    assert re.search(
        r"optimum +Converged: the model is linear in all parameters, so no other", text
    )
    assert "in doubt" not in text


def test_another_seed_is_not_the_one_of_the_run(root: Path) -> None:
    stored = read_run(Path(load_runs(root).runs.set_index("seed").loc[1, "folder"]))
    config = {**stored.config, "optimizer": {"name": "cma_es"}}
    assert "another seed: seed=2;" in remedy(rebuild(stored), replace(stored, config=config))


def test_another_method_is_not_the_one_of_the_run(root: Path) -> None:
    """A run that ended by itself would end there again, whatever its budget."""
    stored = read_run(Path(load_runs(root).runs.set_index("seed").loc[1, "folder"]))
    for method in ("random", *OTHER_METHODS):
        config = {**stored.config, "optimizer": {}}
        result = {**stored.result, "optimizer": method}
        advice = remedy(rebuild(stored), replace(stored, config=config, result=result))
        (other,) = re.findall(r"search again with another method: optimizer=(\w+); ", advice)
        assert other != method
        composed([f"optimizer={other}"])


@pytest.mark.parametrize(
    ("outcome", "descents", "ending"),
    [
        ("converged", None, "itself"),
        ("converged", Descents(7, 7, 7, 0, (1.0,) * 7), "itself, after enough of its"),
        ("budget", Descents(8, 7, 7, 0, (1.0,) * 7), "its budget, after enough of its"),
        ("budget", Descents(8, 7, 7, 0, (1.0,) * 6 + (2.0,)), "its budget, before enough"),
        ("budget", Descents(8, 7, 7, 0, (1e-30, 1e-26) + (1e-25,) * 5), "its budget, after"),
        ("budget", Descents(1, 0, 0, 0, (), 20), "its budget, before enough of"),
        ("converged", Descents(7, 7, 7, 0, (2.0,) * 7), "itself, before enough of its descents"),
        ("converged", Descents(7, 7, 7, 0, (1.0,) * 6, dropped=1), "itself, before enough of its"),
        ("brackets", Descents(3, 3, 3, 0, (1.0,), 9, 1, 2, True),
         "its largest number of brackets, before enough of its independent searches agreed"),
        ("budget", Descents(7, 7, 7, 0, (1.0,) * 7, brackets=True, settled=False),
         "its budget, before enough of its independent searches agreed"),
        ("converged", Descents(3, 3, 2, 0, (1.0, 2.0, 3.0)), "agreed; 1 of 3 descents were still"),
    ],
)  # fmt: skip
def test_the_ending_says_whether_the_evidence_was_enough(
    outcome: str, descents: Descents | None, ending: str
) -> None:
    loss = min(descents.ends, default=1.0) if descents else 1.0
    loss = 1.0 if loss > 1e-20 else loss
    assert ending in _ending({"outcome": outcome, "loss": loss}, descents, 1e-20, None)


def test_the_ending_says_that_a_later_step_found_a_better_optimum() -> None:
    descents = Descents(7, 7, 7, 0, (1.0,) * 7)
    ending = _ending({"outcome": "converged", "loss": 1.0}, descents, 0.0, None, "a profile")
    assert ending == "itself, after enough of its descents agreed; a profile found a better optimum"
    cut = replace(descents, brackets=True, settled=False)
    ending = _ending({"outcome": "budget", "loss": 1.0}, cut, 0.0, None, "a profile")
    assert ending == (
        "its budget, before enough of its independent searches agreed; a profile found a better "
        "optimum"
    )


def test_where_there_is_one_optimum_nothing_has_to_agree() -> None:
    descents = Descents(1, 1, 1, 0, (1.0,), 1)
    ending = _ending({"outcome": "converged", "loss": 1.0}, descents, 0.0, 1.0)
    assert ending == "itself, in the only optimum: the problem is linear in all its parameters"
    missed = _ending({"outcome": "converged", "loss": 1.1}, descents, 0.0, 1.0)
    assert missed == "itself, before enough of its descents agreed"


@pytest.mark.parametrize(("spent", "more"), [(1.0, "evaluations=5000000"), (60.01, "seconds=600")])
def test_more_of_what_ended_the_run_is_a_setting(root: Path, spent: float, more: str) -> None:
    stored = read_run(Path(load_runs(root).runs.set_index("seed").loc[1, "folder"]))
    cut = {**stored.result, "outcome": "budget", "seconds": spent}
    advice = remedy(rebuild(stored), replace(stored, result=cut))
    assert advice.startswith(f"search again with a larger budget: budget.{more}; more starts: ")
    composed([f"budget.{more}"])


def test_a_run_that_ran_out_of_brackets_may_have_more(root: Path) -> None:
    stored = read_run(Path(load_runs(root).runs.set_index("seed").loc[1, "folder"]))
    ran_out = replace(
        stored,
        result={**stored.result, "optimizer": "miho_gn", "outcome": "brackets"},
        config={**stored.config, "optimizer": {"max_brackets": 200}},
    )
    advice = remedy(rebuild(stored), ran_out)
    assert advice.startswith(
        "search again with more brackets: optimizer.max_brackets=2000; another method: "
    )
    assert "optimizer=miho_gn" not in advice
    composed(["optimizer=miho_gn", "optimizer.max_brackets=2000"])


def test_runs_without_a_word_on_descents_are_read(root: Path) -> None:
    """Those of older versions, and those that somebody edited."""
    stored = read_run(Path(load_runs(root).runs.set_index("seed").loc[0, "folder"]))
    descents = descents_of(stored)
    assert descents is not None
    assert (descents.finished, descents.agreeing, descents.screened) == (10, 10, 500)
    before = {k: v for k, v in asdict(descents).items() if k not in ("screened", "agreeing")}
    old = descents_of(replace(stored, result={**stored.result, "descents": before}))
    assert old == replace(descents, screened=0, agreeing=None)
    for summary in (None, {}, {"ends": [1.0]}, {"started": 1, "many": 2}):
        result = {**stored.result, "descents": summary}
        assert descents_of(replace(stored, result=result)) is None


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
    printed = capsys.readouterr()
    assert printed.err.count("3 rows for ") == 2
    reports = [line for line in printed.out.splitlines() if line.startswith("report ")]
    assert len(reports) == 2, "other data of the same name is another problem"
    page = (root / "report.html").read_text(encoding="utf-8")
    assert page.count("No intervals: ") == 2
    headings = re.findall(r"<h3>([^<]*)</h3>", page)
    assert len(set(headings)) == 4
    told_apart = r"path=\S*/[xy]/(few|many)\.csv$"  # by the setting that differs
    assert all(re.search(told_apart, heading) for heading in headings), headings


@pytest.mark.slow
def test_ends_on_exact_data_agree_as_they_did_for_the_search(tmp_path: Path) -> None:
    """Losses alone leave some 1e-22 of data without errors, which is more than rounding does."""
    overrides = ["problem=mgh_gulf_starts", "optimizer=miho_qn", f"root={tmp_path}"]
    experiment = build(composed(overrides))
    stored = execution_of(experiment, quiet=True).run
    assert stored is not None
    assert stored.result["outcome"] == "converged"
    assert stored.result["loss"] > experiment.problem.rounding
    assert "itself, after enough of its independent searches agreed" in result_text(
        experiment, stored
    )
