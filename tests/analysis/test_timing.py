"""Which clock a figure or claim over time goes by, and what it says of itself."""

import pandas as pd
import pytest

from miho.analysis.timing import clock_of


def runs(*valid: bool | None) -> pd.DataFrame:
    """Two methods with seeds 0, 0, 1, 1, ... on one problem."""
    n = len(valid)
    return pd.DataFrame(
        {
            "problem": "tire",
            "optimizer": ["miho", "pso"] * (n // 2),
            "seed": [i // 2 for i in range(n)],
            "cpu_seconds": 1.0,
            "timing_valid": pd.Series(valid, dtype=object),
        }
    )


def test_valid_runs_are_all_shown_in_wall_seconds() -> None:
    clock = clock_of(runs(True, True, True, True))
    assert (clock.axis, len(clock.runs), clock.note) == ("seconds", 4, "")
    assert clock.advice(["python -m it"]) == ""


def test_methods_stay_paired_where_most_seeds_are_quiet() -> None:
    clock = clock_of(runs(True, True, True, False, True, True))
    assert (clock.axis, clock.unit) == ("seconds", "seconds")
    assert clock.runs["seed"].tolist() == [0, 0, 2, 2]
    assert clock.note == (
        "seconds: other work disturbed 1 of 6 runs; shown are the 4 runs of undisturbed seeds"
    )


@pytest.mark.parametrize(
    "valid", [(False, True), (True, True, True, False), (True, True, None, True)]
)
def test_where_half_of_the_seeds_or_more_are_disturbed_it_is_the_processors(
    valid: tuple[bool | None, ...],
) -> None:
    """All or nothing: of the quiet seeds no wall seconds stand beside CPU seconds."""
    clock = clock_of(runs(*valid))
    assert (clock.axis, clock.unit) == ("cpu_seconds", "CPU seconds")
    assert len(clock.runs) == len(valid)
    again = "sweep.timed=true fresh=true"
    assert clock.advice(["do a", "do b"]).endswith(f"idle: do a {again} && do b {again}")
    assert "fresh" not in clock.advice([])


def test_disturbed_and_unwatched_runs_are_counted_apart() -> None:
    assert clock_of(runs(False, False, None, True)).disturbed == (
        "other work disturbed 2 of 4 runs and nothing watched 1 of 4 runs"
    )


def test_one_disturbed_problem_decides_for_all() -> None:
    table = runs(True, False, True, False)
    quiet = runs(True, True, True, True).assign(problem="torque")
    assert clock_of(quiet).axis == "seconds"
    assert clock_of(pd.concat([table, quiet], ignore_index=True)).axis == "cpu_seconds"


def test_a_table_that_was_not_judged_comes_back_whole() -> None:
    clock = clock_of(runs(True, True).drop(columns="timing_valid"))
    assert (clock.axis, len(clock.runs)) == ("seconds", 2)
    assert "is unknown" in clock.note


def test_no_runs() -> None:
    assert clock_of(runs()).note == ""


@pytest.mark.parametrize("column", ["seed", "cpu_seconds"])
def test_it_names_a_missing_column(column: str) -> None:
    with pytest.raises(ValueError, match=f"runs lacks the columns {column}"):
        clock_of(runs(False, True).drop(columns=column))
