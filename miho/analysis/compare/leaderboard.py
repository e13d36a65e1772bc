"""Tables of results: a row per method over all problems or on one problem, best first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from miho.analysis.compare.profiles import area_over_curve
from miho.analysis.compare.running_time import NEAR_BEST, at_factor, hits, running_times
from miho.analysis.compare.significance import ranks
from miho.analysis.curves import Axis, to_target
from miho.analysis.tidy import one_problem, shown_unit
from miho.analysis.timing import UNITS, clock_of, undisturbed

STRICT = 1.001


def leaderboard(runs: pd.DataFrame, curves: pd.DataFrame) -> pd.DataFrame:
    """Table with a row per method, best mean rank first.

    A method that was not run on a problem has not solved it. Success is the share of the existing
    runs.

    Parameters
    ----------
    runs, curves : DataFrame
        As in `miho.load_runs`, of several problems.

    Returns
    -------
    DataFrame
        The columns are

        - mean rank: over problems, from `problem_scores` at `NEAR_BEST`
        - by families: the same over families of problems, from `family_scores`, if the runs have
          the column `family`
        - solved: number of problems on which any run reached `NEAR_BEST` times the best error
        - success: share of runs that reached it, and the share that reached `STRICT` times it
        - times the best: expected running time relative to the best method, geometric mean over the
          problems that the method solves; compare it together with solved
        - AOCC: `area_over_curve`, mean over problems
        - cut by seconds: share of runs that the time limit ended before they converged or used
          their evaluations, if the runs have the column `cut`
        - µs per evaluation: seconds divided by evaluations of whole runs, including the loss,
          median over undisturbed runs; NaN if there are none
    """
    reached = hits(runs, curves, (NEAR_BEST, STRICT))
    areas = area_over_curve(runs, curves)
    ert = running_times(reached, "evaluations")
    scores = problem_scores(ert, areas, NEAR_BEST)
    solved = at_factor(ert, NEAR_BEST)
    ratios = np.log(solved["ert"] / solved.groupby("problem")["ert"].transform("min"))
    ratios = ratios[np.isfinite(solved["ert"])].groupby(solved["optimizer"]).mean()
    per_problem = areas.groupby(["problem", "optimizer"])["aocc"].mean()
    pace = 1e6 * runs["seconds"] / runs["evaluations"].where(runs["evaluations"] > 0)
    pace = pace.where(undisturbed(runs))
    methods = ranks(scores).rename(columns={"rank": "mean rank"}).set_index("optimizer")
    if "family" in runs:
        by_family = ranks(family_scores(scores, families(runs))).set_index("optimizer")
        methods["by families"] = by_family["rank"]
    cut = {"cut by seconds": runs.groupby("optimizer")["cut"].mean()} if "cut" in runs else {}
    table = methods.assign(
        solved=np.isfinite(solved["ert"]).groupby(solved["optimizer"]).sum().astype(int),
        **{
            f"success at {f:g}": at_factor(reached, f).groupby("optimizer")["reached"].mean()
            for f in (NEAR_BEST, STRICT)
        },
        **{"times the best": np.exp(ratios)},
        AOCC=per_problem.unstack().reindex(scores.index).fillna(0.0).mean(),
        **cut,
        **{"µs per evaluation": pace.groupby(runs["optimizer"]).median()},
    )
    table = table.rename(columns={"solved": f"solved of {len(scores)}"})
    return table.rename_axis("method").reset_index()


def problem_scores(ert: pd.DataFrame, areas: pd.DataFrame | None, factor: float) -> pd.DataFrame:
    """Scores of each method on each problem, for ranks and tests; lower is better.

    A score is the logarithm (base 10) of the expected running time at `factor` if that is finite.
    For a method that never reached the target, it is one more than the largest finite score of the
    problem (or than 0), so that every method that solves a problem is at least a factor of ten
    ahead of every method that does not.

    Parameters
    ----------
    ert : DataFrame
        As from `expected_running_time`.
    areas : DataFrame or None
        As from `area_over_curve`. 1 - the mean area of a method is added to the score if it never
        reached the target. This breaks ties by a measure other than the running time, so a test of
        running times omits it. A method that was not run on a problem has area 0 there.
    factor : float
        Target, as a multiple of the best known error.

    Returns
    -------
    DataFrame
        A row per problem and a column per method.
    """
    at = at_factor(ert, factor).pivot(index="problem", columns="optimizer", values="ert")
    logs = at.where(np.isfinite(at)).map(np.log10)
    behind = pd.DataFrame(0.0, index=logs.index, columns=logs.columns)
    if areas is not None:
        area = areas.groupby(["problem", "optimizer"])["aocc"].mean().unstack()
        behind = 1 - area.reindex_like(logs).fillna(0.0)
    return logs.fillna(behind.add(logs.max(axis=1).fillna(0.0) + 1, axis=0))


def best_rivals(ert: Mapping[Axis, pd.DataFrame], method: str, factor: float) -> pd.DataFrame:
    """A method and the best of all others, with a row per problem.

    For each axis of `ert` (expected running times by axis) there are four columns: the method's
    cost; the lowest cost of a rival; that rival; and the share, method over rival, which is 0 if no
    rival solves the problem, inf if the method does not, and 1 if none does. The best rival may
    differ between axes. Because it is selected by these runs, it looks better than it is.
    """
    columns: dict[str, pd.Series] = {}
    for axis, frame in ert.items():
        table = at_factor(frame, factor).pivot(index="problem", columns="optimizer", values="ert")
        method_cost, rivals = table[method], table.drop(columns=method)
        least = rivals.min(axis=1)
        share = (method_cost / least).mask(np.isinf(method_cost), np.inf).mask(np.isinf(least), 0.0)
        unit = UNITS[axis]
        columns[unit] = method_cost
        columns[f"{unit} of a rival"] = least
        columns[f"by {unit}"] = rivals.idxmin(axis=1).where(np.isfinite(least), "none")
        columns[f"share of {unit}"] = share.mask(np.isinf(method_cost) & np.isinf(least), 1.0)
    return pd.DataFrame(columns).reset_index()


def families(runs: pd.DataFrame) -> dict[str, str]:
    """The family of each problem, from the column `family`."""
    return dict(zip(runs["problem"], runs["family"], strict=True))


def family_scores(scores: pd.DataFrame, families: Mapping[str, str]) -> pd.DataFrame:
    """Scores (families, methods): the mean of the scores of each family's problems.

    Problems with one model in one kind of box are not an independent sample. Ranked one by one, the
    advantage of a method on that model would count once for each, and tests would take repetition
    for evidence. The mean of `problem_scores`, which are logarithms, is the logarithm of the
    geometric mean of expected running times if a method solves the whole family. A problem that it
    does not solve counts with at least ten times the cost of the slowest method that does.
    """
    return scores.groupby(scores.index.map(families), sort=False).mean().rename_axis("family")


PAPER_TARGETS = (1000.0, 500.0)
"""Errors [N] of the paper's speed claims."""


