from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from miho.analysis.compare.running_time import running_times
from miho.analysis.compare.significance import (
    friedman,
    holm,
    pairwise,
    pairwise_speed_up,
    signed_rank,
)


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def table(times: dict[str, list[list[float]]]) -> pd.DataFrame:
    """Hits from evaluations to the target: method, problem, run; runs spend 100."""
    rows = [
        (f"p{problem}", method, seed, 1.01, at, 100.0, np.isfinite(at))
        for method, problems in times.items()
        for problem, runs in enumerate(problems)
        for seed, at in enumerate(runs)
    ]
    return pd.DataFrame(
        rows,
        columns=[
            "problem", "optimizer", "seed", "factor", "evaluations", "spent_evaluations", "reached",
        ],
    )  # fmt: skip


@pytest.mark.parametrize("size", [1, 5, 12, 16, 30])
def test_p_is_scipys_exact_one_where_there_are_no_ties(size: int) -> None:
    for _ in range(5):
        differences = rng().normal(0.3, 1, size)
        expected = stats.wilcoxon(differences, method="exact").pvalue
        assert signed_rank(differences)[0] == pytest.approx(expected, rel=1e-12)


def test_p_with_ties_zeros_and_infinities_is_that_of_all_signs() -> None:
    differences = np.array([1.0, 1, -1, 2, 0, 0, 3, 3, np.inf, -2])
    ranks = stats.rankdata(np.abs(differences))
    balance = np.sum(np.sign(differences) * ranks)
    signs = np.array(list(product([-1, 1], repeat=8)))
    all_balances = signs @ ranks[differences != 0]
    p, effect = signed_rank(differences)
    assert p == pytest.approx(np.mean(np.abs(all_balances) >= abs(balance)), rel=1e-12)
    assert effect == pytest.approx(balance / ranks.sum())


def test_no_difference_is_no_evidence() -> None:
    assert signed_rank(np.zeros(6)) == (1.0, 0.0)


def test_holms_correction_of_a_worked_example() -> None:
    """0.01, 0.02, 0.03, 0.04 times 4, 3, 2, 1, made monotone; in the order given."""
    adjusted = holm(np.array([0.03, 0.01, 0.04, 0.02]))
    np.testing.assert_allclose(adjusted, [0.06, 0.04, 0.06, 0.06])
    np.testing.assert_allclose(holm(np.array([0.5, 0.9])), [1.0, 1.0])


def test_pairs_of_scores() -> None:
    problems = np.arange(8.0)
    frame = pd.DataFrame({"a": problems, "b": problems + 1 + problems / 9, "c": [np.inf] * 8})
    table = pairwise(frame)
    assert table[["method", "rival"]].to_numpy().tolist() == [["a", "b"], ["a", "c"], ["b", "c"]]
    assert table["wins"].tolist() == [8, 8, 8]
    np.testing.assert_allclose(table["p"], 2 / 2**8)
    np.testing.assert_allclose(table["p_holm"], 6 / 2**8)
    assert table["effect"].tolist() == [1, 1, 1]
    control = pairwise(frame, "c")
    assert control["rival"].tolist() == ["a", "b"]
    assert control["losses"].tolist() == [8, 8]
    assert control["effect"].tolist() == [-1, -1]
    np.testing.assert_allclose(control["p_holm"], 4 / 2**8)


def test_two_infinite_scores_are_equal() -> None:
    row = pairwise(pd.DataFrame({"a": [1.0, np.inf], "b": [2.0, np.inf]})).iloc[0]
    assert (row["wins"], row["losses"]) == (1, 0)


def test_a_worked_speed_up() -> None:
    """Ratios of 4 and 9 on the two problems that both solve: their geometric mean is 6."""
    never = np.inf
    speed_ups = pairwise_speed_up(
        table(
            {
                "a": [[10.0, 10.0], [20.0, 20.0], [5.0, 5.0], [never, never], [never, never]],
                "b": [[40.0, 40.0], [180.0, 180.0], [never, never], [1.0, 1.0], [never, never]],
            }
        ),
        1.01,
        "evaluations",
        rng(),
    ).set_index(["method", "rival"])
    ours = speed_ups.loc[("a", "b")]
    assert ours["ratio"] == pytest.approx(6)
    # runs do not vary, so only the draw of problems is left: both of one kind at the extremes
    assert (ours["low"], ours["high"]) == (pytest.approx(4), pytest.approx(9))
    assert ours[["problems", "only_method", "only_rival"]].tolist() == [2, 1, 1]
    back = speed_ups.loc[("b", "a")]
    np.testing.assert_allclose(
        back[["ratio", "low", "high"]].to_numpy(dtype=float),
        1 / ours[["ratio", "high", "low"]].to_numpy(dtype=float),
    )


