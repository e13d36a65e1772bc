"""Error curves of single runs: step functions of evaluations or seconds.

A run's error is its last improvement carried forward, never interpolated. Before its first value a
run is NaN. After its end the last value is carried forward too: a finished method keeps its answer,
so the curve beyond the end is the available result, not a sign that the method still ran.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import pandas as pd

from miho.analysis.tidy import CURVE_COLUMNS, require_columns
from miho.analysis.variants import setting_columns
from miho.quantities import Array
from miho.validate import one_of

Axis = Literal["seconds", "cpu_seconds", "evaluations"]
AXES: tuple[Axis, ...] = get_args(Axis)

RUN_KEY = ["id", "problem", "optimizer", "seed"]


def log_grid(curves: pd.DataFrame, axis: Axis, points: int = 400) -> Array:
    """`points` positions (points,), evenly spaced in the logarithm, from first to last row."""
    at = positions(curves, axis)
    at = at[at > 0]
    if not at.size:
        raise ValueError(f"curves have no row with {axis} above zero; there is nothing to draw")
    grid = np.geomspace(at.min(), at.max(), points)
    grid[[0, -1]] = at.min(), at.max()
    return grid


def on_grid(curves: pd.DataFrame, axis: Axis, grid: Array | None = None) -> pd.DataFrame:
    """All runs on a common grid: a row per run and grid position.

    All runs have a value at each position, so a mean over runs is well defined: pass these rows,
    not `curves` itself, to a function that averages, for example seaborn's `lineplot`.

    Parameters
    ----------
    curves : DataFrame
        As in `miho.load_runs`.
    axis : {'evaluations', 'seconds', 'cpu_seconds'}
        The axis.
    grid : ndarray of shape (g,), optional
        Positions on the axis; by default `log_grid`.

    Returns
    -------
    DataFrame
        Columns id, problem, optimizer, seed, settings, the axis and error (NaN before the first
        value).
    """
    grid = log_grid(curves, axis) if grid is None else np.asarray(grid, dtype=float)
    at, errors = positions(curves, axis), curves["error"].to_numpy(dtype=float)
    keys = [*RUN_KEY, *setting_columns(curves)]
    of_run = list(curves.groupby("id", sort=False).indices.values())
    table = curves[keys].iloc[[rows[0] for rows in of_run]]
    table = table.loc[table.index.repeat(len(grid))].reset_index(drop=True)
    stepped = [step(at[rows], errors[rows], grid) for rows in of_run]
    on = {axis: np.tile(grid, len(of_run)), "error": np.concatenate([np.empty(0), *stepped])}
    return table.assign(**on)


def step(at: Array, errors: Array, grid: Array) -> Array:
    """The last of `errors` (k,) at or before each grid position (g,); NaN before the first.

    The last of several rows at the same position counts.

    Examples
    --------
    >>> import numpy as np
    >>> from miho.analysis.curves import step
    >>> step(np.array([1.0, 10.0]), np.array([5.0, 2.0]), np.array([0.5, 1.0, 20.0])).tolist()
    [nan, 5.0, 2.0]
    """
    order = np.argsort(at, kind="stable")
    index = np.searchsorted(at[order], grid, side="right")
    return np.concatenate([[np.nan], errors[order]])[index]


def until(grid: Array, end: float) -> slice:
    """Positions of a grid (g,) up to the first one at or after `end`, which has a run's last row.

    Examples
    --------
    >>> import numpy as np
    >>> from miho.analysis.curves import until
    >>> grid = np.array([1.0, 2.0, 4.0, 8.0])
    >>> grid[until(grid, 3.0)].tolist()
    [1.0, 2.0, 4.0]
    """
    return slice(0, int(np.searchsorted(grid, end)) + 1)


def summary(
    gridded: pd.DataFrame, axis: Axis, quantiles: tuple[float, float] = (0.1, 0.9)
) -> pd.DataFrame:
    """Runs, mean, median and quantiles per method and grid position.

    All statistics are NaN until every run of the method has a value: otherwise they would describe
    a changing set of runs. The mean is the paper's curve (Fig. 6).

    Parameters
    ----------
    gridded : DataFrame
        As from `on_grid`. A method whose runs differ in a setting counts as several methods.
    axis : {'evaluations', 'seconds', 'cpu_seconds'}
        The axis of the grid.
    quantiles : tuple of float
        Levels of the low and the high quantile.

    Returns
    -------
    DataFrame
        Columns problem, optimizer, settings, the axis, runs, mean, median, low and high.
    """
    pieces = []
    keys = ["problem", "optimizer", *setting_columns(gridded)]
    for values, group in gridded.groupby(keys, sort=False, dropna=False):
        wide = group.pivot(index="id", columns=axis, values="error")
        errors = wide.to_numpy(dtype=float)
        low, median, high = np.quantile(errors, [quantiles[0], 0.5, quantiles[1]], axis=0)
        pieces.append(
            pd.DataFrame(
                {
                    **dict(zip(keys, values, strict=True)),
                    axis: wide.columns.to_numpy(dtype=float),
                    "runs": len(errors),
                    "mean": errors.mean(axis=0),
                    "median": median,
                    "low": low,
                    "high": high,
                }
            )
        )
    return pd.concat(pieces, ignore_index=True)


def to_target(curves: pd.DataFrame, axis: Axis, target: float | Array) -> pd.DataFrame:
    """First position of each run with an error of at most `target`; inf if there is none.

    Parameters
    ----------
    curves : DataFrame
        As in `miho.load_runs`. Runs without rows are missing in the result: see
        `tidy.with_silent_runs`.
    axis : {'evaluations', 'seconds', 'cpu_seconds'}
        The axis.
    target : float or ndarray of shape (rows,)
        Error in the unit of the curves, for all rows or for each row.

    Returns
    -------
    DataFrame
        A row per run: id, problem, optimizer, seed, settings and the axis.
    """
    at = pd.Series(positions(curves, axis), index=curves.index)
    reached = at.where(curves["error"] <= target, np.inf)
    firsts = reached.groupby(curves["id"], sort=False).min()
    runs = curves.drop_duplicates("id")[[*RUN_KEY, *setting_columns(curves)]]
    return runs.assign(**{axis: runs["id"].map(firsts)}).reset_index(drop=True)


def positions(curves: pd.DataFrame, axis: Axis) -> Array:
    """The column of the axis (rows,)."""
    one_of("axis", axis, AXES)
    require_columns(curves, [*CURVE_COLUMNS, axis], "curves")
    return curves[axis].to_numpy(dtype=float)
