from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from miho.analysis.compare.bootstrap import Interval
from miho.analysis.compare.claims import claims_table
from miho.analysis.compare.leaderboard import results_table
from miho.analysis.compare.size import PAPER as FULL
from miho.analysis.text import number, to_markdown, with_interval
from tests.analysis.synthetic import Steps, frames, like_fig6

PAPER: dict[str, list[Steps]] = {
    "miho": [[(10.0, 2000.0), (100.0, 900.0), (1000.0, 390.0)]] * 5,
    "gbo_small": [[(1.0, 9000.0), (10.0, 8800.0)]] * 5,
    "gbo_large": [[(1.0, 9000.0), (10.0, 1625.0)]] * 5,
    "pso_100": [[(50.0, 2000.0), (1300.0, 750.0)]] * 5,
    "pso_500": [[(50.0, 2000.0), (9000.0, 513.0)]] * 5,
}
SPEED_1, SPEED_05 = "faster than GBO and PSO to 1.0 kN", "faster than GBO and PSO to 0.5 kN"
HARDLY = "gbo_small hardly moves"


def claims(runs: dict[str, list[Steps]], **options: Any) -> pd.DataFrame:
    return claims_table(*frames(runs, **options), settings=FULL, resamples=300)


def verdicts(table: pd.DataFrame, words: str) -> list[str]:
    return list(table.loc[table["claim"].str.contains(words, regex=False), "verdict"])


def row(table: pd.DataFrame, words: str) -> pd.Series[Any]:
    return table[table["claim"].str.contains(words, regex=False)].iloc[0]


def spread_of(final: list[float], at: float = 10.0) -> list[Steps]:
    return [[(at, 9000.0), (at + 1, error)] for error in final]


def test_the_papers_own_figures_reproduce_the_paper() -> None:
    runs = PAPER | {"pso_500": [[(50.0, 2000.0), (494_000.0, 495.0), (495_000.0, 490.0)]] * 5}
    table = claims(runs)
    assert verdicts(table, SPEED_1) == ["reproduced"] * 2
    assert verdicts(table, SPEED_05) == ["reproduced"] * 2
    assert row(table, SPEED_1)["ours"] == "13× [13, 13]"
    table = claims(PAPER)
    for words in ("terminal", "below pso_500", "below gbo_large", "pso_100 stops", HARDLY):
        assert verdicts(table, words) == ["reproduced"], words


def test_a_larger_speed_up_is_reproduced_and_a_smaller_one_is_not() -> None:
    assert verdicts(claims(PAPER | {"pso_100": [[(9000.0, 750.0)]] * 5}), SPEED_1) == [
        "reproduced",
        "reproduced",
    ]
    table = claims(PAPER | {"pso_100": [[(150.0, 750.0)]] * 5})
    assert verdicts(table, SPEED_1) == ["not reproduced"] * 2
    assert row(table, SPEED_1)["ours"] == "1.50× [1.50, 1.50]"


def test_a_speed_up_that_cut_runs_leave_open_depends_on_the_budget() -> None:
    table = claims(PAPER, ends={"pso_500": 1e5})
    assert verdicts(table, SPEED_05) == ["depends on the budget"] * 2
    assert row(table, SPEED_05)["ours"] == "more than 100× [100, ∞]"


def test_a_lower_bound_above_the_figure_is_enough() -> None:
    assert verdicts(claims(PAPER), SPEED_05) == ["reproduced"] * 2


def test_rivals_that_ended_by_themselves_are_never_going_to_arrive() -> None:
    rivals = {method: "converged" for method in PAPER if method != "miho"}
    ends = dict.fromkeys(rivals, 1e5)
    assert verdicts(claims(PAPER, ends=ends, outcomes=rivals), SPEED_05) == ["reproduced"] * 2


def test_miho_not_reaching_the_target_is_said() -> None:
    short = [[(10.0, 2000.0), (100.0, 900.0)]] * 5
    rivals = {"pso_500": [[(2000.0, 400.0)]] * 5}
    table = claims(PAPER | {"miho": short} | rivals, outcomes={"miho": "converged"})
    assert verdicts(table, SPEED_05) == ["not reproduced"] * 2
    assert row(table, SPEED_05)["ours"].startswith("0×, MIHO did not reach it")
    nobody = claims(PAPER | {"miho": short})
    assert verdicts(nobody, SPEED_05) == ["depends on the budget"] * 2


