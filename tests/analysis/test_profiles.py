from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from miho.analysis.compare.profiles import data_profile, ecdf, performance_profile
from miho.analysis.compare.running_time import hits, running_times
from tests.analysis.several_problems import random_runs


def table() -> pd.DataFrame:
    """Two problems, two seeds, one factor: a needs 10, 20, 30 and fails once; b needs 60 once."""
    a, b = [10.0, 20.0, 30.0, np.inf], [np.inf, 60.0, np.inf, np.inf]
    return pd.DataFrame(
        {
            "problem": ["p", "p", "q", "q"] * 2,
            "optimizer": ["a"] * 4 + ["b"] * 4,
            "seed": [0, 1] * 4,
            "factor": 1.01,
            "evaluations": a + b,
        }
    )


def shares(frame: pd.DataFrame, optimizer: str) -> list[float]:
    return [float(share) for share in frame[frame["optimizer"] == optimizer]["share"]]


def test_the_runtime_distribution_counts_all_runs_and_targets() -> None:
    frame = ecdf(table(), "evaluations", np.array([9.0, 10.0, 25.0, 30.0, 1000.0]))
    assert list(frame.columns) == ["optimizer", "evaluations", "share"]
    assert shares(frame, "a") == [0, 0.25, 0.5, 0.75, 0.75]
    assert shares(frame, "b") == [0, 0, 0, 0, 0.25]


def test_the_data_profile_counts_simplex_gradients() -> None:
    """d + 1 = 2 for p, 6 for q: a needs kappa of 5, 10 and 5."""
    frame = data_profile(table(), {"p": 1, "q": 5}, 1.01, np.array([4.9, 5.0, 10.0]))
    assert list(frame.columns) == ["optimizer", "kappa", "share"]
    assert shares(frame, "a") == [0, 0.5, 0.75]


def test_the_performance_profile_counts_problems_within_tau_of_the_best() -> None:
    """Ratios: a 1 and 3 and unsolved; b 2 and 1 and unsolved; nobody solves the third."""
    ert = pd.DataFrame(
        {
            "problem": ["p", "q", "r"] * 2,
            "optimizer": ["a"] * 3 + ["b"] * 3,
            "factor": 1.01,
            "ert": [10.0, 90.0, np.inf, 20.0, 30.0, np.inf],
        }
    )
    frame = performance_profile(ert, 1.01, np.array([1.0, 2.0, 3.0, 1e9]))
    assert list(frame.columns) == ["optimizer", "tau", "share"]
    assert shares(frame, "a") == pytest.approx([1 / 3, 1 / 3, 2 / 3, 2 / 3])
    assert shares(frame, "b") == pytest.approx([1 / 3, 2 / 3, 2 / 3, 2 / 3])


def test_shares_rise_from_the_first_success_to_the_success_rate() -> None:
    reached = hits(*random_runs(np.random.default_rng(2)))
    frame = ecdf(reached, "seconds")
    for optimizer, of_method in frame.groupby("optimizer"):
        assert of_method["share"].is_monotonic_increasing
        mean = reached[reached["optimizer"] == optimizer]["reached"].mean()
        assert of_method["share"].iloc[-1] == pytest.approx(mean)
    assert frame["share"].iloc[0] < frame["share"].iloc[-1]


def test_default_grids_begin_at_the_first_step() -> None:
    reached = hits(*random_runs(np.random.default_rng(2)))
    ert = running_times(reached, "evaluations")
    first = performance_profile(ert, 1.5).groupby("optimizer")[["tau", "share"]].first()
    assert set(first["tau"]) == {1.0}
    assert first["share"].sum() >= 1


def test_nothing_solved_is_a_share_of_zero() -> None:
    reached = table().assign(evaluations=np.inf)
    assert set(ecdf(reached, "evaluations")["share"]) == {0.0}


def test_a_problem_without_dimension_is_named() -> None:
    with pytest.raises(ValueError, match="dimensions lack the problem q"):
        data_profile(table(), {"p": 1}, 1.01)
