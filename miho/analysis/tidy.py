"""The two tidy frames that everything here is a function of, and the checks they must pass."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pandas as pd

CURVE_COLUMNS = ("id", "problem", "optimizer", "seed", "evaluations", "seconds", "error")
RUN_COLUMNS = (*CURVE_COLUMNS, "outcome", "unit", "irreducible")


def require_columns(frame: pd.DataFrame, columns: Collection[str], name: str) -> None:
    """Raise ValueError naming the columns that `frame` lacks."""
    missing = [column for column in columns if column not in frame.columns]
    if missing:
        raise ValueError(
            f"{name} lacks the columns {', '.join(missing)}; it has {', '.join(frame.columns)}"
        )


def one_problem(runs: pd.DataFrame, curves: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Both frames, checked to be one comparison: one problem and unit, one run per method and seed.

    The curves come back sorted by run and evaluations, and complete: a run that never saw a
    finite error gets one row, at its end, whose error is NaN, so that no average forgets it.
    Raises ValueError otherwise, also when an error rises within a run: curves are best so far.
    """
    require_columns(runs, RUN_COLUMNS, "runs")
    require_columns(curves, CURVE_COLUMNS, "curves")
    for column in ("problem", "unit"):
        found = sorted(map(str, runs[column].unique()))
        if len(found) != 1:
            raise ValueError(
                f"runs hold {len(found)} different values of {column} ({', '.join(found)}); "
                f"pass the runs of one problem at a time"
            )
    twins = runs[runs.duplicated(["optimizer", "seed"], keep=False)]
    if len(twins):
        first = twins.iloc[0]
        raise ValueError(
            f"runs hold several runs of {first['optimizer']} with seed {first['seed']}; "
            f"keep one configuration per method, or give the variants different names"
        )
    strangers = sorted(set(curves["id"]) - set(runs["id"]))
    if strangers:
        raise ValueError(
            f"curves hold {len(strangers)} runs that are not in runs, such as {strangers[0]}; "
            f"filter both frames alike"
        )
    curves = curves.sort_values(["id", "evaluations"], kind="stable", ignore_index=True)
    rises = (curves["error"].diff() > 0) & (curves["id"] == curves["id"].shift())
    if rises.any():
        raise ValueError(
            f"the error of run {curves['id'][rises].iloc[0]} rises; curves hold the best so far"
        )
    return runs, with_silent_runs(runs, curves)


def with_silent_runs(runs: pd.DataFrame, curves: pd.DataFrame) -> pd.DataFrame:
    """The curves, plus one row with error NaN for each run that has none."""
    silent = runs[~runs["id"].isin(curves["id"])]
    if silent.empty:
        return curves
    rows = silent.reindex(columns=curves.columns).assign(error=np.nan)
    return pd.concat([curves, rows], ignore_index=True)


def shown_unit(unit: str) -> tuple[str, float]:
    """The unit that tables and figures print, and the factor to it: forces are shown in kN."""
    return ("kN", 1e-3) if unit == "N" else (unit, 1.0)