def test_a_speed_claim_that_holds_on_one_axis_only_depends_on_the_axis() -> None:
    runs, curves = frames(PAPER)
    curves_of_miho, runs_of_miho = curves["optimizer"] == "miho", runs["optimizer"] == "miho"
    curves.loc[curves_of_miho, "seconds"] *= 10
    runs.loc[runs_of_miho, "seconds"] *= 10
    table = claims_table(runs, curves, settings=FULL, resamples=100)
    assert verdicts(table, SPEED_1) == ["depends on the axis"] * 2
    assert row(table, SPEED_1)["reason"] == "not reproduced in seconds, reproduced in evaluations"


def test_disturbed_runs_are_compared_in_cpu_seconds() -> None:
    """CPU seconds here are 0.9 of the wall's for all, so the ratio is that of evaluations."""
    runs, curves = frames(PAPER)
    curves["seconds"] *= np.where(curves["optimizer"] == "miho", 10, 1)
    table = claims_table(runs.assign(timing_valid=False), curves, settings=FULL, resamples=100)
    assert row(table, SPEED_1 + ", in CPU seconds")["ours"] == "13× [13, 13]"
    assert not table["claim"].str.contains("in seconds").any()
    assert not table["reason"].str.contains("no runs to compare with").any()
    results = results_table(runs.assign(timing_valid=False), curves).set_index("method")
    assert results.loc["miho", "CPU seconds to 1 kN"] == pytest.approx(0.009)
    assert "seconds to 1 kN" not in results


def test_runs_of_another_size_judge_no_claim_about_it() -> None:
    """What is said of MIHO at R = 10,000 is left open at R = 300, in every direction."""
    settings = FULL | {"miho": FULL["miho"] | {"optimizer.R": 300}}
    runs = PAPER | {"pso_100": [[(150.0, 750.0)]] * 5, "pso_500": spread_of([391.0] * 5)}
    table = claims_table(*frames(runs), settings=settings, resamples=100)
    about_miho = table[table["claim"].str.contains("miho|MIHO")]
    assert len(about_miho) == 8
    assert set(about_miho["verdict"]) == {"not judged: R = 300, the claim is for R = 10,000"}
    for words in ("pso_100 stops", "than pso_100", HARDLY):  # these are not about MIHO
        assert not verdicts(table, words)[0].startswith("not judged"), words


@pytest.mark.parametrize(
    ("method", "path", "value", "expected"),
    [
        ("miho", "optimizer.eta", 3, "eta = 3, the claim is for eta = 5"),
        ("miho", "optimizer.annealing", "exponential", "annealing = exponential, the claim is for "
         "annealing = linear"),
        ("pso_100", "dataset.n", 500, "rows = 500, the claim is for rows = 3,000"),
        ("pso_100", "optimizer.particles", 10, "particles = 10, the claim is for particles = 100"),
        ("gbo_small", "dimension", 4, "parameters = 4, the claim is for parameters = 5"),
        ("gbo_small", "optimizer.learning_rate", 1e-9, "learning_rate = 1e-09, the claim is for "
         "learning_rate = 5e-12"),
    ],
)  # fmt: skip
def test_a_verdict_names_the_setting_that_differs(
    method: str, path: str, value: object, expected: str
) -> None:
    settings = FULL | {method: FULL[method] | {path: value}}
    table = claims_table(*frames(PAPER), settings=settings, resamples=100)
    words = {"miho": "terminal", "pso_100": "pso_100 stops", "gbo_small": HARDLY}[method]
    assert verdicts(table, words) == [f"not judged: {expected}"]


def test_runs_of_which_nothing_is_known_judge_no_claim() -> None:
    table = claims_table(*frames(PAPER), resamples=100)
    assert set(table["verdict"]) == {"not judged: the settings of these runs are not known"}


