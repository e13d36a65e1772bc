"""What each method reached and what it spent: one row per method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from miho.analysis.curves import Axis, to_target
from miho.analysis.tidy import one_problem, shown_unit
from miho.analysis.timing import UNITS, clock_of

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
    known = "optimum" in runs and bool(np.isfinite(runs["optimum"]).all())
    best = runs["optimum" if known else "error"].min() * factor
    gap = 100 * (table[f"mean error [{unit}]"] / best - 1) if best > 0 else np.nan
    table[f"gap to {'optimum' if known else 'best of all runs'} [%]"] = np.round(gap, 6) + 0.0
    if targets is None:
        targets = PAPER_TARGETS if runs["unit"].iloc[0] == "N" else ()
    nearly = float(runs["error"].min() * (1 + near_best))
    labels = [f"{target * factor:g} {unit}" for target in targets]
    labels.append(f"best + {near_best * 100:g} %")
    clock = clock_of(runs)
    timed = curves[curves["id"].isin(clock.runs["id"])]
    shown: dict[Axis, pd.DataFrame] = {"evaluations": curves, clock.axis: timed}
    for target, label in zip([*targets, nearly], labels, strict=True):
        for axis, rows in shown.items():
            reached = to_target(rows, axis, target)
            table[f"{UNITS[axis]} to {label}"] = reached.groupby("optimizer")[axis].median()
    reached = to_target(curves, "evaluations", nearly)
    solved = np.isfinite(reached["evaluations"])
    table["success"] = solved.groupby(reached["optimizer"]).mean()
    return table.sort_values(f"mean error [{unit}]").rename_axis("method").reset_index()
