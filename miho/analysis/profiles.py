"""Shares of targets reached: runtime distributions, data profiles and performance profiles.

A share is over what the method was run on; a target that it never reached counts, a run that was
never made does not. All are step functions of their column, to be drawn without interpolation.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.analysis.curves import Axis
from miho.analysis.running_time import at_factor
from miho.analysis.tidy import require_columns

Array = NDArray[np.float64]

POINTS = 400


def ecdf(
    hits: pd.DataFrame,
    axis: Axis,
    grid: Array | None = None,
    dimensions: Mapping[str, int] | None = None,
) -> pd.DataFrame:
    """Share of all (problem, seed, factor) reached within each budget: optimizer, axis, share.

    The runtime distribution of COCO (Hansen et al. 2021) over the runs as they are, without its
    simulated restarts: a curve ends at the share that was reached. With `dimensions` (problem to
    number of parameters) the axis is per parameter, as COCO draws it.
    """
    require_columns(hits, ["problem", "optimizer", axis], "hits")
    spent = hits[axis].astype(float)
    if dimensions is not None:
        spent = spent / _of_problems(dimensions, hits["problem"])
    return _shares(spent, hits["optimizer"], axis, grid)


def data_profile(
    hits: pd.DataFrame, dimensions: Mapping[str, int], factor: float, grid: Array | None = None
) -> pd.DataFrame:
    """Share of (problem, seed) solved to a factor within kappa (d + 1) evaluations.

    Columns: optimizer, kappa, share. Moré and Wild 2009, "Benchmarking derivative-free
    optimization algorithms"; solved means an error of at most factor times the best
    known one, not their reduction from the starting point.
    """
    rows = at_factor(hits, factor)
    kappa = rows["evaluations"] / (_of_problems(dimensions, rows["problem"]) + 1)
    return _shares(kappa, rows["optimizer"], "kappa", grid)


def performance_profile(
    ert: pd.DataFrame, factor: float, grid: Array | None = None
) -> pd.DataFrame:
    """Share of problems whose expected running time is within tau times the best method's.

    Columns: optimizer, tau, share. Dolan and Moré 2002, "Benchmarking optimization software with
    performance profiles". The share at tau = 1 is that of problems on which the method is the
    fastest. A problem that nobody solves stays in the count. The ratios depend on who takes part:
    take no order but the best from it (Gould and Scott 2016).
    """
    rows = at_factor(ert, factor)
    best = rows.groupby("problem")["ert"].transform("min")
    tau = (rows["ert"] / best.where(np.isfinite(best))).fillna(np.inf)
    return _shares(tau, rows["optimizer"], "tau", grid)


def _shares(
    values: pd.Series[float], optimizers: pd.Series[str], name: str, grid: Array | None
) -> pd.DataFrame:
    """Share of each method's values that are at most each grid position."""
    grid = _log_grid(np.asarray(values, dtype=float)) if grid is None else grid
    pieces = []
    for optimizer, mine in values.groupby(optimizers):
        within = np.searchsorted(np.sort(mine.to_numpy(dtype=float)), grid, side="right")
        share = within / len(mine)
        pieces.append(pd.DataFrame({"optimizer": optimizer, name: grid, "share": share}))
    return pd.concat(pieces, ignore_index=True)


def _log_grid(values: Array) -> Array:
    """From the smallest to the largest finite value above zero; [1] if there is none."""
    values = values[np.isfinite(values) & (values > 0)]
    if not values.size:
        return np.ones(1)
    grid = np.geomspace(values.min(), values.max(), POINTS)
    grid[[0, -1]] = values.min(), values.max()
    return grid


def _of_problems(dimensions: Mapping[str, int], problems: pd.Series[str]) -> Array:
    missing = sorted(set(problems) - set(dimensions))
    if missing:
        raise ValueError(f"dimensions lack the problem {missing[0]}; give one for each problem")
    return np.asarray(problems.map(dict(dimensions)), dtype=float)
