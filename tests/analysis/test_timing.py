"""Which runs a figure over seconds may show."""

import pandas as pd
import pytest

from miho.analysis.timing import valid_seconds


def runs(*valid: bool | None) -> pd.DataFrame:
    """Two methods with seeds 0, 0, 1, 1, ... on one problem."""
    n = len(valid)
    return pd.DataFrame(
        {
            "problem": "tire",
            "optimizer": ["miho", "pso"] * (n // 2),
            "seed": [i // 2 for i in range(n)],
            "timing_valid": pd.Series(valid, dtype=object),
        }
    )


def test_valid_runs_are_all_shown() -> None:
    found, note = valid_seconds(runs(True, True, True, True))
    assert (len(found), note) == (4, "")


def test_methods_stay_paired() -> None:
    found, note = valid_seconds(runs(True, True, True, False, None, True))
    assert found["seed"].tolist() == [0, 0]
    assert note == (
        "seconds: 1 of 6 runs were disturbed by other work and 1 of 6 were not watched; "
        "shown are the 2 runs of undisturbed seeds"
    )


def test_seeds_of_other_problems_stay() -> None:
    table = runs(True, True, True, False)
    other = runs(True, True, True, True).assign(problem="torque")
    found, _ = valid_seconds(pd.concat([table, other], ignore_index=True))
    assert found.groupby("problem").size().to_dict() == {"tire": 2, "torque": 4}


def test_where_nothing_is_valid_it_says_so() -> None:
    found, note = valid_seconds(runs(False, True))
    assert found.empty
    assert note.startswith("no seconds are shown: 1 of 2 runs were disturbed")


def test_a_table_that_was_not_judged_comes_back_whole() -> None:
    found, note = valid_seconds(runs(True, True).drop(columns="timing_valid"))
    assert len(found) == 2
    assert "nothing is known" in note


def test_no_runs() -> None:
    assert valid_seconds(runs())[1] == ""


def test_it_names_a_missing_column() -> None:
    with pytest.raises(ValueError, match="runs lacks the columns seed"):
        valid_seconds(runs(True, True).drop(columns="seed"))
