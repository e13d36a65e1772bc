"""Tests of differences between methods: Friedman and Nemenyi for ranks, Wilcoxon for pairs.

The sample is the set of problems: `scores` (problems, methods) has one number per problem and
method, lower is better, for example an expected running time or a median over repetitions.
Repetitions must not be rows, because they would count as independent problems. Similar problems are
not an independent sample either: with one row for each family (`leaderboard.family_scores`) the
same tests are stricter, and "problems" below are families.

References
----------
J. Demšar, "Statistical comparisons of classifiers over multiple data sets", 2006, Sec. 3.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
import pandas as pd
import scipy  # loads its subpackages on first use: importing them takes a second
from numpy.typing import NDArray

from miho.analysis.compare.bootstrap import RESAMPLES, interval
from miho.analysis.compare.running_time import at_factor, resampled
from miho.analysis.curves import Axis
from miho.quantities import Array


@dataclass(frozen=True)
class FriedmanTest:
    """Friedman's chi2 and Iman and Davenport's F for different ranks, each with its p.

    chi2 (methods - 1 degrees of freedom) is corrected for ties. Report F, with (methods - 1) and
    (methods - 1)(problems - 1) degrees of freedom, because chi2 is conservative.
    """

    methods: int
    problems: int
    chi2: float
    p_chi2: float
    f: float
    p: float


def ranks(scores: pd.DataFrame) -> pd.DataFrame:
    """Mean rank of each method over problems; ties share the mean of their ranks.

    Parameters
    ----------
    scores : DataFrame
        A row per problem and a column per method, lower is better, for example from
        `leaderboard.problem_scores`.

    Returns
    -------
    DataFrame
        Columns optimizer and rank (1 is best), best first.
    """
    mean = pd.Series(rank_rows(scores).mean(axis=0), index=scores.columns)
    table = mean.sort_values(kind="stable").rename_axis("optimizer")
    return table.rename("rank").reset_index()


def friedman(scores: pd.DataFrame) -> FriedmanTest:
    """Friedman's test; raises ValueError for fewer than three methods or two problems.

    Parameters
    ----------
    scores : DataFrame
        As in `ranks`.

    Returns
    -------
    FriedmanTest
        Friedman's chi-squared and Iman and Davenport's F, each with its p.
    """
    table = rank_rows(scores)
    problems, methods = table.shape
    if methods < 3 or problems < 2:
        raise ValueError(
            f"scores have {methods} methods on {problems} problems; Friedman's test needs at "
            f"least 3 on 2, compare two methods with pairwise()"
        )
    if (table == table[:, :1]).all():
        return FriedmanTest(methods, problems, 0.0, 1.0, 0.0, 1.0)
    test = scipy.stats.friedmanchisquare(*table.T)
    chi2, largest = float(test.statistic), problems * (methods - 1)
    f = (problems - 1) * chi2 / (largest - chi2) if largest - chi2 > 1e-9 * largest else math.inf
    p = float(scipy.stats.f.sf(f, methods - 1, (methods - 1) * (problems - 1)))
    return FriedmanTest(methods, problems, chi2, float(test.pvalue), f, p)


def critical_difference(methods: int, problems: int, level: float = 0.05) -> float:
    """The difference of two average ranks that Nemenyi's test calls significant.

    It accounts for all pairs. The ranks of two methods depend on the other methods (Benavoli,
    Corani and Mangili 2016); `pairwise` tests a pair alone.

    Parameters
    ----------
    methods, problems : int
        Numbers of methods and of problems.
    level : float, optional
        Level of significance.

    Returns
    -------
    float
        The difference.
    """
    if methods < 2 or problems < 1 or not 0 < level < 1:
        raise ValueError(
            f"methods, problems and level are {methods}, {problems}, {level}; expected at least 2, "
            f"at least 1, and a number between 0 and 1"
        )
    q = float(scipy.stats.studentized_range.ppf(1 - level, methods, np.inf)) / math.sqrt(2)
    return q * math.sqrt(methods * (methods + 1) / (6 * problems))


def cliques(ranks: pd.DataFrame, difference: float) -> list[tuple[str, ...]]:
    """The largest groups of methods whose mean ranks are within the critical difference.

    Parameters
    ----------
    ranks : DataFrame
        As from `ranks`.
    difference : float
        As from `critical_difference`.

    Returns
    -------
    list of tuple of str
        At least two names each, in the order of their ranks, the best group first. No group is
        contained in another.
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

    Raises ValueError if a score is missing.
    """
    values = scores.to_numpy(dtype=float)
    missing = np.argwhere(np.isnan(values))
    if missing.size:
        row, column = missing[0]
        raise ValueError(
            f"scores of {scores.columns[column]} on {scores.index[row]} are missing; give every "
            f"method a score on every problem, inf if it has none"
        )
    return np.asarray(scipy.stats.rankdata(values, axis=1), dtype=float)


def pairwise(scores: pd.DataFrame, method: str | None = None) -> pd.DataFrame:
    """Wilcoxon's signed-rank test of each pair over problems: a row per pair.

    Parameters
    ----------
    scores : DataFrame, shape (problems, methods)
        See `ranks`. Differences must mean the same on all problems, so pass logarithms of
        quantities that scale, such as running times. Two infinite scores are equal.
    method : str, optional
        Test this method against every other; by default all pairs are tested.

    Returns
    -------
    DataFrame
        Columns method, rival, wins, losses (problems on which the method is strictly better or
        worse), p, p_holm, effect. Holm's correction is over the rows (Demšar 2006, Sec. 3.1.3 and
        3.2.2). `effect` is the matched-pairs rank-biserial correlation (Kerby 2014): 1 if the
        method is better on all problems, -1 if it is worse on all.
    """
    rank_rows(scores)
    names = [str(name) for name in scores.columns]
    if method is not None and method not in names:
        raise ValueError(f"method is {method!r}; scores have {', '.join(names)}")
    pairs = (
        list(combinations(names, 2))
        if method is None
        else [(method, rival) for rival in names if rival != method]
    )
    columns = {name: scores[name].to_numpy(dtype=float) for name in names}
    rows = []
    for first, rival in pairs:
        gain = _difference(columns[rival], columns[first])
        p, effect = signed_rank(gain)
        rows.append((first, rival, int((gain > 0).sum()), int((gain < 0).sum()), p, effect))
    table = pd.DataFrame(rows, columns=["method", "rival", "wins", "losses", "p", "effect"])
    table.insert(5, "p_holm", holm(table["p"].to_numpy(dtype=float)))
    return table


def signed_rank(differences: Array) -> tuple[float, float]:
    """Two-sided p of Wilcoxon's signed-rank test on (n,), and the rank-biserial correlation.

    Zeros are ranked and their ranks split evenly between both sides, following Demšar. p is exact
    given the ranks, also with ties: it uses the distribution of the rank sum over all 2^m signs of
    the m nonzero differences.
    """
    doubled = np.round(2 * scipy.stats.rankdata(np.abs(differences))).astype(int)
    signed = doubled[differences != 0]
    total = int(signed.sum())
    if not total:
        return 1.0, 0.0
    balance = int((np.sign(differences) * doubled).sum())
    chances = np.zeros(total + 1)
    chances[0] = 1.0
    for rank in signed:
        chances[rank:] = (chances[rank:] + chances[:-rank]) / 2
        chances[:rank] /= 2
    balances = 2 * np.arange(total + 1) - total
    p = float(chances[np.abs(balances) >= abs(balance)].sum())
    return min(p, 1.0), balance / int(doubled.sum())


def holm(p: Array) -> Array:
    """Holm's (1979) step-down adjusted p-values (n,), in the given order.

    Examples
    --------
    >>> import numpy as np
    >>> from miho.analysis.compare.significance import holm
    >>> holm(np.array([0.01, 0.04, 0.03])).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    order = np.argsort(p, kind="stable")
    adjusted = np.empty(p.size)
    steps = np.arange(p.size, 0, -1) * p[order]
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted


