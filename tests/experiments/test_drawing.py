"""Figures of any root: `root=` and `--root`, one problem, two methods or settings or more."""

from __future__ import annotations

import json
import math
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from experiments import figures
from experiments.app.build import ConfigError, build
from experiments.app.compose import composed
from experiments.app.console import as_options, root_folder
from experiments.app.drawing import compared, stuck
from experiments.app.execution import execution_of
from experiments.app.run_text import table_text
from miho.optim import Budget, RandomSearch, minimize
from miho.study import Identity, Store
from miho.study.manifest import sweep_commands, write_manifest
from miho.testing import DecayFit
from tests.analysis.synthetic import frames

TIRE = ("dataset=tire_lf", "dataset.n=60", "budget.evaluations=60")


def run(root: Path, *overrides: str) -> Identity:
    """One small run, stored."""
    experiment = build(composed([*TIRE, *overrides, f"root={root}"]))
    assert execution_of(experiment).run is not None
    return experiment.identity


def draw(monkeypatch: pytest.MonkeyPatch, *words: object) -> int | str | None:
    monkeypatch.setattr(sys, "argv", ["figures", "fig6", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        figures.main()
    return end.value.code


@pytest.mark.slow
def test_fig6_of_a_root_that_no_comparison_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "runs"
    overrides = ["optimizer=miho,random", "optimizer.R=choice(30,60)"]
    runs = [
        run(root, "optimizer=miho", "optimizer.R=30"),
        run(root, "optimizer=miho", "optimizer.R=60"),
        run(root, "optimizer=random"),
    ]
    write_manifest(root, overrides, {str(number): r for number, r in enumerate(runs)})
    assert draw(monkeypatch, f"root={root}") == 0
    out = capsys.readouterr().out
    for words in ("miho R=30", "miho R=60", "not judged: rows = 60", "at most 60 evaluations"):
        assert words in out, words
    about = json.loads((root / "figures" / "provenance.json").read_text())
    assert shlex.split(about["command"])[3:] == ["-m", *overrides]
    elsewhere = tmp_path / "elsewhere"
    assert draw(monkeypatch, "--root", root, "methods=paper", f"output={elsewhere}") == 0
    assert "random" not in (elsewhere / "results.csv").read_text()
    assert draw(monkeypatch, f"root={root}", "methods=random,gone") == 2
    assert "no runs of gone; expected paper or some of miho, random" in capsys.readouterr().err


def test_a_figure_counts_the_damaged_runs_that_it_leaves_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (20, 30, 40):
        run(tmp_path, "optimizer=random", f"optimizer.batch={number}")
    next(tmp_path.rglob("curve.json")).unlink()
    assert len(compared(tmp_path)[0]) == 2
    assert "1 damaged run is left out; python -m experiments.doctor" in capsys.readouterr().err


@pytest.mark.slow
def test_each_problem_of_a_root_has_its_own_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [f"pacejka-tire_{tire}" for tire in ("lf", "rf")]
    runs = [
        run(tmp_path, f"optimizer={method}", f"dataset={name[8:]}")
        for name in names
        for method in ("random", "least_squares")
    ]
    lost = replace(runs[0], seed=1)
    write_manifest(tmp_path, [], {str(number): r for number, r in enumerate([*runs, lost])})
    for name, missing in zip(names, (True, False), strict=True):
        assert draw(monkeypatch, f"root={tmp_path}", f"problem={name}") == 0
        out, err = capsys.readouterr()
        assert ("1 of 3 runs" in err) == missing
        assert ("per run, without a result: 1 run of random." in out) == missing
        assert (tmp_path / "figures" / name / "fig6.png").is_file()


def test_a_table_in_a_terminal_wraps_names_and_text() -> None:
    table = pd.DataFrame(
        {
            "method": ["miho", "an evolution strategy of the user"],
            "evaluations to best + 1 %": [12345.6, math.inf],
            "success": [0.5, 0],
        }
    )
    assert table_text(table).splitlines() == [
        "method                         evaluations  success",
        "                               to best + 1",
        "                                         %",
        "miho                                12,346    0.500",
        "an evolution strategy of the         never        0",
        "user",
    ]


def test_a_method_that_stays_at_its_start_is_named() -> None:
    steps = {"miho": [[(1.0, 900.0), (9.0, 400.0)]], "gbo_large": [[(1.0, 900.0), (2.0, 899.0)]]}
    steps["miho_gn"] = [[(5.0, 400.0)]]  # it comes from a part of the rows
    assert stuck(frames(steps)[1]) == ["gbo_large"]


def commit(root: Path, optimizer: str, problem: str = "decay") -> None:
    """A run that is stored without a configuration."""
    identity = Identity(problem, optimizer, 0, {}, code="c0de", data="da7a")
    record = minimize(RandomSearch(), DecayFit(), Budget(evaluations=5), 0)
    store = Store(root)
    with store.claim(identity):
        store.commit(identity, record, DecayFit.space, {}, {"unit": "V"})


def test_the_folder_above_a_root_names_the_root(tmp_path: Path) -> None:
    commit(tmp_path / "identify", "random")
    tmp_path.joinpath("other").mkdir()
    with pytest.raises(ConfigError, match=r"holds no finished run; give .*identify$"):
        compared(tmp_path)


def test_what_cannot_be_compared_is_said(tmp_path: Path) -> None:
    tmp_path /= "my runs"
    tmp_path.mkdir()
    with pytest.raises(ConfigError, match="holds no finished run; run python -m"):
        compared(tmp_path)
    commit(tmp_path, "random")
    with pytest.raises(ConfigError, match="holds only runs of random; a comparison needs a sec"):
        compared(tmp_path)
    commit(tmp_path, "pso_100")
    runs, curves = compared(tmp_path)
    assert set(runs["id"]) == set(curves["id"])
    assert len(compared(tmp_path, ids=list(runs["id"]))[0]) == 2
    with pytest.raises(ConfigError, match="no runs of gone; expected paper or some of pso_100, r"):
        compared(tmp_path, methods=["random", "gone"])
    commit(tmp_path, "random", "growth")
    with pytest.raises(ConfigError, match=r"root='.*my runs' problem=NAME, expected one of d"):
        compared(tmp_path)
    assert len(compared(tmp_path, problem="decay")[0]) == 2
    with pytest.raises(ConfigError, match=r"problem: is x, but .* has no runs on it; expected one"):
        compared(tmp_path, problem="x")


def test_options_may_be_written_as_overrides_are() -> None:
    words = ["fig6", "root=a=b", "--output", "c", "other=d"]
    assert as_options(words, ("root",)) == ["fig6", "--root=a=b", "--output", "c", "other=d"]
    assert root_folder("root=runs/x") == root_folder("runs/x") == Path("runs/x")


def test_the_sweeps_of_a_root_are_known_by_their_overrides(tmp_path: Path) -> None:
    assert sweep_commands(tmp_path) == []
    write_manifest(tmp_path, ["optimizer=miho", "seed=0,1"], {})
    (tmp_path / ".sweeps" / "broken.json").write_text("{")
    command = "experiments.identify -m optimizer=miho seed=0,1"
    assert sweep_commands(tmp_path) == [["python", "-m", *command.split()]]
    write_manifest(tmp_path, ["seed=0"], {}, "experiments.compare")
    assert sweep_commands(tmp_path)[1] == ["python", "-m", "experiments.compare", "seed=0"]
    for root in (tmp_path / "moved", tmp_path):  # a sweep of a root that was moved, and the next
        write_manifest(tmp_path, ["seed=1", f"root={root}"], {})
    assert [words[-1] for words in sweep_commands(tmp_path)[2:]] == [f"root={tmp_path}"]


def test_the_command_of_a_moved_root_names_it_though_nobody_typed_it(tmp_path: Path) -> None:
    write_manifest(tmp_path / "runs", ["seed=0"], {})
    moved = (tmp_path / "runs").rename(tmp_path / "moved")
    assert sweep_commands(moved)[0][4:] == ["seed=0", f"root={moved}"]
