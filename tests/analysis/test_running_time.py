from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from miho.analysis.compare.running_time import (
    at_factor,
    expected_running_time,
    hits,
    references,
    resampled,
    running_times,
)
from miho.analysis.curves import to_target
from tests.analysis.several_problems import random_runs, several
from tests.analysis.synthetic import SECONDS_PER_EVALUATION


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def worked() -> tuple[pd.DataFrame, pd.DataFrame]:
    """Optimum 10. Three runs of m: at 1.1 after 40 evaluations, after 100, never in 500."""
    return several(
        {"p": {"m": [[(5.0, 15.0), (40.0, 11.0)], [(100.0, 10.0)], [(7.0, 12.0)]]}},
        optimum={"p": 10.0},
        ends={"m": 500.0},
    )


def test_hits_say_when_each_target_is_first_reached_and_what_was_spent() -> None:
    table = hits(*worked(), factors=(1.5, 1.1))
    assert list(table.columns) == [
        "problem", "optimizer", "seed", "factor", "target", "seconds", "cpu_seconds",
        "evaluations", "spent_seconds", "spent_cpu_seconds", "spent_evaluations", "reached",
    ]  # fmt: skip
    loose, tight = at_factor(table, 1.5), at_factor(table, 1.1)
    assert loose["evaluations"].tolist() == [5, 100, 7]
    assert tight["evaluations"].tolist() == [40, 100, np.inf]
    assert tight["reached"].tolist() == [True, True, False]
    assert set(tight["target"]) == {11.0}
    assert set(table["spent_evaluations"]) == {500.0}
    np.testing.assert_allclose(table["seconds"], table["evaluations"] * SECONDS_PER_EVALUATION)


def test_a_run_without_any_value_is_a_cost_without_success() -> None:
    runs, curves = several(
        {"p": {"m": [[(10.0, 10.0)], []]}}, optimum={"p": 10.0}, ends={"m": 300.0}
    )
    table = hits(runs, curves, factors=(1.1,))
    assert table["evaluations"].tolist() == [10, np.inf]
    assert running_times(table, "evaluations")["ert"].item() == 310


def test_expected_running_time_of_the_worked_example() -> None:
    """(40 + 100 + 500) / 2 = 320; the median run needs 100; two of three get there."""
    row = expected_running_time(hits(*worked(), factors=(1.1,)), "evaluations", rng()).iloc[0]
    assert row.drop(["low", "high"]).tolist() == ["p", "m", 1.1, 3, 2 / 3, 320, 100]
    # Of the 27 resamples one has no success: above 2.5 %, so the upper end is inf; the lower end
    # is the smallest value, all three draws of the first run (1 of 27).
    assert (row["low"], row["high"]) == (40, np.inf)


def test_a_method_that_ended_early_is_charged_what_it_spent() -> None:
    runs, curves = several(
        {"p": {"m": [[(10.0, 10.0)], [(3.0, 20.0)]]}},
        optimum={"p": 10.0},
        ends={"m": 50.0},
        outcomes={"m": "converged"},
    )
    assert running_times(hits(runs, curves), "evaluations")["ert"].tolist() == [60.0] * 4


def test_never_reached_is_inf() -> None:
    runs, curves = several({"p": {"m": [[(1.0, 99.0)]] * 3}}, optimum={"p": 10.0})
    row = expected_running_time(hits(runs, curves, (1.1,)), "evaluations", rng()).iloc[0]
    assert row[["ert", "low", "high", "median"]].tolist() == [np.inf] * 4
    assert row["success"] == 0


def test_the_median_is_inf_if_half_of_the_runs_do_not_arrive() -> None:
    steps = [[(10.0, 10.0)], [(20.0, 10.0)], [(1.0, 99.0)], [(1.0, 99.0)]]
    runs, curves = several({"p": {"m": steps}}, optimum={"p": 10.0})
    assert running_times(hits(runs, curves, (1.1,)), "evaluations")["median"].item() == np.inf


