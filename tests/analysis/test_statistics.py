from __future__ import annotations

import numpy as np
import pytest

from miho.analysis.compare.bootstrap import (
    Interval,
    MeanCurve,
    improvement,
    interval,
    mean_error,
    ratio_of_means,
    resample,
    speed_up,
)
from miho.analysis.tidy import one_problem
from tests.analysis.synthetic import Steps, frames


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def mean_curve(repetitions: list[Steps], end: float = 1000.0, outcome: str = "budget") -> MeanCurve:
    runs, curves = one_problem(
        *frames({"m": repetitions}, ends={"m": end}, outcomes={"m": outcome})
    )
    return MeanCurve.of(runs, curves, "m", "evaluations", range(len(repetitions)))


def time_to_target(curve: MeanCurve, target: float) -> Interval:
    """First position where the mean curve is at most `target`, with its bootstrap interval."""
    return interval(*curve.reaches(target, resample(len(curve.errors), rng())))


def test_the_mean_reaches_the_target_where_the_last_needed_run_improves() -> None:
    curve = mean_curve([[(10.0, 900.0), (100.0, 400.0)], [(20.0, 700.0), (50.0, 600.0)]])
    for target, expected in [(800.0, 20.0), (750.0, 50.0), (749.0, 100.0), (500.0, 100.0)]:
        assert time_to_target(curve, target).estimate == expected


def test_the_search_agrees_with_averaging_on_every_breakpoint() -> None:
    random = np.random.default_rng(3)
    runs: list[Steps] = []
    for _ in range(6):
        at = np.sort(random.uniform(1, 900, 40))
        error = np.sort(random.lognormal(6, 1, 40))[::-1]
        runs.append([(float(a), float(e)) for a, e in zip(at, error, strict=True)])
    curve, picks = mean_curve(runs), resample(6, random, 50)
    means = curve.errors[picks].mean(axis=1)
    for target in (50.0, 300.0, 1000.0):
        below = means <= target
        expected = np.where(below.any(axis=1), curve.at[below.argmax(axis=1)], np.inf)
        np.testing.assert_array_equal(curve.reaches(target, picks)[1], expected)


def test_what_was_cut_is_known_within_bounds_and_what_ended_is_known() -> None:
    cut = time_to_target(mean_curve([[(10.0, 900.0)]] * 3), 500.0)
    assert (cut.estimate, cut.at_most, cut.low, cut.high) == (1000, np.inf, 1000, np.inf)
    assert cut.censored == 1
    ended = time_to_target(mean_curve([[(10.0, 900.0)]] * 3, outcome="converged"), 500.0)
    assert (ended.estimate, ended.at_most, ended.censored) == (np.inf, np.inf, 0)


def test_the_mean_is_known_up_to_the_earliest_end_of_a_cut_run() -> None:
    curve = MeanCurve(
        at=np.array([1.0]),
        errors=np.full((3, 1), 900.0),
        ends=np.array([50.0, 200.0, 300.0]),
        cut=np.array([False, True, True]),
    )
    low, high = curve.reaches(500.0, np.array([[0, 1, 2], [2, 2, 2], [0, 0, 0]]))
    np.testing.assert_array_equal(low, [200, 300, np.inf])
    np.testing.assert_array_equal(high, np.inf)


def test_a_mean_that_arrives_after_a_run_was_cut_is_known_within_bounds() -> None:
    """Run 0 was cut at 5 with a bad error; run 1 pulled the mean down at 8."""
    curve = MeanCurve(
        at=np.array([1.0, 8.0]),
        errors=np.array([[1500.0, 1500.0], [1500.0, 300.0]]),
        ends=np.array([5.0, 10.0]),
        cut=np.array([True, True]),
    )
    low, high = curve.reaches(1000.0, np.array([[0, 1], [1, 1]]))
    assert low.tolist() == [5, 8]
    assert high.tolist() == [8, 8]


def test_a_run_without_a_value_keeps_the_mean_from_any_target() -> None:
    assert time_to_target(mean_curve([[(10.0, 1.0)], []]), 500.0).at_most == np.inf


def test_speed_up_of_identical_runs_is_exact() -> None:
    method = mean_curve([[(10.0, 400.0)]] * 4)
    rivals = [mean_curve([[(300.0, 400.0)]] * 4), mean_curve([[(200.0, 400.0)]] * 4)]
    assert speed_up(method, rivals, 500.0, rng()) == Interval(20, 20, 20, 20)


def test_speed_up_is_paired_by_repetition() -> None:
    base = [10.0, 20.0, 40.0, 80.0]
    method = mean_curve([[(at, 400.0)] for at in base])
    rival = mean_curve([[(3 * at, 400.0)] for at in base])
    ratio = speed_up(method, [rival], 500.0, rng())
    assert (ratio.low, ratio.estimate, ratio.high) == (3, 3, 3)