def test_of_several_settings_the_papers_own_are_judged() -> None:
    runs, curves = frames(PAPER | {"miho R=300": spread_of([700.0] * 5)})
    kept = runs["optimizer"].replace("miho R=300", "miho")
    R = runs["optimizer"].map({"miho": 10_000.0, "miho R=300": 300.0})
    columns = {"optimizer": kept, "optimizer.R": R}
    settings = FULL | {"miho R=10000": FULL["miho"], "miho R=300": {"optimizer.R": 300}}
    table = claims_table(runs.assign(**columns), curves, settings=settings, resamples=100)
    assert row(table, "terminal")["ours"] == "0.390 kN [0.390, 0.390]"
    assert row(table, "terminal")["repetitions"] == 5


def test_the_sentences_about_gradient_descent() -> None:
    """A descent is stable where its error falls until the end, and else waits."""
    falls: list[Steps] = [[(at, 9000.0 - at / 300) for at in np.geomspace(1, 1e6, 900)]] * 5
    waits: list[Steps] = [[(1.0, 9000.0), (10.0, 1625.0)]] * 5
    table = claims(PAPER | {"gbo_small": falls, "gbo_large": waits})
    assert verdicts(table, "gbo_small is stable") == ["reproduced"]
    assert verdicts(table, "gbo_large is unstable") == ["reproduced"]
    assert row(table, "gbo_large is unstable")["ours"] == "100.0 % [100.0, 100.0]"
    assert verdicts(table, "gbo_large ends in a local minimum") == ["reproduced"]
    table = claims(PAPER | {"gbo_small": waits, "gbo_large": falls})
    assert verdicts(table, "gbo_small is stable") == ["not reproduced"]
    assert verdicts(table, "gbo_large is unstable") == ["not reproduced"]
    assert verdicts(table, "gbo_large ends in a local minimum") == ["depends on the budget"]
    at_best = claims(PAPER | {"gbo_large": spread_of([391.0] * 5)})
    assert verdicts(at_best, "gbo_large ends in a local minimum") == ["not reproduced"]


def test_what_the_large_swarm_costs() -> None:
    table = claims(PAPER)
    assert row(table, "more evaluations than pso_100")["ours"] == "6.92× [6.92, 6.92]"
    assert verdicts(table, "more evaluations than pso_100") == ["reproduced"]
    cheap = claims(PAPER | {"pso_500": [[(50.0, 2000.0), (400.0, 390.0)]] * 5})
    assert verdicts(cheap, "more evaluations than pso_100") == ["not reproduced"]
    assert verdicts(cheap, "more evaluations than miho") == ["not reproduced"]


def test_a_descent_that_still_falls_depends_on_the_budget() -> None:
    """A longer run might fall by more than the limit, and by no less."""
    still: list[Steps] = [[(1.0, 9000.0), (9e5, 8500.0)]] * 5
    assert verdicts(claims(PAPER | {"gbo_small": still}), HARDLY) == ["depends on the budget"]


def test_two_repetitions_are_too_few_for_any_verdict() -> None:
    table = claims({method: runs[:2] for method, runs in PAPER.items()})
    assert set(table["verdict"]) == {"depends on the repetitions"}


def test_only_common_seeds_are_compared() -> None:
    table = claims(PAPER | {"pso_500": PAPER["pso_500"][:3]})
    assert row(table, "below pso_500")["repetitions"] == 3
    assert row(table, "below gbo_large")["repetitions"] == 5


def test_an_interval_with_the_figure_and_no_advantage_depends_on_the_repetitions() -> None:
    rival = spread_of([300, 310, 330, 900, 950])
    table = claims(PAPER | {"pso_500": rival})
    assert verdicts(table, "below pso_500") == ["depends on the repetitions"]


def test_a_gain_below_the_figure_is_not_reproduced() -> None:
    table = claims(PAPER | {"pso_500": spread_of([391, 391, 392, 391, 390])})
    assert verdicts(table, "below pso_500") == ["not reproduced"]


