"""The tables of a sweep, against numbers worked out by hand, and its warnings."""

from __future__ import annotations

import numpy as np
import pandas as pd

from miho.analysis.pages.sweep_tables import (
    final_errors,
    methods_table,
    problems_table,
    seeds_text,
    warnings,
)
from miho.analysis.text import significant
from tests.analysis.sweep_synthetic import origin, sweep_of
from tests.analysis.synthetic import frames, like_fig6


def test_final_errors_by_hand() -> None:
    errors = [4000.0, 1000.0, 3000.0, 2000.0, 5000.0]
    runs, _ = frames({"late": [[(1, error)] for error in errors], "one": [[(1, 123456.7)]],
                      "half": [[(1, 10.0)], [], []]})  # fmt: skip
    table = final_errors(runs).set_index("method")
    assert table.index.tolist() == ["late", "one", "half"]
    late = table.loc["late"]
    assert late["median error [kN]"] == "3"
    assert (late["best [kN]"], late["worst [kN]"]) == ("1", "5")
    # the median of five draws from five is the smallest or the largest in 5.8 % of the resamples
    assert late["95 % interval"] == "[1, 5]"
    assert (late["runs"], late["evaluations"], late["seconds"]) == (5, "1,000,000", "100")
    assert late["ended by"] == "budget 5"
    assert table.loc["one", "95 % interval"] == "-"
    assert table.loc["half", "median error [kN]"] == "∞"
    assert table.loc["half", "best [kN]"] == "0.01"


def test_a_median_has_the_interval_of_its_resamples() -> None:
    rng = np.random.default_rng(3)
    errors = np.sort(rng.lognormal(8, 0.5, 101))
    runs, _ = frames({"m": [[(1, float(error))] for error in errors]})
    row = final_errors(runs).iloc[0]
    low, high = (float(end) for end in row["95 % interval"].strip("[]").split(","))
    # order statistics 41 and 61 of 101 hold the median with 95.4 % (binomial); the bootstrap ends
    # within three places of them
    assert errors[37] <= low * 1000 <= errors[43]
    assert errors[57] <= high * 1000 <= errors[63]


def test_numbers() -> None:
    assert significant(50111.93) == "50,112"
    assert significant(0.00012345678) == "0.00012346"
    assert significant(2.5e12) == "2.5e+12"
    assert significant(np.inf) == "∞"
    assert seeds_text(pd.Series([2, 0, 1, 1])) == "0 to 2"
    assert seeds_text(pd.Series([4, 0, 1])) == "0, 1, 4"


def test_what_is_behind_the_names() -> None:
    sweep = sweep_of(*like_fig6(seeds=3))
    (problem,) = problems_table(sweep).to_dict("records")
    assert (problem["model"], problem["dataset"]) == ("Pacejka", "sample_tir")
    assert (problem["runs"], problem["data digest"]) == (24, "da7ada7ada7a")
    methods = methods_table(sweep).set_index("method")
    assert methods.loc["MIHO"].tolist() == [3, "0 to 2", "c0dec0dec0de"]


def test_nothing_to_warn_of_but_unwatched_seconds() -> None:
    runs, curves = like_fig6(seeds=5)
    assert warnings(sweep_of(runs, curves)) == ["Seconds: other work on the machine is unknown."]
    assert warnings(sweep_of(runs.assign(timing_valid=True), curves)) == []


def test_every_doubt_is_told() -> None:
    runs, curves = frames({"a": [[(1, 2.0)], [(1, 3.0)]], "b": [[]]}, outcomes={"b": "failed"})
    runs["timing_valid"] = [True, False, True]
    others = {
        "a-0": origin(processor="Other", load=[3.5, 0, 0]),
        "a-1": origin(packages={"numpy": "1"}, threads=[2]),
    }
    text = " ".join(warnings(sweep_of(runs, curves, **others)))
    for words in (
        "b has 1 of 2 on pacejka-tire_lf",
        "No method has more than 2 runs",
        "1 of 3 runs found no finite value",
        "1 of 3 runs ended because the method failed",
        "2 different machines",
        "2 different versions of Python",
        "2 different numbers of threads",
        "1 of 3 runs were made with more processes waiting",
        "CPU seconds: other work disturbed 1 of 3 runs",
    ):
        assert words in text, words
