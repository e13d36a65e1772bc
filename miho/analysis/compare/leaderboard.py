"""Tables of results: a row per method over all problems, and on one problem, best first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from miho.analysis.compare.profiles import area_over_curve
from miho.analysis.compare.running_time import at_factor, hits, running_times
from miho.analysis.compare.significance import ranks
from miho.analysis.curves import Axis, to_target
from miho.analysis.tidy import one_problem, shown_unit
from miho.analysis.timing import UNITS, clock_of, undisturbed

RANKED, STRICT = 1.01, 1.001


def leaderboard(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    *,
    factor: float = RANKED,
    strict: float = STRICT,
    axis: Axis = "evaluations",
    budget: float | Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """A row per method, best mean rank first.

    - mean rank: over problems, of `problem_scores` at `factor`
    - by families: the same over families of problems, of `family_scores`, where runs have the
      column `family`, equal for problems that are alike
    - solved: problems on which any run reached the factor, of all problems
    - success: share of runs that did, and that reached the `strict` one
    - times the best: expected running time over that of the best method, geometric mean over the
      problems that the method solves; read it beside solved
    - AOCC: `area_over_curve` up to `budget`, mean over problems
    - cut by seconds: share of runs that the cap in seconds ended before their evaluations were
      spent and before they ended by themselves, where runs have the column `cut` that says so
    - µs per evaluation: seconds over evaluations of whole runs, the loss included, median over
      runs that nothing disturbed, NaN without any

    A method that was not run on a problem has not solved it. Success is over the runs it has.
    """
    reached = hits(runs, curves, (factor, strict))
    areas = area_over_curve(runs, curves, budget, axis)
    ert = running_times(reached, axis)
    scores = problem_scores(ert, areas, factor)
    solved = at_factor(ert, factor)
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
            for f in (factor, strict)
        },
        **{"times the best": np.exp(ratios)},
        AOCC=per_problem.unstack().reindex(scores.index).fillna(0.0).mean(),
        **cut,
        **{"µs per evaluation": pace.groupby(runs["optimizer"]).median()},
    )
    table = table.rename(columns={"solved": f"solved of {len(scores)}"})
    return table.rename_axis("method").reset_index()


def problem_scores(ert: pd.DataFrame, areas: pd.DataFrame | None, factor: float) -> pd.DataFrame:
    """Scores (problems, methods) that rank all methods, lower is better; for ranks and tests.

    The logarithm (base 10) of the expected running time at `factor` where it is finite. Where a
    method never got there: one more than the largest finite score of the problem (than 0 if there
    is none), so that every method that solves a problem is ahead of every one that does not, by at
    least a factor of ten. With `areas` 1 - the mean area over the curve is added to that: a
    tie-break by another measure than the running time, so a test of running times does without. A
    method that was not run on a problem has area 0 there.
    """
    at = at_factor(ert, factor).pivot(index="problem", columns="optimizer", values="ert")
    logs = at.where(np.isfinite(at)).map(np.log10)
    behind = pd.DataFrame(0.0, index=logs.index, columns=logs.columns)
    if areas is not None:
        area = areas.groupby(["problem", "optimizer"])["aocc"].mean().unstack()
        behind = 1 - area.reindex_like(logs).fillna(0.0)
    return logs.fillna(behind.add(logs.max(axis=1).fillna(0.0) + 1, axis=0))


def best_rivals(ert: Mapping[Axis, pd.DataFrame], method: str, factor: float) -> pd.DataFrame:
    """A method beside the best of all others on each problem, a row per problem.

    For each axis of `ert` (expected running times by axis) four columns: of the method; of the
    rival that spends least; by which; and share, the first over the second, 0 where no rival
    arrives, inf where the method does not, 1 where nobody does. On different axes the best rivals
    may be different ones. The rival is chosen by these very runs, so it looks better than it is.
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
    """The family of each problem, by the column `family`."""
    return dict(zip(runs["problem"], runs["family"], strict=True))


def family_scores(scores: pd.DataFrame, families: Mapping[str, str]) -> pd.DataFrame:
    """Scores (families, methods): the mean of the scores of each family's problems.

    Problems that are one model in one kind of box are no independent sample: ranked one by one,
    what suits that model would count once for each of them, and tests would take repetition for
    evidence. The mean of `problem_scores`, which are logarithms, is that of the geometric mean of
    expected running times where a method solves the whole family; a problem that it does not
    solve counts with at least ten times what the slowest method that does spends there.
    """
    return scores.groupby(scores.index.map(families), sort=False).mean().rename_axis("family")


PAPER_TARGETS = (1000.0, 500.0)
"""Errors [N] of the paper's speed claims."""


def results_table(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    *,
    targets: Sequence[float] | None = None,
    near_best: float = 0.01,
) -> pd.DataFrame:
    """A row per method, best mean first: final errors, medians of what the targets cost.

    `targets` are errors in the unit of the runs; by default the paper's 1 and 0.5 kN where that is
    a force, none elsewhere. The last target is within `near_best` of the best error any method has
    seen on this problem, and success is the share of runs that reach it. Seconds are those of
    `timing.clock_of`, and their columns say which. A median is inf ("never") when half of the runs
    or more did not get there. Errors are over the runs that saw a finite one; `no value` counts the
    others.

    The gap is that of the mean error to the smallest possible in the space, where the runs know it
    (`optimum`, in closed form), else to the best of all these runs, and its column says which. It
    is rounded to 1e-6 %, beyond which the sums of the loss differ.
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
    nearly = float(runs["error"].min() * (1 + near_best))
    labels = [f"{target * factor:g} {unit}" for target in targets]
    labels.append(f"best + {near_best * 100:g} %")
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
