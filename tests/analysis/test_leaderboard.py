from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from miho.analysis.compare.leaderboard import (
    best_rivals,
    families,
    family_scores,
    leaderboard,
    problem_scores,
)
from miho.analysis.compare.profiles import area_over_curve
from miho.analysis.compare.running_time import hits, running_times
from miho.analysis.text import to_markdown
from tests.analysis.several_problems import several


def worked() -> tuple[pd.DataFrame, pd.DataFrame]:
    """fast needs 10 and 10; slow 1000 and never, but is near; bad is nowhere; absent has no q."""
    return several(
        {
            "p": {
                "bad": [[(1.0, 90.0)]] * 2,
                "slow": [[(1.0, 20.0), (1000.0, 10.0)]] * 2,
                "fast": [[(10.0, 10.05)]] * 2,
                "absent": [[(40.0, 10.0)]] * 2,
            },
            "q": {
                "bad": [[(1.0, 90.0)]] * 2,
                "slow": [[(1.0, 20.0), (1000.0, 11.0)]] * 2,
                "fast": [[(10.0, 10.0)], [(10.0, 50.0)]],
            },
        },
        optimum={"p": 10.0, "q": 10.0},
        ends=dict.fromkeys(["bad", "slow", "fast", "absent"], 2000.0),
    )


def test_the_leaderboard_of_a_worked_example() -> None:
    table = leaderboard(*worked()).set_index("method")
    # p: fast, absent, slow, bad; q: fast, then by area slow and bad, then absent, which has none
    assert table["mean rank"].to_dict() == {"fast": 1, "slow": 2.5, "absent": 3, "bad": 3.5}
    assert table.index.tolist() == ["fast", "slow", "absent", "bad"]
    assert table["solved of 2"].to_dict() == {"fast": 2, "absent": 1, "slow": 1, "bad": 0}
    assert table["success at 1.01"].to_dict() == {
        "fast": 0.75, "absent": 1, "slow": 0.5, "bad": 0
    }  # fmt: skip
    assert table["success at 1.001"]["fast"] == 0.25
    assert table["times the best"]["fast"] == 1
    assert table["times the best"]["slow"] == pytest.approx(100)
    assert np.isnan(table["times the best"]["bad"])
    assert table["AOCC"]["bad"] == pytest.approx((1 - np.log10(8)) / 4 * 1999 / 2000)
    assert table["µs per evaluation"].tolist() == pytest.approx([100.0] * 4)
    assert "never" not in to_markdown(table.reset_index())


def test_the_pace_is_that_of_runs_that_nothing_disturbed() -> None:
    runs, curves = worked()
    runs["timing_valid"] = pd.Series(True, runs.index, dtype=object)
    first = ~runs.duplicated("optimizer")
    runs.loc[first, "seconds"] *= 1000
    runs.loc[first, "timing_valid"] = False
    runs.loc[runs["optimizer"] == "bad", "timing_valid"] = None
    pace = leaderboard(runs, curves).set_index("method")["µs per evaluation"]
    assert pace[["fast", "slow", "absent"]].tolist() == pytest.approx([100.0] * 3)
    assert np.isnan(pace["bad"])


def test_scores_put_every_solver_ahead_and_order_the_others_by_area() -> None:
    runs, curves = worked()
    ert = running_times(hits(runs, curves, (1.01,)), "evaluations")
    areas = area_over_curve(runs, curves)
    scores = problem_scores(ert, areas, 1.01)
    assert scores.notna().all(axis=None)
    q, p = scores.loc["q"], scores.loc["p"]
    assert q["fast"] == pytest.approx(np.log10(2010))
    assert q["fast"] + 1 < q["slow"] < q["bad"] < q["absent"] == pytest.approx(q["fast"] + 2)
    assert p["slow"] == pytest.approx(3)
    assert p.sort_values().index.tolist() == ["fast", "absent", "slow", "bad"]


