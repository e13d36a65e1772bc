from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from miho.analysis.anytime import area_over_curve
from miho.analysis.leaderboard import leaderboard, problem_scores
from miho.analysis.markdown import to_markdown
from miho.analysis.running_time import hits, running_times
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


def test_a_problem_that_nobody_solves_is_ordered_by_area() -> None:
    runs, curves = several(
        {"p": {"near": [[(1.0, 11.0)]], "far": [[(1.0, 30.0)]]}}, optimum={"p": 10.0}
    )
    table = leaderboard(runs, curves)
    assert table["method"].tolist() == ["near", "far"]
    assert table["mean rank"].tolist() == [1, 2]
    assert table["solved of 1"].tolist() == [0, 0]
    assert table["times the best"].isna().all()
