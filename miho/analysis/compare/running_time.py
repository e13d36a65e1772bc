"""Expected running time: the cost, including restarts, until a method reaches a target.

A target is a factor times the best known error of its problem. Runs that do not reach it are costs
without success. A method that ended by itself before its budget could be restarted, so only its
actual cost counts.

References
----------
A. Auger and N. Hansen, "Performance evaluation of an advanced local search evolutionary algorithm",
CEC 2005. N. Hansen et al., "COCO: a platform for comparing continuous optimizers in a black-box
setting", 2021.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.analysis.compare.bootstrap import RESAMPLES, interval, resample
from miho.analysis.curves import AXES, Axis, to_target
from miho.analysis.tidy import comparison, require_columns
from miho.quantities import Array

NEAR_BEST = 1.01
"""A run succeeds if its error is at most this factor times the best known error."""
FACTORS = (1.5, 1.1, NEAR_BEST, 1.001)
GROUP = ["problem", "optimizer", "factor"]
ROUNDING = 1e-9
"""Relative difference of two errors that another order of summation explains."""


def references(runs: pd.DataFrame) -> pd.DataFrame:
    """The best known error of each problem (index) in its unit, and its source.

    The columns are error and source. The source is "known" if runs have an `optimum`, and "best of
    all runs" if they do not or if a run is below it by more than ROUNDING (relative). Raises
    ValueError if that error is not above zero, because multiples of it would be meaningless.
    """
    require_columns(runs, ["problem", "error"], "runs")
    best = runs.groupby("problem")["error"].min()
    recorded = runs.groupby("problem")["optimum"].min() if "optimum" in runs else best * np.nan
    trusted = recorded.notna() & ~(best < recorded * (1 - ROUNDING))
    error = recorded.where(trusted, best)
    for problem, value in error.items():
        if not 0 < value < math.inf:
            raise ValueError(
                f"the best known error of {problem} is {value}; targets need a number above zero, "
                f"so exclude this problem"
            )
    source = trusted.map({True: "known", False: "best of all runs"})
    return pd.DataFrame({"error": error, "source": source})


def hits(
    runs: pd.DataFrame, curves: pd.DataFrame, factors: Sequence[float] = FACTORS
) -> pd.DataFrame:
    """When each run first has an error of at most each factor times the best known error.

    Parameters
    ----------
    runs, curves : DataFrame
        As in `miho.load_runs`.
    factors : sequence of float
        Multiples of the best known error of `references`.

    Returns
    -------
    DataFrame
        A row per run and factor: problem, optimizer, seed, factor, target (error in the problem's
        unit), evaluations, seconds and cpu_seconds until the target (inf if never),
        spent_evaluations, spent_seconds and spent_cpu_seconds (of the whole run), reached.

    Raises
    ------
    ValueError
        For a factor below 1.
    """
    for factor in factors:
        if not 1 <= factor < math.inf:
            raise ValueError(f"factor is {factor!r}; expected a finite number of at least 1")
    runs, curves = comparison(runs, curves)
    best = references(runs)["error"]
    targets = runs["problem"].map(best)
    row_targets = curves["problem"].map(best).to_numpy(dtype=float)
    pieces = []
    for factor in factors:
        piece = runs[["problem", "optimizer", "seed"]].assign(factor=factor)
        piece["target"] = factor * targets
        for axis in AXES:
            first = to_target(curves, axis, factor * row_targets).set_index("id")[axis]
            piece[axis] = runs["id"].map(first)
        for axis in AXES:
            piece[f"spent_{axis}"] = runs[axis].astype(float)
        pieces.append(piece)
    table = pd.concat(pieces, ignore_index=True)
    return table.assign(reached=np.isfinite(table["evaluations"]))


def running_times(hits: pd.DataFrame, axis: Axis) -> pd.DataFrame:
    """Per problem, optimizer and factor: runs, success, ert and median, in the unit of the axis.

    `success` is the share of runs that reach the target. `ert` is the cost of all runs until
    success or end, divided by the number of successes; inf if there is none. `median` is the median
    cost until success; inf if half of the runs or more do not reach the target.
    """
    hits = _ordered(hits, axis)
    table = hits.assign(cost=_cost(hits, axis)).groupby(GROUP)
    successes = table["reached"].sum().to_numpy(dtype=float)
    frame = pd.DataFrame({"runs": table.size(), "success": table["reached"].mean()})
    frame["ert"] = _ratio(table["cost"].sum().to_numpy(dtype=float), successes)
    frame["median"] = table[axis].median()
    return frame.reset_index()


def expected_running_time(
    hits: pd.DataFrame, axis: Axis, rng: np.random.Generator, resamples: int = RESAMPLES
) -> pd.DataFrame:
    """Expected running time of each method to each target, with bootstrap intervals.

    Parameters
    ----------
    hits : DataFrame
        As from `hits`.
    axis : {'evaluations', 'seconds', 'cpu_seconds'}
        The cost of a run.
    rng : numpy.random.Generator
        Draws the resamples of the runs.
    resamples : int, optional
        Number of resamples.

    Returns
    -------
    DataFrame
        As from `running_times`, with the 95 % percentile interval of ert from `low` to `high`. A
        resample without a success has an expected running time of inf.
    """
    table = running_times(hits, axis)
    _, values = resampled(hits, axis, rng, resamples)
    bounds = [interval(replicates, replicates) for replicates in values]
    table["low"] = [bound.low for bound in bounds]
    table["high"] = [bound.high for bound in bounds]
    return table[[*GROUP, "runs", "success", "ert", "low", "high", "median"]]


def resampled(
    hits: pd.DataFrame, axis: Axis, rng: np.random.Generator, resamples: int = RESAMPLES
) -> tuple[pd.DataFrame, Array]:
    """Expected running times (groups, 1 + resamples) of resampled runs, and the groups' names.

    Column 0 contains the actual runs. Groups are sorted as in `running_times`. Groups with equally
    many runs share their draws, so that methods are compared on the same seeds.
    """
    hits = _ordered(hits, axis)
    sizes = hits.groupby(GROUP).size()
    first = np.cumsum(sizes.to_numpy()) - sizes.to_numpy()
    cost, reached = _cost(hits, axis), hits["reached"].to_numpy(dtype=float)
    values = np.empty((sizes.size, 1 + resamples))
    for size in np.unique(sizes):
        groups = np.flatnonzero(sizes == size)
        rows = first[groups, None] + np.arange(size)
        weights = _times_drawn(resample(size, rng, resamples)).T
        values[groups] = _ratio(cost[rows] @ weights, reached[rows] @ weights)
    return sizes.index.to_frame(index=False), values


def at_factor(frame: pd.DataFrame, factor: float) -> pd.DataFrame:
    """The rows of one factor; raises ValueError if there are none."""
    rows = frame[frame["factor"] == factor]
    if rows.empty:
        present = ", ".join(f"{value:g}" for value in sorted(frame["factor"].unique()))
        raise ValueError(f"factor is {factor!r}; the frame has {present or 'no rows'}")
    return rows


def _ordered(hits: pd.DataFrame, axis: Axis) -> pd.DataFrame:
    require_columns(hits, [*GROUP, "seed", axis, f"spent_{axis}", "reached"], "hits")
    return hits.sort_values([*GROUP, "seed"], kind="stable", ignore_index=True)


def _cost(hits: pd.DataFrame, axis: Axis) -> Array:
    return np.where(hits["reached"], hits[axis], hits[f"spent_{axis}"]).astype(float)


def _ratio(total: Array, successes: Array) -> Array:
    ratio = np.full(total.shape, np.inf)
    np.divide(total, successes, out=ratio, where=successes > 0)
    return ratio


def _times_drawn(picks: NDArray[np.intp]) -> Array:
    """How often each of n runs is drawn (m, n) in each row of `picks` (m, n)."""
    rows, size = picks.shape
    flat = (picks + size * np.arange(rows)[:, None]).ravel()
    return np.bincount(flat, minlength=rows * size).reshape(rows, size).astype(float)
