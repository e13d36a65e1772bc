"""Area over the convergence curve: how good a run is over all budgets up to a given one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.analysis.curves import Axis, positions
from miho.analysis.running_time import references
from miho.analysis.tidy import comparison

Array = NDArray[np.float64]

GAPS = (1e-3, 10.0)
"""Relative gaps to the best known error that score 1 and 0. The lower one is the tightest target
(factor 1.001): what lies beyond is numerics, not identification. The upper one is where random
starts are: within it every target (0.5, 0.1, 0.01, 0.001) is a rise of the score."""


def area_over_curve(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    budget: float | Mapping[str, float] | None = None,
    axis: Axis = "evaluations",
    gaps: tuple[float, float] = GAPS,
) -> pd.DataFrame:
    """The area of each run in [0, 1], more is better: problem, optimizer, seed, budget, aocc.

    The mean over [0, budget], linear in the axis, of

        1 - (log10(clip(gap, low, high)) - log10(low)) / (log10(high) - log10(low)),

    gap = error / best known error - 1 (`running_time.references`), error the best so far, and 0
    before the first value. It is the exact integral of the step function; after its end a run
    keeps its answer. This is the AOCC of van Stein, Vermetten, Kononova and Bäck (2024,
    "Explainable benchmarking for iterative optimization heuristics") for a relative gap: their sum
    over evaluations 1 to budget also counts the last value once, a difference of 1 / budget
    at most.

    `budget` is one number, one for each problem, or by default the most that any run of the
    problem spent.
    """
    low, high = gaps
    if not 0 < low < high:
        raise ValueError(f"gaps is {gaps!r}; expected two rising numbers above zero")
    runs, curves = comparison(runs, curves)
    budgets = _budgets(runs, axis, budget)
    ends = curves["problem"].map(budgets).to_numpy(dtype=float)
    at = np.minimum(positions(curves, axis), ends)
    run = pd.Index(runs["id"]).get_indexer(curves["id"])
    last = np.append(run[1:] != run[:-1], True)
    until = np.where(last, ends, np.append(at[1:], 0.0))
    best = curves["problem"].map(references(runs)["error"]).to_numpy(dtype=float)
    gap = np.clip(curves["error"].to_numpy(dtype=float) / best - 1, low, high)
    score = np.nan_to_num(np.log(high / gap) / np.log(high / low), nan=0.0)
    area = np.bincount(run, weights=(until - at) * score, minlength=len(runs))
    table = runs[["problem", "optimizer", "seed"]].reset_index(drop=True)
    table["budget"] = runs["problem"].map(budgets).to_numpy(dtype=float)
    return table.assign(aocc=area / table["budget"])


def _budgets(
    runs: pd.DataFrame, axis: Axis, budget: float | Mapping[str, float] | None
) -> dict[str, float]:
    spent = runs.groupby("problem")[axis].max()
    if budget is None:
        budget = {str(problem): float(value) for problem, value in spent.items()}
    elif not isinstance(budget, Mapping):
        budget = dict.fromkeys(map(str, spent.index), float(budget))
    for problem in spent.index:
        if not budget.get(problem, 0.0) > 0:
            raise ValueError(
                f"budget of {problem} is {budget.get(problem)}; expected a number above zero for "
                f"each problem, in the unit of {axis}"
            )
    return dict(budget)
