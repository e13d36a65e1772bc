"""Runs with other settings have other names, and are averaged apart."""

from __future__ import annotations

import pandas as pd

from miho.analysis.curves import on_grid, summary, to_target
from miho.analysis.tidy import comparison, one_problem
from miho.analysis.variants import base_name, named_apart
from tests.analysis.synthetic import frames


def swept() -> tuple[pd.DataFrame, pd.DataFrame]:
    """MIHO with two R on two sizes of the data, one seed each, beside a swarm."""
    runs, curves = frames(
        {"miho": [[(1.0, float(e))] for e in (9, 8, 7, 6)], "pso": [[(1.0, 5.0)]]}
    )
    columns = {
        "optimizer.R": dict(zip(runs["id"], (300, 1000, 300, 1000, None), strict=True)),
        "dataset.n": dict(zip(runs["id"], (500, 500, 3000, 3000, 3000), strict=True)),
        "seed": dict.fromkeys(runs["id"], 0),
    }
    for frame in (runs, curves):
        for name, values in columns.items():
            frame[name] = frame["id"].map(values)
    return runs, curves


def test_data_make_another_problem_and_the_rest_another_method() -> None:
    runs, curves = comparison(*swept())
    assert runs["optimizer"].tolist() == ["miho R=300", "miho R=1000"] * 2 + ["pso"]
    assert runs["problem"].str.rpartition(" ")[2].tolist() == ["n=500"] * 2 + ["n=3000"] * 3
    assert set(curves["optimizer"]) == set(runs["optimizer"])
    assert named_apart(runs).equals(runs), "named once is enough"


def test_of_one_problem_all_settings_are_the_methods() -> None:
    runs, _ = one_problem(*swept())
    assert runs["optimizer"].tolist() == [
        "miho R=300, n=500", "miho R=1000, n=500",
        "miho R=300, n=3000", "miho R=1000, n=3000", "pso",
    ]  # fmt: skip
    assert runs["problem"].nunique() == 1
    assert {base_name(name) for name in runs["optimizer"]} == {"miho", "pso"}


def test_averages_keep_settings_apart() -> None:
    _, curves = swept()
    means = summary(on_grid(curves, "evaluations"), "evaluations")
    last = means.groupby(["optimizer.R", "dataset.n"], dropna=False)["mean"].last()
    assert last.tolist() == [9.0, 7.0, 8.0, 6.0, 5.0]  # R = 300, 1000, none, with rising n
    assert set(means["runs"]) == {1}


def test_curves_on_a_grid_and_targets_carry_the_settings() -> None:
    _, curves = swept()
    for table in (on_grid(curves, "evaluations"), to_target(curves, "evaluations", 7.5)):
        assert {"optimizer.R", "dataset.n"} <= set(table)
        assert table["id"].nunique() == 5


def test_a_bound_in_a_name_has_its_parameter() -> None:
    runs, _ = frames({"miho": [[(1.0, 2.0)]] * 2})
    runs["space.B.high"], runs["space.C.high"] = [1.0, 2.5], [None, "x"]
    assert named_apart(runs)["optimizer"].tolist() == [
        "miho B.high=1, C.high=-", "miho B.high=2.5, C.high=x"
    ]  # fmt: skip
