from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from miho.analysis.compare.significance import (
    cliques,
    critical_difference,
    friedman,
    ranks,
    signed_rank,
)

# Demšar 2006, Table 6: AUC of four variants of C4.5 on 14 data sets. The paper ranks voting by
# unrounded values (2 and 3 where 0.975 is printed twice), hence the 0.9749.
DEMSAR = pd.DataFrame(
    [
        (0.763, 0.768, 0.771, 0.798), (0.599, 0.591, 0.590, 0.569), (0.954, 0.971, 0.968, 0.967),
        (0.628, 0.661, 0.654, 0.657), (0.882, 0.888, 0.886, 0.898), (0.936, 0.931, 0.916, 0.931),
        (0.661, 0.668, 0.609, 0.685), (0.583, 0.583, 0.563, 0.625), (0.775, 0.838, 0.866, 0.875),
        (1.000, 1.000, 1.000, 1.000), (0.940, 0.962, 0.965, 0.962), (0.619, 0.666, 0.614, 0.669),
        (0.972, 0.981, 0.975, 0.9749), (0.957, 0.978, 0.946, 0.970),
    ],
    columns=["C4.5", "C4.5+m", "C4.5+cf", "C4.5+m+cf"],
)  # fmt: skip
LOWER_IS_BETTER = 1 - DEMSAR


def test_average_ranks_of_demsars_example() -> None:
    table = ranks(LOWER_IS_BETTER)
    assert table["optimizer"].tolist() == ["C4.5+m+cf", "C4.5+m", "C4.5+cf", "C4.5"]
    np.testing.assert_allclose(table["rank"], [1.964, 2.000, 2.893, 3.143], atol=5e-4)


def test_friedmans_test_of_demsars_example() -> None:
    """The paper prints chi2 = 9.28 and F = 3.69, without the correction for ties."""
    test = friedman(LOWER_IS_BETTER)
    tied = [np.unique(row, return_counts=True)[1] for row in DEMSAR.to_numpy()]
    correction = 1 - sum((t**3 - t).sum() for t in tied) / (14 * 4 * (16 - 1))
    uncorrected = test.chi2 * correction
    assert uncorrected == pytest.approx(9.28, abs=0.01)
    assert 13 * uncorrected / (14 * 3 - uncorrected) == pytest.approx(3.69, abs=0.01)
    assert test.f == pytest.approx(13 * test.chi2 / (14 * 3 - test.chi2))
    assert test.p == pytest.approx(stats.f.sf(test.f, 3, 39))
    assert (test.methods, test.problems) == (4, 14)


def test_wilcoxon_of_demsars_example() -> None:
    """Sec. 3.1.3 compares C4.5 with C4.5+m: rank sums of 93 and 12, two zeros split."""
    p, effect = signed_rank(np.round(DEMSAR["C4.5+m"] - DEMSAR["C4.5"], 3).to_numpy())
    assert effect == pytest.approx((93 - 12) / 105)
    assert p < 0.05  # 12 is below the critical 21


@pytest.mark.parametrize(
    ("level", "table"),
    [
        (0.05, [1.960, 2.343, 2.569, 2.728, 2.850, 2.949, 3.031, 3.102, 3.164]),
        (0.10, [1.645, 2.052, 2.291, 2.459, 2.589, 2.693, 2.780, 2.855, 2.920]),
    ],
)
def test_critical_values_of_demsars_table_5(level: float, table: list[float]) -> None:
    for methods, q in enumerate(table, 2):
        scale = math.sqrt(methods * (methods + 1) / (6 * 30))
        # printed from Studentized range tables with three digits, so up to 1e-3 off
        assert critical_difference(methods, 30, level) / scale == pytest.approx(q, abs=1.1e-3)


def test_the_critical_difference_and_cliques_of_demsars_example() -> None:
    """The paper: 1.25 at 5 % and 1.12 at 10 %; at 10 % the extremes differ."""
    assert critical_difference(4, 14) == pytest.approx(1.25, abs=0.005)
    difference = critical_difference(4, 14, 0.10)
    assert difference == pytest.approx(1.12, abs=0.005)
    assert cliques(ranks(LOWER_IS_BETTER), difference) == [
        ("C4.5+m+cf", "C4.5+m", "C4.5+cf"),
        ("C4.5+cf", "C4.5"),
    ]


def test_cliques_are_the_largest_groups() -> None:
    table = pd.DataFrame({"optimizer": list("edcba"), "rank": [9.0, 5.0, 2.5, 2.0, 1.0]})
    assert cliques(table, 1.5) == [("a", "b", "c")]
    assert cliques(table, 3.0) == [("a", "b", "c"), ("b", "c", "d")]
    assert cliques(table, 0.4) == []
    assert cliques(table, 9.0) == [tuple("abcde")]


def test_ties_and_infinite_scores_share_ranks() -> None:
    scores = pd.DataFrame({"a": [1.0, np.inf], "b": [1.0, np.inf], "c": [2.0, 0.0]})
    assert ranks(scores).set_index("optimizer")["rank"].to_dict() == {"a": 2, "b": 2, "c": 2}


def test_friedman_of_equal_and_of_perfectly_ordered_methods() -> None:
    equal = friedman(pd.DataFrame({name: [1.0, 2.0, 3.0] for name in "abc"}))
    assert (equal.chi2, equal.p_chi2, equal.f, equal.p) == (0, 1, 0, 1)
    ordered = friedman(pd.DataFrame({"a": [1.0] * 5, "b": [2.0] * 5, "c": [3.0] * 5}))
    assert (ordered.chi2, ordered.f, ordered.p) == (pytest.approx(10), math.inf, 0)


def test_what_cannot_be_ranked_is_named() -> None:
    with pytest.raises(ValueError, match="scores of b on 1 are missing"):
        ranks(pd.DataFrame({"a": [1.0, 2.0], "b": [1.0, np.nan]}))
    with pytest.raises(ValueError, match="scores have 2 methods on 2 problems"):
        friedman(pd.DataFrame({"a": [1.0, 2.0], "b": [1.0, 3.0]}))
    with pytest.raises(ValueError, match=r"problems and level are 1, 5, 0\.05"):
        critical_difference(1, 5)
