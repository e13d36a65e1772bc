"""The paper's claims under readings of what it leaves open, on curves with known answers."""

import pandas as pd
import pytest

from baselines.arena.readings import (
    Reading,
    frames_of,
    in_seconds,
    long_table,
    reading_claims,
    readings_figure,
    short_table,
    without_slow_descents,
)
from tests.analysis.synthetic import Steps, frames

STORED: dict[str, list[Steps]] = {
    "miho": [[(10.0, 2000.0), (100.0, 900.0), (1000.0, 390.0)]] * 4,
    "gbo_small_si": [[(1.0, 9000.0), (10.0, 8800.0)]] * 4,
    "gbo_large_si": [[(1.0, 9000.0), (600_000.0, 1625.0)]] * 4,
    "pso_100_w1": [[(50.0, 2000.0), (1300.0, 750.0)]] * 4,
    "pso_500_w1": [[(50.0, 2000.0), (1300.0, 513.0)]] * 4,
    "unrelated": [[(1.0, 100.0)]] * 4,
}
PAPER = {
    "miho": "miho",
    "gbo_small": "gbo_small_si",
    "gbo_large": "gbo_large_si",
    "pso_100": "pso_100_w1",
    "pso_500": "pso_500_w1",
}
READING = Reading("w = 1", PAPER)
ENDED = {"gbo_small_si": "converged", "gbo_large_si": "converged"}
COSTS = {
    "interpreted": dict.fromkeys(PAPER, 2e-4) | {"miho": 1e-4},
    "compiled": dict.fromkeys(PAPER, 1e-6),
}


def of_reading() -> tuple[pd.DataFrame, pd.DataFrame]:
    return frames_of(READING, *frames(STORED, outcomes=ENDED), target=400.0)


def test_stored_methods_stand_for_the_papers() -> None:
    runs, curves = of_reading()
    assert set(runs["optimizer"]) == set(curves["optimizer"]) == set(PAPER)
    with pytest.raises(ValueError, match="there are no runs of absent; expected"):
        frames_of(Reading("", {"miho": "absent"}), *frames(STORED), target=0.0)


def test_runs_at_the_target_ended_and_falling_descent_is_cut() -> None:
    runs, _ = of_reading()
    outcomes = runs.groupby("optimizer")["outcome"].unique().map(list).to_dict()
    assert outcomes == {
        "miho": ["converged"],  # at 390 N, below the target
        "gbo_small": ["converged"],  # flat since its tenth evaluation
        "gbo_large": ["budget"],  # fell in the second half of its million evaluations
        "pso_100": ["budget"],
        "pso_500": ["budget"],
    }


@pytest.mark.parametrize(("late", "outcome"), [(1625.0, "converged"), (1200.0, "budget")])
def test_descent_that_could_not_arrive_in_time_bounds_no_speed_up(
    late: float, outcome: str
) -> None:
    """From 2000 N at 50 to 1625 N at 100 evaluations is 1250 N at 150; to 1200 N it is 400 N."""
    falling = [[(1.0, 9000.0), (40.0, 2000.0), (80.0, late)]] * 4
    ends = dict.fromkeys(("gbo_small_si", "gbo_large_si"), 100.0)
    ends |= dict.fromkeys(("miho", "pso_100_w1", "pso_500_w1"), 150.0)
    stored = STORED | {"gbo_large_si": falling}
    runs, curves = frames_of(READING, *frames(stored, ends=ends, outcomes=ENDED), target=0.0)
    settled = without_slow_descents(runs, curves).set_index("optimizer")["outcome"]
    assert set(settled["gbo_large"]) == {outcome}
    assert set(settled["pso_100"]) == {"budget"}
    assert set(runs["outcome"]) == {"budget", "converged"}, "the frame itself is as it was"


def test_seconds_are_evaluations_times_cost() -> None:
    runs, curves = of_reading()
    runs["timing_valid"] = False
    timed = in_seconds(runs, COSTS["interpreted"])
    assert "timing_valid" not in timed
    ratio = (timed["seconds"] / timed["evaluations"]).groupby(timed["optimizer"]).mean()
    assert ratio.to_dict() == pytest.approx(COSTS["interpreted"])
    assert "seconds" in curves


def test_claims_of_each_kind_of_seconds() -> None:
    """To 1.0 kN MIHO needs 100 evaluations, and the swarms 1300."""
    table = reading_claims(*of_reading(), COSTS, resamples=200).set_index("claim")
    assert table.index.is_unique
    claim = "MIHO is faster than GBO and PSO to 1.0 kN, in"
    ours = {kind: table.loc[f"{claim} {kind}", "ours"].partition(" ")[0] for kind in (
        "evaluations", "interpreted seconds", "compiled seconds"
    )}  # fmt: skip
    assert ours == {
        "evaluations": "13×", "interpreted seconds": "26×", "compiled seconds": "13×"
    }  # fmt: skip
    assert table.loc["pso_100 stops at", "verdict"] == "reproduced"


def test_the_short_table_counts_and_marks() -> None:
    claims = {"w = 1": reading_claims(*of_reading(), COSTS, resamples=200)}
    row = short_table(claims).iloc[0]
    assert row["13× to 1.0 kN, evaluations"] == "**13×**"
    ours = row["494× to 0.5 kN, evaluations"]
    assert ours == "**more than 1,000×**", "the swarms were cut at a million evaluations"
    assert row["MIHO ends at 0.39 kN"] == "**0.390 kN**"
    assert row["76 % below GBO-large"] == "*76 %*", "it was cut while its error fell"
    assert row["reproduced of 7"] == "6"
    table = long_table(claims, ["w = 1"])
    assert len(table) == len(claims["w = 1"])
    assert set(table["reading"]) == {"w = 1"}


def test_a_panel_for_each_reading() -> None:
    _, curves = of_reading()
    figure = readings_figure({f"reading {k}": curves for k in range(4)})
    drawn = [ax for ax in figure.axes if ax.get_visible()]
    assert [ax.get_title(loc="left") for ax in drawn] == [f"reading {k}" for k in range(4)]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "MIHO", "GBO-small", "GBO-large", "PSO-100", "PSO-500"
    ]  # fmt: skip