def pairwise_speed_up(
    hits: pd.DataFrame,
    factor: float,
    axis: Axis,
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
    families: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """How many times faster each method reaches the factor than each rival: a row per pair.

    [low, high] is the 95 % percentile interval of a hierarchical bootstrap: problems are drawn with
    replacement (all problems of a family together, if `families` is given), and then the runs of
    each drawn problem, with the same seeds for all methods. The interval is for problems like
    these, not for these problems. Observed problems vary by their runs already, so runs count
    twice, and the interval is wider than necessary. In a resample only problems that both methods
    solve count.

    Parameters
    ----------
    hits : DataFrame
        See `running_time.hits`.
    factor : float
        Target, as a multiple of the best known error.
    axis : {'evaluations', 'seconds', 'cpu_seconds'}
        Axis of the running times.
    rng : Generator
        Draws the resamples.
    resamples : int
        Number of resamples.
    families : mapping of str to str, optional
        Family of each problem.

    Returns
    -------
    DataFrame
        Columns method, rival, ratio, low, high, problems, only_method, only_rival. `ratio` is the
        geometric mean of (rival's expected running time / the method's) over the `problems` that
        both solve at least once, NaN if there are none. `only_method` and `only_rival` count
        problems that only one of them solves, which the ratio ignores: read them together.
    """
    names, values = resampled(at_factor(hits, factor), axis, rng, resamples)
    problems, methods = names["problem"].unique(), sorted(names["optimizer"].unique())
    logs = np.full((len(methods), problems.size + 1, 1 + resamples), np.nan)
    method_places = pd.Index(methods).get_indexer(names["optimizer"])
    problem_places = pd.Index(problems).get_indexer(names["problem"])
    logs[method_places, problem_places] = np.log(values)
    # Draw families, and for each drawn problem one of its resamples; row 0 is the actual data.
    groups = _members([families[name] if families else name for name in problems])
    drawn_groups = rng.integers(len(groups), size=(1 + resamples, len(groups)))
    drawn_groups[0] = np.arange(len(groups))
    rows = groups[drawn_groups].reshape(1 + resamples, -1)
    columns = rng.integers(1, 1 + resamples, size=rows.shape)
    columns[0] = 0
    replicates = dict(zip(methods, logs[:, rows, columns], strict=True))
    return pd.DataFrame(
        [
            {"method": method, "rival": rival} | _speed_up(replicates[method], replicates[rival])
            for method, rival in permutations(methods, 2)
        ]
    )


def _members(families: list[str]) -> NDArray[np.intp]:
    """Positions of each family's members (families, most), padded with the number of all."""
    codes = pd.factorize(pd.Series(families))[0]
    table = np.full((codes.max() + 1, np.bincount(codes).max()), codes.size)
    for code, row in enumerate(table):
        places = np.flatnonzero(codes == code)
        row[: places.size] = places
    return table


def _speed_up(method: Array, rival: Array) -> dict[str, float]:
    """The ratio of drawn log running times (1 + m, problems), not finite if not solved."""
    solved = np.isfinite(method) & np.isfinite(rival)
    sums = (np.where(solved, rival, 0.0) - np.where(solved, method, 0.0)).sum(axis=1)
    means = np.full(len(sums), np.nan)
    np.divide(sums, solved.sum(axis=1), out=means, where=solved.any(axis=1))
    ratios = np.exp(means[np.isfinite(means)])
    bounds = interval(ratios, ratios) if solved[0].any() and ratios.size > 1 else None
    return {
        "ratio": bounds.estimate if bounds else np.nan,
        "low": bounds.low if bounds else np.nan,
        "high": bounds.high if bounds else np.nan,
        "problems": int(solved[0].sum()),
        "only_method": int((np.isfinite(method[0]) & ~solved[0]).sum()),
        "only_rival": int((np.isfinite(rival[0]) & ~solved[0]).sum()),
    }


def _difference(left: Array, right: Array) -> Array:
    """left - right; 0 if they are equal, even if both are infinite."""
    equal = left == right
    return np.where(equal, 0.0, np.where(equal, 0.0, left) - np.where(equal, 0.0, right))
