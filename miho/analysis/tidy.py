"""The two tidy frames on which all analysis is based, and their checks."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pandas as pd

from miho.analysis.variants import named_apart, with_names_of

CURVE_COLUMNS = (
    "id", "problem", "optimizer", "seed", "evaluations", "seconds", "cpu_seconds", "error",
)  # fmt: skip
RUN_COLUMNS = (*CURVE_COLUMNS, "outcome", "unit", "irreducible_low", "irreducible_high")


def require_columns(frame: pd.DataFrame, columns: Collection[str], name: str) -> None:
    """Raise ValueError naming the columns that `frame` lacks."""
    missing = [column for column in columns if column not in frame.columns]
    if missing:
        raise ValueError(
            f"{name} lacks the columns {', '.join(missing)}; it has {', '.join(frame.columns)}"
        )


def one_problem(runs: pd.DataFrame, curves: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Both frames, checked by `comparison` and to contain one problem and unit.

    All settings that differ become part of the method's name, including settings of the data.
    """
    require_columns(runs, RUN_COLUMNS, "runs")
    for column in ("problem", "unit"):
        values = sorted(map(str, runs[column].unique()))
        if len(values) != 1:
            raise ValueError(
                f"runs have {len(values)} different values of {column} ({', '.join(values)}); "
                f"pass the runs of one problem at a time"
            )
    return _checked(named_apart(runs, of_problem=()), curves)


def comparison(runs: pd.DataFrame, curves: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Both frames, checked: one unit per problem, one run per problem, method and seed.

    Runs of one name with different settings get different names, see `named_apart`. The curves are
    sorted by run and evaluations, and complete: a run without a finite error gets one row at its
    end with error NaN, so that no average ignores it.

    Raises ValueError otherwise, also if an error rises within a run, because curves are best so
    far.
    """
    require_columns(runs, RUN_COLUMNS, "runs")
    return _checked(named_apart(runs), curves)


def _checked(runs: pd.DataFrame, curves: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    require_columns(curves, CURVE_COLUMNS, "curves")
    units = runs.groupby("problem")["unit"].nunique()
    if (units > 1).any():
        raise ValueError(
            f"runs of {units.idxmax()} have {units.max()} different units; give problems with "
            f"different units different names"
        )
    twins = runs[runs.duplicated(["problem", "optimizer", "seed"], keep=False)]
    if len(twins):
        first = twins.iloc[0]
        raise ValueError(
            f"runs have several runs of {first['optimizer']} with seed {first['seed']}; "
            f"keep one of each, or the columns of settings that distinguish them"
        )
    strangers = sorted(set(curves["id"].unique()) - set(runs["id"]))
    if strangers:
        raise ValueError(
            f"curves have {len(strangers)} runs that are not in runs, for example {strangers[0]}; "
            f"filter both frames alike"
        )
    curves = with_names_of(curves, runs)
    curves = curves.sort_values(["id", "evaluations"], kind="stable", ignore_index=True)
    rises = (curves["error"].diff() > 0) & (curves["id"] == curves["id"].shift())
    if rises.any():
        raise ValueError(
            f"the error of run {curves['id'][rises].iloc[0]} rises; curves must be best so far"
        )
    return runs, with_silent_runs(runs, curves)


def with_silent_runs(runs: pd.DataFrame, curves: pd.DataFrame) -> pd.DataFrame:
    """The curves, plus one row with error NaN for each run that has none."""
    silent = runs[~runs["id"].isin(curves["id"].unique())]
    if silent.empty:
        return curves
    rows = silent.reindex(columns=curves.columns).assign(error=np.nan)
    return pd.concat([curves, rows], ignore_index=True)


def shown_unit(unit: str) -> tuple[str, float]:
    """The unit in tables and figures and the factor to it: forces are shown in kN."""
    return ("kN", 1e-3) if unit == "N" else (unit, 1.0)
