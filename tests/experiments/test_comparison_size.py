"""Which runs of a comparison are done again, and what its size leaves untested."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from experiments.app.build import ConfigError
from experiments.app.compose import composed
from experiments.app.configured import differences
from experiments.app.launch import set_aside_disturbed
from experiments.app.plan import Request, requests
from experiments.app.schema import register
from miho.optim import Budget, RandomSearch, minimize
from miho.study import Store, load_runs
from miho.testing import DecayFit

register()


def stored(root: Path, *overrides: str, valid: bool = True, seed: int = 0) -> Request:
    """A run that is finished without having been done: its method and data are others."""
    (request,) = requests(composed([*overrides, f"root={root}"]), "", [seed])
    record = minimize(RandomSearch(), DecayFit(), Budget(evaluations=5), seed)
    store = Store(root)
    with store.claim(request.identity):
        store.commit(request.identity, record, DecayFit.space, {}, {"timing_valid": valid})
    return request


def test_fresh_makes_room_for_what_was_disturbed_as_often_as_asked(tmp_path: Path) -> None:
    quiet = stored(tmp_path, "optimizer=random", seed=0)
    for _ in range(3):
        disturbed = stored(tmp_path, "optimizer=random", valid=False, seed=1)
        set_aside_disturbed([quiet, disturbed])
        assert load_runs(tmp_path).runs["seed"].tolist() == [0]
    assert len(list((tmp_path / ".superseded").rglob("result.json"))) == 3


def test_a_comparison_of_full_size_has_no_differences(tmp_path: Path) -> None:
    for method in ("miho", "pso_100", "random"):
        stored(tmp_path, "experiment=paper_fig6", f"optimizer={method}")
    result = differences(load_runs(tmp_path).runs)
    assert (result.methods, result.budget) == ({}, "")


def test_a_configuration_that_says_nothing_is_bad_input(tmp_path: Path) -> None:
    run = stored(tmp_path, "optimizer=random")
    other = replace(run.identity, config={"budget": 3})
    record = minimize(RandomSearch(), DecayFit(), Budget(evaluations=5), 0)
    store = Store(tmp_path / "other")
    with store.claim(other):
        store.commit(other, record, DecayFit.space, {}, {})
    with pytest.raises(ConfigError, match="its configuration has no budget; identify again"):
        differences(load_runs(tmp_path / "other").runs)


def test_a_reduced_comparison_says_what_is_smaller(tmp_path: Path) -> None:
    reduced = "experiment=compare"
    stored(tmp_path, reduced, "optimizer=miho", "optimizer.R=2000")
    stored(tmp_path, reduced, "optimizer=pso_100", "optimizer.particles=10")
    stored(tmp_path, reduced, "optimizer=random")
    stored(tmp_path, reduced, "optimizer=dual_annealing")  # has no part in the paper's
    result = differences(load_runs(tmp_path).runs)
    assert result.methods == {
        "miho": "miho has R = 2000 instead of 10000",
        "pso_100": "pso_100 has particles = 10 instead of 100",
    }
    assert result.budget == "at most 4 s per run instead of 30"
    stored(tmp_path / "few", reduced, "optimizer=random", "budget.evaluations=2000")
    assert differences(load_runs(tmp_path / "few").runs).budget == (
        "at most 4 s per run instead of 30, at most 2,000 evaluations per run"
    )