def test_resampled_agrees_with_a_plain_loop() -> None:
    table = hits(*random_runs(rng()), factors=(1.1, 1.01))
    names, values = resampled(table, "evaluations", rng(), 20)
    picks = np.vstack([np.arange(4), rng().integers(4, size=(20, 4))])
    for name, row in zip(names.itertuples(index=False), values, strict=True):
        is_it = (table[list(names)].to_numpy(object) == np.array(name, object)).all(axis=1)
        group = table.loc[is_it]
        for pick, value in zip(picks, row, strict=True):
            drawn = group.iloc[pick]
            cost = drawn["evaluations"].where(drawn["reached"], drawn["spent_evaluations"]).sum()
            expected = cost / drawn["reached"].sum() if drawn["reached"].any() else np.inf
            np.testing.assert_allclose(value, expected, rtol=1e-14)


def test_the_interval_of_a_geometric_number_of_restarts_holds_the_truth() -> None:
    """Runs of length 1 with success probability p have an expected running time of 1 / p."""
    experiments, runs, p = 200, 50, 0.4
    random = rng()
    reached = random.random(experiments * runs) < p
    table = pd.DataFrame(
        {
            "problem": np.repeat(np.arange(experiments), runs),
            "optimizer": "m",
            "factor": 1.1,
            "seed": np.tile(np.arange(runs), experiments),
            "evaluations": np.where(reached, 1.0, np.inf),
            "spent_evaluations": 1.0,
            "reached": reached,
        }
    )
    ert = expected_running_time(table, "evaluations", random, 300)
    inside = (ert["low"] <= 1 / p) & (1 / p <= ert["high"])
    # 95 % nominal; three binomial standard deviations of 200 trials are 4.6 %
    assert 0.90 <= inside.mean() < 1


def test_targets_may_differ_by_row() -> None:
    _, curves = random_runs(rng())
    limit = curves["problem"].map({"p0": 20.0, "p1": 11.0, "p2": 10.5}).to_numpy(dtype=float)
    table = to_target(curves, "evaluations", limit)
    for problem, target in [("p0", 20.0), ("p1", 11.0), ("p2", 10.5)]:
        alone = to_target(curves[curves["problem"] == problem], "evaluations", target)
        together = table[table["problem"] == problem].reset_index(drop=True)
        pd.testing.assert_frame_equal(alone, together)


def test_the_reference_is_the_optimum_or_the_best_of_all_runs() -> None:
    steps = {"m": [[(1.0, 12.0)], [(1.0, 11.0)]]}
    runs, _ = several(
        dict.fromkeys(("known", "unknown", "beaten", "rounding"), steps),
        optimum={"known": 10.0, "beaten": 11.5, "rounding": 11.0 * (1 + 1e-12)},
    )
    table = references(runs)
    assert table["error"].to_dict() == {
        "known": 10.0, "unknown": 11.0, "beaten": 11.0, "rounding": 11.0 * (1 + 1e-12)
    }  # fmt: skip
    assert table["source"].to_dict() == {
        "known": "known",
        "unknown": "best of all runs",
        "beaten": "best of all runs",
        "rounding": "known",
    }


def test_what_cannot_be_used_is_named() -> None:
    runs, curves = worked()
    with pytest.raises(ValueError, match=r"factor is 0\.9; expected a finite number of at least 1"):
        hits(runs, curves, factors=(0.9,))
    with pytest.raises(ValueError, match=r"best known error of p is 0\.0; targets need"):
        hits(runs.assign(optimum=0.0), curves)
    with pytest.raises(ValueError, match=r"factor is 1\.2; the frame has 1\.1, 1\.5"):
        at_factor(hits(runs, curves, factors=(1.5, 1.1)), 1.2)
    with pytest.raises(ValueError, match="hits lacks the columns hours, spent_hours"):
        running_times(hits(runs, curves), "hours")  # type: ignore[arg-type]
    mixed = runs.assign(unit=["N", "kN", "N"])
    with pytest.raises(ValueError, match="runs of p have 2 different units"):
        hits(mixed, curves)
    twice = pd.concat([runs, runs.assign(id="other")])
    with pytest.raises(ValueError, match="several runs of m with seed 0"):
        hits(twice, curves)
