from __future__ import annotations

import numpy as np
import pytest

from miho.analysis.compare.profiles import area_over_curve
from tests.analysis.several_problems import random_runs, several
from tests.analysis.synthetic import Steps


def areas(steps: list[Steps], budget: float = 100.0) -> list[float]:
    runs, curves = several({"p": {"m": steps}}, optimum={"p": 10.0}, ends={"m": 100.0})
    return [float(area) for area in area_over_curve(runs, curves, budget)["aocc"]]


def test_worked_areas() -> None:
    """Gaps of 1, 0.1 and 0.01 score 1/4, 2/4 and 3/4 between 10 and 1e-3."""
    assert areas(
        [
            [(20.0, 20.0), (60.0, 11.0)],
            [(0.0, 10.0)],
            [(0.0, 200.0)],
            [(50.0, 10.001)],
            [],
            [(10.0, 20.0), (10.0, 10.1)],
        ]
    ) == pytest.approx([0.4 / 4 + 0.4 * 2 / 4, 1, 0, 0.5, 0, 0.9 * 3 / 4])


def test_what_comes_after_the_budget_does_not_count_and_what_ended_is_kept() -> None:
    assert areas([[(10.0, 20.0), (60.0, 10.0)]], budget=50.0) == pytest.approx([0.8 / 4])
    assert areas([[(10.0, 20.0)]], budget=1000.0) == pytest.approx([0.99 / 4])


def test_the_area_is_the_mean_score_over_a_fine_grid() -> None:
    runs, curves = random_runs(np.random.default_rng(4))
    table = area_over_curve(runs, curves, 800.0).set_index(runs["id"])["aocc"]
    middle = np.arange(0.005, 800, 0.01)
    for run, rows in curves.groupby("id"):
        at = rows["evaluations"].to_numpy()
        gap = np.append(np.inf, rows["error"] / 10 - 1)[np.searchsorted(at, middle, side="right")]
        score = 1 - (np.log10(np.clip(gap, 1e-3, 10)) + 3) / 4
        # steps are at whole evaluations, so the midpoint rule is exact up to rounding
        assert table[run] == pytest.approx(score.mean(), rel=1e-10)


def test_the_budget_is_the_most_that_was_spent_unless_given_by_problem() -> None:
    runs, curves = random_runs(np.random.default_rng(4))
    assert set(area_over_curve(runs, curves)["budget"]) == {1000.0}
    by_problem = area_over_curve(runs, curves, {"p0": 100.0, "p1": 200.0, "p2": 300.0})
    assert dict(zip(by_problem["problem"], by_problem["budget"], strict=True)) == {
        "p0": 100.0, "p1": 200.0, "p2": 300.0
    }  # fmt: skip
    alone = area_over_curve(runs, curves, 200.0)["aocc"][runs["problem"] == "p1"]
    np.testing.assert_array_equal(by_problem["aocc"][runs["problem"] == "p1"], alone)


def test_bad_budgets_are_named() -> None:
    runs, curves = random_runs(np.random.default_rng(4))
    with pytest.raises(ValueError, match="budget of p1 is None; expected a number above zero"):
        area_over_curve(runs, curves, {"p0": 1.0, "p2": 1.0})