def test_without_areas_methods_that_do_not_solve_a_problem_are_equal_on_it() -> None:
    runs, curves = worked()
    ert = running_times(hits(runs, curves, (1.01,)), "evaluations")
    scores = problem_scores(ert, None, 1.01)
    q = scores.loc["q"]
    assert q["fast"] == pytest.approx(np.log10(2010))
    assert q["slow"] == q["bad"] == q["absent"] == pytest.approx(q["fast"] + 1)
    with_areas = problem_scores(ert, area_over_curve(runs, curves), 1.01)
    assert scores.loc["p", "slow"] == with_areas.loc["p", "slow"] == pytest.approx(3)


def test_a_problem_that_nobody_solves_is_ordered_by_area() -> None:
    runs, curves = several(
        {"p": {"near": [[(1.0, 11.0)]], "far": [[(1.0, 30.0)]]}}, optimum={"p": 10.0}
    )
    table = leaderboard(runs, curves)
    assert table["method"].tolist() == ["near", "far"]
    assert table["mean rank"].tolist() == [1, 2]
    assert table["solved of 1"].tolist() == [0, 0]
    assert table["times the best"].isna().all()


def test_a_family_counts_once_beside_the_rank_over_problems() -> None:
    """On q, r and s one method wins by 10 times; on p the other does: two families, a draw."""
    quick, late = [[(10.0, 10.0)]], [[(100.0, 10.0)]]
    runs, curves = several(
        {"p": {"a": late, "b": quick}} | {name: {"a": quick, "b": late} for name in "qrs"},
        optimum=dict.fromkeys("pqrs", 10.0),
    )
    board = leaderboard(runs, curves).set_index("method")
    assert "by families" not in board
    runs["family"] = runs["problem"].where(runs["problem"] == "p", "alike")
    board = leaderboard(runs, curves).set_index("method")
    assert board["mean rank"].to_dict() == {"a": 1.25, "b": 1.75}
    assert board["by families"].to_dict() == {"a": 1.5, "b": 1.5}
    assert board["solved of 4"].to_dict() == {"a": 4, "b": 4}
    assert families(runs) == {"p": "p", "q": "alike", "r": "alike", "s": "alike"}


def test_the_score_of_a_family_is_the_log_of_the_geometric_mean() -> None:
    scores = pd.DataFrame({"a": np.log10([2.0, 8.0, 5.0])}, index=["p", "q", "r"])
    by_family = family_scores(scores, {"p": "one", "q": "one", "r": "r"})
    assert (10 ** by_family["a"]).to_dict() == pytest.approx({"one": 4, "r": 5})


def test_the_share_of_runs_cut_by_seconds_is_shown_where_it_is_known() -> None:
    runs, curves = worked()
    assert "cut by seconds" not in leaderboard(runs, curves)
    runs["cut"] = (runs["optimizer"] == "slow") & (runs["problem"] == "q")
    cut = leaderboard(runs, curves).set_index("method")["cut by seconds"]
    assert cut.to_dict() == {"fast": 0, "slow": 0.5, "absent": 0, "bad": 0}


def test_a_method_beside_the_best_rival_of_each_problem() -> None:
    ert = running_times(hits(*worked()), "evaluations")
    table = best_rivals({"evaluations": ert}, "slow", 1.01).set_index("problem")
    # p: fast needs 10 and slow 1000; q: fast gets there once in 10 and fails once at 2000
    assert table["by evaluations"].tolist() == ["fast", "fast"]
    assert table["evaluations of a rival"].tolist() == [10, 2010]
    assert table["share of evaluations"].tolist() == [100, math.inf]
    alone = ert[ert["optimizer"].isin(["slow", "bad"])]
    table = best_rivals({"evaluations": alone}, "slow", 1.01).set_index("problem")
    assert table["share of evaluations"].to_dict() == {"p": 0, "q": 1}
    assert table["by evaluations"].tolist() == ["none", "none"]
