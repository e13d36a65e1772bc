"""Average ranks of methods over problems: Friedman's test and the critical difference.

The sample is the set of problems: `scores` (problems, methods) holds one number per problem and
method, lower is better, such as an expected running time or a median over repetitions. Repetitions
are never rows, they would be counted as independent problems. Problems that are alike are no
independent sample either: with one row for each family of them (`leaderboard.family_scores`) the
same tests are stricter, and "problems" below are families. Source: Demšar 2006, "Statistical
comparisons of classifiers over multiple data sets", Sec. 3.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy  # which loads its packages where they are used: importing them takes a second
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FriedmanTest:
    """Whether average ranks differ: Friedman's chi2 and Iman and Davenport's F, each with its p.

    chi2 (methods - 1 degrees of freedom) is corrected for ties. F, with (methods - 1) and
    (methods - 1)(problems - 1) degrees of freedom, is the one to report: chi2 is conservative.
    """

    methods: int
    problems: int
    chi2: float
    p_chi2: float
    f: float
    p: float


def ranks(scores: pd.DataFrame) -> pd.DataFrame:
    """Mean rank over problems, best first: optimizer, rank. Ties share the mean of their ranks."""
    mean = pd.Series(rank_rows(scores).mean(axis=0), index=scores.columns)
    table = mean.sort_values(kind="stable").rename_axis("optimizer")
    return table.rename("rank").reset_index()


def friedman(scores: pd.DataFrame) -> FriedmanTest:
    """Friedman's test. Raises ValueError for fewer than three methods or two problems."""
    table = rank_rows(scores)
    problems, methods = table.shape
    if methods < 3 or problems < 2:
        raise ValueError(
            f"scores hold {methods} methods on {problems} problems; Friedman's test needs at "
            f"least 3 on 2, compare two methods with pairwise()"
        )
    if (table == table[:, :1]).all():
        return FriedmanTest(methods, problems, 0.0, 1.0, 0.0, 1.0)
    test = scipy.stats.friedmanchisquare(*table.T)
    chi2, most = float(test.statistic), problems * (methods - 1)
    f = (problems - 1) * chi2 / (most - chi2) if most - chi2 > 1e-9 * most else math.inf
    p = float(scipy.stats.f.sf(f, methods - 1, (methods - 1) * (problems - 1)))
    return FriedmanTest(methods, problems, chi2, float(test.pvalue), f, p)


def critical_difference(methods: int, problems: int, level: float = 0.05) -> float:
    """The difference of two average ranks that Nemenyi's test calls significant.

    It allows for all pairs. The ranks of two methods depend on who else takes part (Benavoli,
    Corani and Mangili 2016): the test of a pair by itself is `pairwise.pairwise`.
    """
    if methods < 2 or problems < 1 or not 0 < level < 1:
        raise ValueError(
            f"methods, problems and level are {methods}, {problems}, {level}; expected at least 2, "
            f"at least 1, and a number between 0 and 1"
        )
    q = float(scipy.stats.studentized_range.ppf(1 - level, methods, np.inf)) / math.sqrt(2)
    return q * math.sqrt(methods * (methods + 1) / (6 * problems))


def cliques(ranks: pd.DataFrame, difference: float) -> list[tuple[str, ...]]:
    """The largest groups of methods whose ranks lie within `difference`, best first.

    Each is a tuple of at least two names in the order of their rank, none within another.
    """
    ordered = ranks.sort_values("rank", kind="stable")
    names, values = ordered["optimizer"].tolist(), ordered["rank"].to_numpy(dtype=float)
    ends = np.searchsorted(values, values + difference, side="right")
    before = np.append(0, ends[:-1])
    return [
        tuple(names[start:end])
        for start, (end, covered) in enumerate(zip(ends, before, strict=True))
        if end > covered and end - start > 1
    ]


def rank_rows(scores: pd.DataFrame) -> Array:
    """Ranks (problems, methods) within each row, 1 is best; inf is worst, ties are averaged.

    Raises ValueError where a score is missing.
    """
    values = scores.to_numpy(dtype=float)
    missing = np.argwhere(np.isnan(values))
    if missing.size:
        row, column = missing[0]
        raise ValueError(
            f"scores of {scores.columns[column]} on {scores.index[row]} are missing; give every "
            f"method a score on every problem, inf where it has none"
        )
    return np.asarray(scipy.stats.rankdata(values, axis=1), dtype=float)
