from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from miho.analysis.curves import log_grid, on_grid, step, summary, to_target
from miho.analysis.tidy import one_problem, shown_unit
from tests.analysis.synthetic import SECONDS_PER_EVALUATION, frames, like_fig6

TWO_RUNS = {"miho": [[(10.0, 900.0), (100.0, 400.0)], [(20.0, 700.0), (50.0, 600.0)]]}


def test_step_carries_the_last_value_forward_and_never_interpolates() -> None:
    grid = np.array([1.0, 10, 99.999, 100, 1e9])
    values = step(np.array([10.0, 100.0]), np.array([9.0, 4.0]), grid)
    np.testing.assert_array_equal(values, [np.nan, 9, 9, 4, 4])


def test_step_of_rows_at_one_position_takes_the_last() -> None:
    at = np.array([10.0, 10.0, 20.0])
    assert step(at, np.array([9.0, 8.0, 1.0]), np.array([10.0])) == 8


def test_on_grid_gives_each_run_its_own_values() -> None:
    _, curves = frames(TWO_RUNS)
    gridded = on_grid(curves, "evaluations", np.array([5.0, 20, 100]))
    wide = gridded.pivot(index="seed", columns="evaluations", values="error")
    np.testing.assert_array_equal(wide, [[np.nan, 900, 400], [np.nan, 700, 600]])


def test_a_finished_run_keeps_its_answer() -> None:
    _, curves = frames(TWO_RUNS, ends={"miho": 200.0})
    gridded = on_grid(curves, "evaluations", np.array([1e5]))
    assert sorted(gridded["error"]) == [400, 600]


def test_mean_and_quantiles_exist_only_where_all_runs_have_a_value() -> None:
    _, curves = frames(TWO_RUNS)
    means = summary(on_grid(curves, "evaluations", np.array([15.0, 20, 100])), "evaluations")
    np.testing.assert_array_equal(means["mean"], [np.nan, 800, 500])
    np.testing.assert_array_equal(means["median"], [np.nan, 800, 500])
    np.testing.assert_allclose(means["low"], [np.nan, 720, 420])
    np.testing.assert_allclose(means["high"], [np.nan, 880, 580])
    assert set(means["runs"]) == {2}


def test_a_run_without_a_value_leaves_the_mean_undefined() -> None:
    _, curves = one_problem(*frames({"miho": [[(10.0, 900.0)], []]}))
    means = summary(on_grid(curves, "evaluations", np.array([10.0, 1e6])), "evaluations")
    assert means["mean"].isna().all()
    assert set(means["runs"]) == {2}


def test_time_to_target_is_the_first_row_at_or_below_it() -> None:
    _, curves = frames(TWO_RUNS)
    assert list(to_target(curves, "evaluations", 700.0)["evaluations"]) == [100, 20]
    assert list(to_target(curves, "evaluations", 500.0)["evaluations"]) == [100, np.inf]
    seconds = to_target(curves, "seconds", 700.0)["seconds"]
    np.testing.assert_allclose(seconds, np.array([100, 20]) * SECONDS_PER_EVALUATION)


def test_the_grid_is_even_in_the_logarithm_and_ends_at_the_last_row() -> None:
    _, curves = frames(TWO_RUNS, ends={"miho": 1000.0})
    grid = log_grid(curves, "evaluations", points=5)
    assert (grid[0], grid[-1]) == (10, 1000)
    np.testing.assert_allclose(np.diff(np.log10(grid)), 0.5)


def test_curves_of_unknown_axis_or_without_columns_are_refused() -> None:
    _, curves = frames(TWO_RUNS)
    with pytest.raises(ValueError, match="axis is 'hours'; expected one of seconds"):
        on_grid(curves, "hours")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="curves lacks the columns error"):
        to_target(curves.drop(columns="error"), "seconds", 1.0)
    with pytest.raises(ValueError, match="nothing to draw"):
        log_grid(curves.assign(seconds=0.0), "seconds")


def test_one_problem_completes_the_curves_with_silent_runs() -> None:
    _, curves = one_problem(*frames({"miho": [[(10.0, 900.0)], []], "random": [[(1.0, 5.0)]]}))
    silent = curves[curves["id"] == "miho-1"]
    assert len(silent) == 1
    assert silent["error"].isna().all()
    assert silent["evaluations"].item() == 1e6


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda r, c: (r.drop(columns="unit"), c), "runs lacks the columns unit"),
        (lambda r, c: (r.assign(problem=["a", "b"]), c), "2 different values of problem"),
        (lambda r, c: (r.assign(seed=0), c), "several runs of miho with seed 0"),
        (lambda r, c: (r.iloc[:1], c), "1 runs that are not in runs, for example miho-1"),
        (lambda r, c: (r, c.assign(error=c["evaluations"])), "the error of run miho-0 rises"),
    ],
)
def test_frames_that_are_not_one_comparison_are_refused(spoil, sentence) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=sentence):
        one_problem(*spoil(*frames(TWO_RUNS)))


def test_inputs_are_left_alone() -> None:
    runs, curves = like_fig6(2)
    copies = runs.copy(), curves.copy()
    one_problem(runs, curves)
    on_grid(curves, "seconds")
    pd.testing.assert_frame_equal(runs, copies[0])
    pd.testing.assert_frame_equal(curves, copies[1])


def test_forces_are_shown_in_kn_and_nothing_else_is() -> None:
    assert shown_unit("N") == ("kN", 1e-3)
    assert shown_unit("N m") == ("N m", 1.0)
