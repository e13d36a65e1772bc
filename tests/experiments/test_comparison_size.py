"""Which runs of a comparison are done again, and what their configurations say of its size."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.app.compose import composed
from experiments.app.plan import Request, requests
from experiments.app.runs import run, set_aside_disturbed
from experiments.app.schema import SweepConfig
from miho.analysis.compare.size import PAPER, mismatch, settings_by_method, size_note
from miho.optim import Budget, RandomSearch, minimize
from miho.study import Status, Store, load_runs
from miho.testing import DecayFit


def stored(root: Path, *overrides: str, valid: bool = True, seed: int = 0) -> Request:
    """A run that is finished without having been done: its method and data are others."""
    (request,) = requests(composed([*overrides, f"root={root}"]), "", [seed])
    record = minimize(RandomSearch(), DecayFit(), Budget(evaluations=5), seed)
    store = Store(root)
    with store.claim(request.identity):
        store.commit(
            request.identity, record, DecayFit.space, {}, {"timing_valid": valid, "unit": "N"}
        )
    return request


def test_fresh_makes_room_for_what_was_disturbed_as_often_as_asked(tmp_path: Path) -> None:
    quiet = stored(tmp_path, "optimizer=random", seed=0)
    for _ in range(3):
        disturbed = stored(tmp_path, "optimizer=random", valid=False, seed=1)
        set_aside_disturbed([quiet, disturbed])
        assert load_runs(tmp_path).runs["seed"].tolist() == [0]
    assert len(list((tmp_path / ".superseded").rglob("result.json"))) == 3


def test_fresh_repeats_disturbed_runs_only_where_seconds_count(tmp_path: Path) -> None:
    request = stored(tmp_path, "optimizer=random", "budget.evaluations=20", valid=False)
    for timed, status in ((False, Status.DONE_BEFORE), (True, Status.RAN)):
        (state,) = run([request], SweepConfig(timed=timed), here=True, fresh=True).states
        assert state.status is status


@pytest.mark.parametrize("method", PAPER)
def test_the_configured_methods_have_the_papers_size(method: str, tmp_path: Path) -> None:
    """Rows and settings; the five parameters are those of the model, which was not run here."""
    stored(tmp_path, "dataset=tire_lf", f"optimizer={method}")
    runs = load_runs(tmp_path).runs.assign(dimension=5)
    assert mismatch(settings_by_method(runs), method) == ""


def test_a_reduced_comparison_says_what_is_smaller(tmp_path: Path) -> None:
    stored(tmp_path, "dataset=tire_lf", "optimizer=miho", "optimizer.R=300", "dataset.n=500")
    runs = load_runs(tmp_path).runs.assign(dimension=5)
    assert mismatch(settings_by_method(runs), "miho") == (
        "rows = 500, the claim is for rows = 3,000; R = 300, the claim is for R = 10,000"
    )


def test_runs_that_are_no_longer_there_are_not_known(tmp_path: Path) -> None:
    stored(tmp_path, "dataset=tire_lf", "optimizer=miho")
    runs = load_runs(tmp_path).runs
    (tmp_path / "pacejka-tire_lf").rename(tmp_path / ".gone")
    assert mismatch(settings_by_method(runs), "miho") == "the settings of these runs are not known"


def test_the_note_says_how_large_the_runs_are(tmp_path: Path) -> None:
    common = "dataset=tire_lf", "budget.seconds=4", "budget.evaluations=null"
    for seed in (0, 1):
        stored(tmp_path, *common, "optimizer=miho", "optimizer.R=2000", seed=seed)
    stored(tmp_path, *common, "optimizer=random")
    assert size_note(load_runs(tmp_path).runs) == (
        "R = 2,000, eta = 5, 1 to 2 repetitions (seeds 0 to 1), at most 4 s per run"
    )
    stored(tmp_path, *common, "optimizer=miho", "optimizer.R=300", seed=4)
    assert size_note(load_runs(tmp_path).runs) == (
        "eta = 5, 1 to 2 repetitions (3 seeds 0 to 4), at most 4 s per run"
    )
    stored(tmp_path, *common, "optimizer=random", "dataset.n=300")
    assert size_note(load_runs(tmp_path).runs).endswith(
        ", at most 4 s per run, runs differ in dataset.n, so their errors do not compare"
    )


def test_the_note_names_the_methods_of_each_budget(tmp_path: Path) -> None:
    for method, evaluations in {"random": "300", "pso_100": "3000", "nelder_mead": "3000"}.items():
        limit = f"budget.evaluations={evaluations}"
        stored(tmp_path, "dataset=tire_lf", limit, f"optimizer={method}")
    assert size_note(load_runs(tmp_path).runs) == (
        "1 repetition (seed 0), at most 60 s per run, at most 300 evaluations per run of random, "
        "at most 3,000 evaluations per run of nelder_mead, pso_100"
    )