def test_gains_from_curves_that_still_fall_depend_on_the_budget() -> None:
    rival_falls = {"pso_500": [[(50.0, 2000.0), (9e5, 513.0)]] * 5}
    assert verdicts(claims(PAPER | rival_falls), "below pso_500") == ["depends on the budget"]
    miho_falls = {"miho": [[(10.0, 2000.0), (9e5, 490.0)]] * 5}
    assert verdicts(claims(PAPER | miho_falls), "below pso_500") == ["depends on the budget"]


@pytest.mark.parametrize(
    ("final", "expected"),
    [(394.9, "reproduced"), (440.0, "not reproduced"), (300.0, "not reproduced")],
)
def test_the_terminal_error(final: float, expected: str) -> None:
    runs = PAPER | {"miho": spread_of([final] * 5)}
    assert verdicts(claims(runs), "terminal") == [expected]


def test_ending_where_the_best_rival_ends_depends_on_the_data() -> None:
    runs = PAPER | {"miho": spread_of([440] * 5), "least_squares": spread_of([439] * 5)}
    assert verdicts(claims(runs), "terminal") == ["depends on the data"]
    runs["least_squares"] = spread_of([400] * 5)
    assert verdicts(claims(runs), "terminal") == ["not reproduced"]


def test_a_wide_interval_does_not_reproduce_a_level() -> None:
    runs = PAPER | {"miho": spread_of([300, 320, 350, 420, 560])}
    assert verdicts(claims(runs), "terminal") == ["depends on the repetitions"]


def test_a_level_above_the_paper_that_still_falls_depends_on_the_budget() -> None:
    falling: list[Steps] = [[(10.0, 2000.0), (9e5, 440.0)]] * 5
    assert verdicts(claims(PAPER | {"miho": falling}), "terminal") == ["depends on the budget"]


def test_pso_that_escapes_in_some_runs_is_not_stuck() -> None:
    runs = PAPER | {"pso_100": spread_of([390, 390, 780, 1090, 1100])}
    table = claims(runs)
    assert verdicts(table, "pso_100 stops") == ["depends on the repetitions"]
    assert row(table, "pso_100 stops")["reason"] == "2 of 5 came within 1 % of the best"
    assert verdicts(claims(PAPER | {"pso_100": spread_of([391] * 5)}), "pso_100 stops") == [
        "not reproduced"
    ]


@pytest.mark.parametrize(
    ("final", "expected"),
    [
        ([8700.0] * 5, "reproduced"),
        ([5000.0] * 5, "not reproduced"),
        ([8900.0, 8900, 8900, 7000, 6800], "depends on the repetitions"),
    ],
)
def test_flatness(final: list[float], expected: str) -> None:
    assert verdicts(claims(PAPER | {"gbo_small": spread_of(final)}), HARDLY) == [expected]


def test_runs_without_a_value_do_not_count_as_flat() -> None:
    table = claims(PAPER | {"gbo_small": [[]] * 5})
    assert verdicts(table, HARDLY) == ["depends on gbo_small"]


def test_missing_methods_are_named() -> None:
    runs = {method: PAPER[method] for method in ("miho", "pso_100", "pso_500")}
    table = claims(runs)
    assert verdicts(table, SPEED_1) == ["depends on gbo_small, gbo_large"] * 2
    assert row(table, SPEED_1)["ours"] == "13× [13, 13]"
    assert verdicts(table, "below gbo_large") == ["depends on gbo_large"]
    slower = claims(runs | {"pso_100": [[(150.0, 750.0)]] * 5})
    assert verdicts(slower, SPEED_1) == ["not reproduced"] * 2
    alone = claims({"miho": PAPER["miho"]})
    assert row(alone, SPEED_1)["ours"] == "-"
    assert row(alone, "pso_100 stops")["verdict"] == "depends on pso_100"


def test_other_methods_are_compared_without_a_claim() -> None:
    table = claims(PAPER | {"least_squares": spread_of([390] * 5), "random": spread_of([800] * 5)})
    faster = row(table, "least_squares to 0.5 kN, in evaluations")
    assert faster["paper"] == faster["verdict"] == "-"
    assert faster["ours"].startswith("0.0110×")
    assert faster["reason"] == "MIHO is slower"
    assert row(table, "random to 0.5 kN, in seconds")["reason"] == "MIHO is faster"


