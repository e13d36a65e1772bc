"""Light curves say what the full ones say: against NumPy's quantiles and `curves.summary`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from miho.analysis.curves import on_grid, summary
from miho.analysis.pages.sweep_curves import (
    QUANTILES,
    Detail,
    final_order,
    overall_order,
    problem_curves,
    quantiles,
    steps,
)
from miho.analysis.timing import clock_of
from tests.analysis.synthetic import frames, like_fig6

DETAIL = Detail(positions=60, seeds=4)


def decoded(text: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """What the page's script makes of a curve, written down a second time."""
    series = pd.Series(text.split(",")).replace("", None).astype(float)
    return series.ffill().to_numpy(dtype=float)


def test_quantiles_are_those_of_numpy_and_know_infinity() -> None:
    rng = np.random.default_rng(0)
    for rows in range(1, 8):
        table = rng.normal(size=(rows, 5))
        np.testing.assert_allclose(
            quantiles(table, QUANTILES), np.quantile(table, QUANTILES, axis=0), rtol=1e-12
        )
    half = np.array([[1.0], [2.0], [np.inf]])
    assert quantiles(half, [0, 0.5, 0.75, 1])[:, 0].tolist() == [1, 2, np.inf, np.inf]
    assert quantiles(np.full((4, 1), np.inf), [0.5])[0, 0] == np.inf


def test_a_curve_is_kept_where_it_changes() -> None:
    text = steps(np.array([np.inf, 5.0, 5.0, 4.0, 4.0, 0.0]))
    assert text == ",5,,4,,0"
    np.testing.assert_array_equal(decoded(text), [np.nan, 5, 5, 4, 4, 0])
    assert steps(np.array([np.inf, np.nan])) == ","


@pytest.mark.parametrize("axis", ["evaluations", "seconds"])
def test_bands_are_those_of_the_other_figures(axis: Any) -> None:
    runs, curves = like_fig6(seeds=5)
    drawn = problem_curves(runs, clock_of(runs), curves, 390.0, DETAIL)
    assert (drawn["unit"], drawn["best"]) == ("kN", 0.39)
    chart = drawn["axes"][axis]
    grid = np.array(chart["grid"])
    assert np.all(np.diff(grid) > 0)
    assert len(grid) <= DETAIL.positions
    assert grid[-1] == curves[axis].max()
    expected = summary(on_grid(curves, axis, grid), axis, (QUANTILES[0], QUANTILES[2]))
    for curve in chart["curves"]:
        of_method = expected[expected["optimizer"] == curve["method"]]
        assert curve["runs"] == 5
        for name in ("median", "low", "high"):
            # ours begin where a quantile is finite, theirs where all runs have a value
            finite = of_method[name].notna().to_numpy()
            np.testing.assert_allclose(
                decoded(curve[name])[finite], of_method[name][finite] / 1000, rtol=5e-5
            )
        assert len(curve["seeds"]) == DETAIL.seeds


def test_the_order_is_that_of_final_medians_and_ties_are_by_name() -> None:
    runs, curves = frames(
        {"b": [[(1, 2.0)]], "a": [[(1, 2.0 + 1e-12)]], "c": [[(1, 1.0)]], "d": [[]]}
    )
    assert final_order(runs) == ["c", "a", "b", "d"]
    drawn = problem_curves(runs, clock_of(runs), curves, 1.0, DETAIL)
    curves_drawn = drawn["axes"]["evaluations"]["curves"]
    assert [curve["method"] for curve in curves_drawn] == ["c", "a", "b", "d"]
    other = runs[runs["optimizer"].isin(["a", "b"])].assign(problem="p", error=[0.5, 0.6])
    assert overall_order(pd.concat([runs, other, other.assign(problem="q")])) == [
        "c",
        "b",
        "a",
        "d",
    ]


def test_runs_without_a_value_count_as_infinitely_bad() -> None:
    runs, curves = frames({"m": [[(1, 9.0), (10, 3.0)], [(5, 2.0)], []]})
    curve = problem_curves(runs, clock_of(runs), curves, float("nan"), DETAIL)["axes"][
        "evaluations"
    ]["curves"][0]
    assert decoded(curve["median"])[-1] == 0.003
    assert not np.isfinite(decoded(curve["high"])).any()
    silent, nothing = frames({"m": [[], []]})
    drawn = problem_curves(
        silent, clock_of(silent), nothing.reindex(columns=curves.columns), 1.0, DETAIL
    )
    assert not np.isfinite(decoded(drawn["axes"]["evaluations"]["curves"][0]["median"])).any()


def test_seconds_are_those_of_the_clock() -> None:
    runs, curves = like_fig6(seeds=3)
    disturbed = runs.assign(timing_valid=False)
    drawn = problem_curves(runs, clock_of(disturbed), curves, float("nan"), DETAIL)
    assert drawn["best"] is None
    assert drawn["axes"]["seconds"]["grid"][-1] == curves["cpu_seconds"].max()
    once = runs.assign(timing_valid=runs["seed"] != 1)
    some = problem_curves(runs, clock_of(once), curves, float("nan"), DETAIL)["axes"]
    assert some["seconds"]["grid"][-1] == curves["seconds"].max()
    assert {curve["runs"] for curve in some["seconds"]["curves"]} == {2}
    assert {curve["runs"] for curve in some["evaluations"]["curves"]} == {3}


def test_many_curves_are_kept_with_less_detail() -> None:
    assert Detail.fitting(8) == Detail(180, 30)
    assert Detail.fitting(1008).seeds == 2
    assert Detail.fitting(10**6).positions == 40