def results_table(
    runs: pd.DataFrame, curves: pd.DataFrame, *, targets: Sequence[float] | None = None
) -> pd.DataFrame:
    """Table with a row per method, best mean first: final errors and median costs of targets.

    The gap is the mean error relative to the smallest possible error in the space (`optimum`) if
    the runs record it, else to the best of all these runs; the name of its column says which. It is
    rounded to 1e-6 %, because sums of the loss differ beyond that.

    Parameters
    ----------
    runs, curves : DataFrame
        As in `miho.load_runs`, of one problem.
    targets : sequence of float, optional
        Errors in the unit of the runs; by default the paper's 1 and 0.5 kN for forces, else none.
        The last target is always `NEAR_BEST` times the best error of any method. Success is the
        share of runs that reach it.

    Returns
    -------
    DataFrame
        Seconds are on the clock of `timing.clock_of`, and the names of their columns say which. A
        median is inf ("never") if half of the runs or more did not reach the target. Errors are
        over runs with a finite error; `no value` counts the others.
    """
    runs, curves = one_problem(runs, curves)
    unit, factor = shown_unit(runs["unit"].iloc[0])
    error = runs["error"].where(np.isfinite(runs["error"])) * factor
    grouped = error.groupby(runs["optimizer"])
    table = pd.DataFrame(
        {
            "repetitions": grouped.size(),
            f"mean error [{unit}]": grouped.mean(),
            f"best [{unit}]": grouped.min(),
            f"worst [{unit}]": grouped.max(),
            "no value": grouped.size() - grouped.count(),
        }
    )
    recorded = "optimum" in runs and bool(np.isfinite(runs["optimum"]).all())
    best = runs["optimum" if recorded else "error"].min() * factor
    gap = 100 * (table[f"mean error [{unit}]"] / best - 1) if best > 0 else np.nan
    table[f"gap to {'optimum' if recorded else 'best of all runs'} [%]"] = np.round(gap, 6) + 0.0
    if targets is None:
        targets = PAPER_TARGETS if runs["unit"].iloc[0] == "N" else ()
    nearly = float(runs["error"].min() * NEAR_BEST)
    labels = [*(f"{target * factor:g} {unit}" for target in targets), "best + 1 %"]
    clock = clock_of(runs)
    timed = curves[curves["id"].isin(clock.runs["id"])]
    on_axes: dict[Axis, pd.DataFrame] = {"evaluations": curves, clock.axis: timed}
    for target, label in zip([*targets, nearly], labels, strict=True):
        for axis, rows in on_axes.items():
            reached = to_target(rows, axis, target)
            table[f"{UNITS[axis]} to {label}"] = reached.groupby("optimizer")[axis].median()
    reached = to_target(curves, "evaluations", nearly)
    solved = np.isfinite(reached["evaluations"])
    table["success"] = solved.groupby(reached["optimizer"]).mean()
    return table.sort_values(f"mean error [{unit}]").rename_axis("method").reset_index()
