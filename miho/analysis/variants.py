"""Distinguish runs of one method that differ in a setting by names such as `miho R=300`.

All functions that draw, average or judge use the columns `problem` and `optimizer`, so runs with
different settings are never pooled.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import pandas as pd

from miho.study.settings import DATA, is_setting

OF_PROBLEM = ("model", "loss", "dataset", DATA)
"""Groups of settings that define another problem; all others define another method."""
LONGEST = 40
"""Characters of a value in a name; the last ones are kept, because paths differ at their ends."""


def setting_columns(frame: pd.DataFrame) -> list[str]:
    """The columns of runs or curves that are settings."""
    return [str(column) for column in frame.columns if is_setting(str(column))]


def named_apart(runs: pd.DataFrame, *, of_problem: Collection[str] = OF_PROBLEM) -> pd.DataFrame:
    """Add settings that differ under one name to the columns `problem` and `optimizer` of `runs`.

    `runs` are runs or curves with the columns of settings of `miho.load_runs`. Settings of the
    groups `of_problem` define another problem; without groups, all runs are to be compared. A
    second call changes nothing.
    """
    columns = setting_columns(runs)
    if not columns:
        return runs
    problem = [column for column in columns if column.partition(".")[0] in of_problem]
    method = [column for column in columns if column not in problem]
    problems = _labelled(runs["problem"], [], runs[problem])
    return runs.assign(
        problem=problems, optimizer=_labelled(runs["optimizer"], [problems], runs[method])
    )


def base_name(name: str) -> str:
    """The name of a method without the settings that `named_apart` adds."""
    return name.partition(" ")[0]


def with_names_of(curves: pd.DataFrame, runs: pd.DataFrame) -> pd.DataFrame:
    """`curves` with the problems and methods that `runs` have under the same id."""
    names = runs.set_index("id")
    return curves.assign(**{key: curves["id"].map(names[key]) for key in ("problem", "optimizer")})


def _labelled(names: pd.Series, within: Sequence[pd.Series], settings: pd.DataFrame) -> pd.Series:
    """Each name, followed by the settings that vary under it within a group of `within`."""
    if settings.empty:
        return names
    groups = settings.groupby([*within, names], sort=False)
    varies = (groups.nunique(dropna=False) > 1).groupby(level=-1).any()
    columns = list(map(str, settings.columns))
    flags = varies.to_dict("index").items()
    varying = {str(name): [column for column in columns if row[column]] for name, row in flags}
    if not any(varying.values()):
        return names
    rows = zip(names, settings.to_dict("records"), strict=True)
    return pd.Series([_label(name, varying[name], row) for name, row in rows], names.index)


def _label(name: str, columns: Sequence[str], settings: Mapping[Any, Any]) -> str:
    short = [column.partition(".")[2] or column for column in columns]  # without the group
    parts = [
        f"{key if short.count(key) == 1 else column}={shown(settings[column])}"
        for column, key in zip(columns, short, strict=True)
    ]
    return f"{name} {', '.join(parts)}" if parts else name


def shown(value: Any) -> str:
    """A setting as text: whole numbers without a decimal point, "-" for none."""
    if value is None or value != value:
        return "-"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    return str(value)[-LONGEST:]
