"""Running times and areas against an independent implementation, iohinspector."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from miho.analysis.compare.profiles import area_over_curve
from miho.analysis.compare.running_time import hits, running_times
from tests.analysis.several_problems import random_runs, several

pytestmark = pytest.mark.slow
BUDGET = 1000


def table_of(curves: pd.DataFrame) -> Any:
    """The improvements under iohinspector's names; runs without a value have inf."""
    curves = curves[curves["error"].groupby(curves["id"]).diff() != 0]
    columns = {
        "data_id": pd.factorize(curves["id"])[0],
        "algorithm_name": curves["optimizer"].tolist(),
        "function_name": curves["problem"].tolist(),
        "evaluations": curves["evaluations"].to_numpy(dtype=int),
        "raw_y": curves["error"].fillna(np.inf).to_numpy(dtype=float),
    }
    return pytest.importorskip("polars").DataFrame(columns)


def theirs(table: Any, target: float, problem: str) -> pd.DataFrame:
    """iohinspector's figures for one target, by method; failed runs cost the budget."""
    metrics = pytest.importorskip("iohinspector.metrics")
    of_problem = table.filter(table["function_name"] == problem)
    figures = metrics.aggregate_running_time(
        of_problem, f_min=target, f_max=target, eval_max=BUDGET
    )
    return figures.set_index("algorithm_name")


def test_expected_running_times_are_those_of_iohinspector() -> None:
    runs, curves = random_runs(np.random.default_rng(7), seeds=8)
    table, reached = table_of(curves), hits(runs, curves)
    times = running_times(reached, "evaluations").merge(reached[["problem", "factor", "target"]])
    assert 0 < times["success"].mean() < 1
    for (problem, target), of_target in times.groupby(["problem", "target"]):
        figures = theirs(table, target, problem)
        for _, row in of_target.drop_duplicates("optimizer").iterrows():
            # both are sums of whole numbers over a count
            expected = figures.loc[row["optimizer"]]
            assert expected["ERT"] == pytest.approx(row["ert"], rel=1e-14)
            assert expected["success_ratio"] == pytest.approx(row["success"], rel=1e-14)


def test_runs_without_a_value_count_as_failures() -> None:
    runs, curves = several(
        {"p": {"m": [[], [], [(30.0, 5.0)], []]}}, optimum={"p": 5.0}, ends={"m": float(BUDGET)}
    )
    silent = runs[~runs["id"].isin(curves["id"])].assign(error=np.nan)
    table = table_of(pd.concat([curves, silent[curves.columns]]))
    ert = running_times(hits(runs, curves, (1.1,)), "evaluations")["ert"].item()
    assert theirs(table, 5.5, "p")["ERT"].to_dict() == {"m": ert}


def test_areas_are_those_of_iohinspector() -> None:
    """Runs begin with a gap above 10, so the first evaluation, which it counts, has score 0."""
    metrics = pytest.importorskip("iohinspector.metrics")
    runs, curves = random_runs(np.random.default_rng(7))
    table = table_of(curves.assign(error=curves["error"] / 10 - 1))
    data = metrics.transform_fval(table, lb=1e-3, ub=10.0)
    expected = metrics.get_aocc(data, eval_max=BUDGET)
    expected = expected.set_index(["function_name", "algorithm_name"])
    areas = area_over_curve(runs, curves, BUDGET).groupby(["problem", "optimizer"])["aocc"].mean()
    for key, area in areas.items():
        assert expected.loc[key, "AOCC"] == pytest.approx(area, rel=1e-12)