def test_a_rival_that_never_arrives_gives_a_lower_bound() -> None:
    method, rival = mean_curve([[(10.0, 400.0)]] * 3), mean_curve([[(1.0, 900.0)]] * 3)
    assert speed_up(method, [rival], 500.0, rng()) == Interval(100, 100, np.inf, np.inf, 1.0)


def test_a_rival_that_ended_above_the_target_is_infinitely_slower() -> None:
    method = mean_curve([[(10.0, 400.0)]] * 3)
    rival = mean_curve([[(1.0, 900.0)]] * 3, outcome="converged")
    assert speed_up(method, [rival], 500.0, rng()).low == np.inf


def test_a_rival_cut_early_bounds_from_below_what_another_bounds_from_above() -> None:
    method = mean_curve([[(10.0, 400.0)]] * 3)
    early = mean_curve([[(1.0, 900.0)]] * 3, end=50.0)
    late = mean_curve([[(300.0, 400.0)]] * 3)
    ratio = speed_up(method, [early, late], 500.0, rng())
    assert (ratio.estimate, ratio.at_most) == (5, 30)


@pytest.mark.parametrize(
    ("outcome", "high"), [("budget", 0.2), ("converged", 0.0), ("brackets", 0.0)]
)
def test_not_arriving_oneself_gives_zero(outcome: str, high: float) -> None:
    method = mean_curve([[(10.0, 900.0)]] * 3, outcome=outcome)
    rival = mean_curve([[(200.0, 400.0)]] * 3)
    ratio = speed_up(method, [rival], 500.0, rng())
    assert (ratio.estimate, ratio.low, ratio.high) == (0, 0, high)


def test_nobody_arriving_is_no_evidence() -> None:
    curve = mean_curve([[(10.0, 900.0)]] * 3)
    ratio = speed_up(curve, [curve], 500.0, rng())
    assert (ratio.estimate, ratio.at_most, ratio.censored) == (0, np.inf, 1)


def test_methods_with_different_repetitions_cannot_be_paired() -> None:
    with pytest.raises(ValueError, match="same seeds of each"):
        speed_up(mean_curve([[(1.0, 1.0)]]), [mean_curve([[(1.0, 1.0)]] * 2)], 1.0, rng())
    with pytest.raises(ValueError, match="at least one rival"):
        speed_up(mean_curve([[(1.0, 1.0)]]), [], 1.0, rng())
    with pytest.raises(ValueError, match="no repetition"):
        resample(0, rng())


def test_improvement_is_the_papers_percentage() -> None:
    method, rival = np.array([0.39, 0.39]), np.array([0.51, 0.51])
    gain = improvement(method, rival, rng())
    assert gain.estimate == pytest.approx(1 - 0.39 / 0.51)
    assert gain.low == gain.high == pytest.approx(gain.estimate)


def test_errors_without_a_finite_value_count_as_infinite() -> None:
    assert mean_error(np.array([1.0, np.inf]), rng()).estimate == np.inf
    assert ratio_of_means(np.array([1.0]), np.array([np.inf]), rng()).estimate == 0
    assert ratio_of_means(np.array([np.inf]), np.array([np.inf]), rng()).estimate == 1


def test_the_interval_covers_the_mean_about_as_often_as_it_says() -> None:
    random = np.random.default_rng(5)
    hits = 0
    for _ in range(300):
        mean = mean_error(random.normal(10, 2, 40), random, resamples=400)
        hits += mean.low <= 10 <= mean.high
    assert 0.90 <= hits / 300 <= 0.98


def test_the_interval_has_the_width_of_the_normal_approximation() -> None:
    values = np.random.default_rng(2).normal(10, 2, 200)
    mean = mean_error(values, rng(), resamples=8000)
    standard_error = values.std() / np.sqrt(200)
    assert mean.estimate == values.mean()
    assert mean.high - mean.low == pytest.approx(2 * 1.96 * standard_error, rel=0.06)


def test_the_same_generator_state_gives_the_same_interval() -> None:
    values = np.array([1.0, 2.0, 5.0])
    assert mean_error(values, rng()) == mean_error(values, rng())


def test_percentiles_are_observed_values_and_row_zero_is_the_estimate() -> None:
    values = np.concatenate([[7.0], np.arange(1, 101)])
    assert interval(values, values) == Interval(7, 3, 98, 7)


@pytest.mark.parametrize(
    ("steps", "outcome", "falling"),
    [
        ([(10.0, 900.0), (600.0, 400.0)], "budget", True),
        ([(10.0, 900.0), (600.0, 400.0)], "converged", False),
        ([(10.0, 900.0), (400.0, 400.0)], "budget", False),
        ([(600.0, 400.0)], "budget", True),
    ],
)
def test_still_falling_looks_at_the_second_half_of_cut_runs(
    steps: Steps, outcome: str, falling: bool
) -> None:
    assert mean_curve([steps] * 3, outcome=outcome).still_falling() is falling