def test_claims_need_miho_and_a_force() -> None:
    with pytest.raises(ValueError, match="no runs of 'miho'; the methods are pso_100"):
        claims_table(*frames({"pso_100": PAPER["pso_100"]}))
    with pytest.raises(ValueError, match="these runs are in N m"):
        claims(PAPER, unit="N m")


def test_the_same_table_is_printed_again() -> None:
    first, second = (claims_table(*like_fig6(3), settings=FULL, resamples=200) for _ in range(2))
    pd.testing.assert_frame_equal(first, second)


def test_results_per_method() -> None:
    runs = PAPER | {"pso_100": [*spread_of([390, 392, 780, 800]), []]}
    table = results_table(*frames(runs)).set_index("method")
    assert next(iter(table.index)) == "miho"
    pso = table.loc["pso_100"]
    assert pso["repetitions"] == 5
    assert pso["no value"] == 1
    assert pso["mean error [kN]"] == pytest.approx(0.5905)
    assert (pso["best [kN]"], pso["worst [kN]"]) == (0.39, 0.8)
    assert pso["evaluations to 1 kN"] == 11
    assert pso["evaluations to 0.5 kN"] == np.inf
    assert pso["success"] == pytest.approx(0.4)
    assert table.loc["miho", "evaluations to best + 1 %"] == 1000
    assert table.loc["miho", "seconds to 1 kN"] == pytest.approx(0.01)


def test_gaps_are_to_the_closed_form_optimum_or_to_the_best_run() -> None:
    runs, curves = frames({"miho": spread_of([412, 408]), "random": spread_of([404, 900])})
    gaps = results_table(runs, curves).set_index("method")["gap to best of all runs [%]"]
    assert gaps["miho"] == pytest.approx(100 * (410 / 404 - 1), abs=1e-6)
    with_optimum = results_table(runs.assign(optimum=400.0), curves).set_index("method")
    assert "gap to best of all runs [%]" not in with_optimum
    assert with_optimum.loc["miho", "gap to optimum [%]"] == pytest.approx(2.5)
    assert with_optimum.loc["random", "gap to optimum [%]"] == pytest.approx(63)
    partly = results_table(runs.assign(optimum=[400.0, 400.0, 400.0, np.nan]), curves)
    assert "gap to best of all runs [%]" in partly
    rounding = results_table(runs.assign(error=400.0, optimum=400.0 * (1 + 1e-12)), curves)
    assert (to_markdown(rounding[["gap to optimum [%]"]]).splitlines()[2:]) == ["| 0 |"] * 2


def test_the_papers_targets_are_forces() -> None:
    torque = results_table(*frames(PAPER, unit="Nm"))
    assert [name for name in torque if name.startswith("evaluations")] == [
        "evaluations to best + 1 %"
    ]
    table = results_table(*frames(PAPER, unit="Nm"), targets=[800.0])
    assert "seconds to 800 Nm" in table


def test_markdown_aligns_numbers_escapes_pipes_and_says_never() -> None:
    frame = pd.DataFrame({"method": ["a|b"], "error [kN]": [0.39182], "evaluations": [np.inf]})
    assert to_markdown(frame) == (
        "| method | error [kN] | evaluations |\n| --- | --: | --: |\n| a\\|b | 0.392 | never |\n"
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (0.0123456, "0.0123"), (13.04, "13.0"), (217_000.4, "217,000"), (-2.5, "-2.50"),
        (0.00012345, "0.000123"), (3e-11, "3.00e-11"), (-3e-11, "-3.00e-11"),
    ],
)  # fmt: skip
def test_numbers(value: float, text: str) -> None:
    assert number(value) == text


def test_bounds_are_printed_as_bounds() -> None:
    assert with_interval(Interval(5.25, 4, np.inf, np.inf, 1), "×") == "more than 5.25× [4, ∞]"
    assert with_interval(Interval(5.25, 4, 9, 8.5, 1), "×") == "5.25 to 8.50× [4, 9]"