def test_a_family_is_drawn_as_a_whole() -> None:
    """Five ratios of 4 in one family, one of 9 in another: one draw in four is of 9 alone.

    With problems drawn one by one that is one in 6^6.
    """
    a, b = [10.0, 10.0], [40.0, 40.0]
    hits = table({"a": [a] * 6, "b": [*[b] * 5, [90.0, 90.0]]})
    names = hits["problem"].unique().tolist()
    kinds = dict(zip(names, [*["one"] * 5, "two"], strict=True))
    row = pairwise_speed_up(hits, 1.01, "evaluations", rng(), 400, families=kinds).iloc[0]
    assert row["ratio"] == pytest.approx((4**5 * 9) ** (1 / 6))
    assert (row["low"], row["high"]) == (pytest.approx(4), pytest.approx(9))
    alone = pairwise_speed_up(hits, 1.01, "evaluations", rng(), 400).iloc[0]
    assert alone["ratio"] == pytest.approx(row["ratio"])
    assert alone["high"] < 7


def test_methods_that_solve_nothing_in_common_have_no_ratio() -> None:
    never = np.inf
    hits = table({"a": [[1.0], [never]], "b": [[never], [1.0]]})
    speed_ups = pairwise_speed_up(hits, 1.01, "evaluations", rng(), 50)
    assert speed_ups[["ratio", "low", "high"]].isna().all(axis=None)
    assert speed_ups["problems"].tolist() == [0, 0]


def test_an_unknown_method_is_named() -> None:
    with pytest.raises(ValueError, match="method is 'z'; scores have a, b"):
        pairwise(pd.DataFrame({"a": [1.0], "b": [2.0]}), "z")


def relabelled(random: np.random.Generator, names: str, problems: int = 16) -> pd.DataFrame:
    """Ten runs per name and problem, all of one method; about one in eight never arrives."""
    typical = np.geomspace(10, 60, problems)[:, None]
    at = np.ceil(typical * random.lognormal(0, 0.7, (problems, 10 * len(names))))
    at[at > 100] = np.inf
    return table({name: at[:, 10 * k : 10 * k + 10].tolist() for k, name in enumerate(names)})


def test_a_method_that_is_twice_as_fast_is_found_to_be() -> None:
    hits = relabelled(rng(), "ab")
    faster = hits["optimizer"] == "a"
    hits.loc[faster, ["evaluations", "spent_evaluations"]] /= 2
    row = pairwise_speed_up(hits, 1.01, "evaluations", rng(), 500).iloc[0]
    assert 1 < row["low"] < 2 < row["high"]


@pytest.mark.slow
def test_one_method_under_several_names_differs_as_often_as_the_level_says() -> None:
    """200 experiments at 5 %: 10 false alarms expected, 2 to 20 are within three sigma (3.1).

    The hierarchical interval is conservative where only chance differs: 99 % hold the truth.
    """
    random = rng()
    alarms, friedman_alarms, held = 0, 0, 0
    for _ in range(200):
        hits = relabelled(random, "abcd")
        ert = running_times(hits, "evaluations")
        scores = ert.pivot(index="problem", columns="optimizer", values="ert").map(np.log)
        alarms += pairwise(scores[["a", "b"]])["p"].item() < 0.05
        friedman_alarms += friedman(scores).p < 0.05
        two = hits[hits["optimizer"].isin(["a", "b"])]
        ratio = pairwise_speed_up(two, 1.01, "evaluations", random, 300).iloc[0]
        held += ratio["low"] <= 1 <= ratio["high"]
    assert 2 <= alarms <= 20
    assert 2 <= friedman_alarms <= 20
    assert held >= 186
