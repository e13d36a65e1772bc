"""Origins are read with their checksums and told in few words."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from miho import Budget, load_runs, minimize
from miho.analysis.pages.sweep_contents import best_runs
from miho.analysis.pages.sweep_runs import MANY, Sweep, environment_table, json_leaves
from miho.optim import RandomSearch, RunRecord
from miho.study import Identity, Store, execute
from miho.study.identity import canonical, sha256
from miho.testing import DecayFit
from tests.analysis.sweep_synthetic import origin


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for seed in range(3):
        config = {"optimizer": {"n": 1}, "budget": {"evaluations": 50}}
        identity = Identity("decay", "random", seed, config, code="c0de", data="da7a")

        def job(seed: int = seed) -> RunRecord:
            return minimize(RandomSearch(), DecayFit(), Budget(evaluations=50), seed)

        execute(Store(tmp_path), identity, job, DecayFit.space, {"unit": "V"})
    return tmp_path


def test_origins_of_stored_runs(root: Path) -> None:
    sweep = Sweep.of(load_runs(root))
    assert sweep.damaged.empty
    first, second, _ = sweep.origins.values()
    assert (first.code, first.data) == ("c0de", "da7a")
    assert first.config == {"optimizer.n": "1", "budget.evaluations": "50"}
    assert first.environment["python"].startswith('"3.')
    assert second.config is first.config


def test_of_equal_runs_the_best_has_evidence(root: Path) -> None:
    sweep = Sweep.of(load_runs(root))
    runs = sweep.runs.assign(
        error=[0.5, 0.5 * (1 + 1e-15), 0.4], outcome=["budget", "converged", "budget"]
    )
    folders = list(map(Path, runs["folder"]))
    assert best_runs(replace(sweep, runs=runs[:2])) == {"decay": folders[1]}
    assert best_runs(replace(sweep, runs=runs)) == {"decay": folders[2]}


def test_a_page_shows_the_runs_as_they_were_read(root: Path) -> None:
    stored = load_runs(root)
    Path(stored.runs["folder"][1], "environment.json").write_text("{}")
    assert len(Sweep.of(stored).origins) == 3


@pytest.mark.parametrize(
    "change", [{"seed": "x"}, {"evaluations": "many"}, {"seconds": None}, {"outcome": 3}]
)
def test_a_forged_result_is_left_out(root: Path, change: dict[str, object]) -> None:
    path = Path(load_runs(root).runs["folder"][1], "result.json")
    result = json.loads(path.read_text()) | change
    del result["sha256"]
    path.write_text(canonical(result | {"sha256": sha256(canonical(result))}))
    sweep = Sweep.of(load_runs(root))
    assert len(sweep.runs) == 2
    assert sweep.damaged["folder"].tolist() == [str(path.parent)]


def test_a_list_in_place_of_a_configuration_is_damage(root: Path) -> None:
    path = Path(load_runs(root).runs["folder"][0])
    result = json.loads((path / "result.json").read_text())
    (path / "config.json").write_text("[1]")
    result["files"]["config.json"] = sha256("[1]")
    del result["sha256"]
    (path / "result.json").write_text(canonical(result | {"sha256": sha256(canonical(result))}))
    sweep = Sweep.of(load_runs(root))
    assert len(sweep.runs) == 2
    assert "config.json: contains no settings" in sweep.damaged["reason"][0]


def test_few_values_are_counted_and_many_are_a_range() -> None:
    times = [f"2026-11-21T18:0{n}:00+00:00" for n in range(9)]
    runs = [
        origin(time=time, load=[0.1 * n, 0, 0], python="3.11" if n else "3.12", tag=f"<{n}>")
        for n, time in enumerate(times)
    ]
    table = environment_table(runs)
    counts = {(row.what, row.value): row.runs for row in table.itertuples()}
    assert counts[("python", "3.11")] == 8
    assert counts[("python", "3.12")] == 1
    assert counts[("packages.numpy", "2.4.6")] == 9
    assert counts[("threads", "[1, 1]")] == 9
    assert counts[("time", f"{times[0]} to {times[-1]}")] == 9
    assert counts[("load", "0 to 0.8")] == 9
    assert counts[("tag", "<0> to <8>")] == 9
    assert len(table[table["what"] == "load"]) == 1
    assert MANY < 9


def test_leaves_of_a_configuration() -> None:
    tree = {"a": {"b": 1, "c": {"d": "x"}}, "e": [1], "f": {}, "g": None}
    assert json_leaves(tree) == {"a.b": "1", "a.c.d": '"x"', "e": "[1]", "f": "{}", "g": "null"}
