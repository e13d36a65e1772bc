"""Share of targets reached over the cost: runtime distributions, profiles, and the area (AOCC).

A share is over the runs of a method: a target that it never reached counts, a missing run does not.
All shares are step functions of their column, to be drawn without interpolation. The area over the
convergence curve measures the quality of a run over all budgets up to a given one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from miho.analysis.compare.running_time import at_factor, references
from miho.analysis.curves import Axis, positions
from miho.analysis.tidy import comparison, require_columns
from miho.quantities import Array

POINTS = 400


def ecdf(hits: pd.DataFrame, axis: Axis, grid: Array | None = None) -> pd.DataFrame:
    """Share of all (problem, seed, factor) reached within each budget.

    This is the runtime distribution of COCO (Hansen et al. 2021) over the actual runs, without
    simulated restarts: a curve ends at the share that was reached.

    Parameters
    ----------
    hits : DataFrame
        As from `running_time.hits`.
    axis : {'evaluations', 'seconds', 'cpu_seconds'}
        The axis.
    grid : ndarray, optional
        Budgets; by default evenly spaced in the logarithm.

    Returns
    -------
    DataFrame
        Columns optimizer, the axis and share.
    """
    require_columns(hits, ["problem", "optimizer", axis], "hits")
    return _shares(hits[axis].astype(float), hits["optimizer"], axis, grid)


def data_profile(
    hits: pd.DataFrame, dimensions: Mapping[str, int], factor: float, grid: Array | None = None
) -> pd.DataFrame:
    """Share of (problem, seed) solved to a factor within kappa (d + 1) evaluations.

    Solved means an error of at most factor times the best known error, not a reduction from the
    starting point as in the reference.

    Parameters
    ----------
    hits : DataFrame
        As from `running_time.hits`.
    dimensions : mapping of str to int
        Number of parameters d of each problem.
    factor : float
        Target, as a multiple of the best known error.
    grid : ndarray, optional
        Values of kappa; by default a logarithmic grid over all of them.

    Returns
    -------
    DataFrame
        Columns optimizer, kappa and share.

    References
    ----------
    J. J. Moré and S. M. Wild, "Benchmarking derivative-free optimization algorithms", 2009.
    """
    rows = at_factor(hits, factor)
    kappa = rows["evaluations"] / (_of_problems(dimensions, rows["problem"]) + 1)
    return _shares(kappa, rows["optimizer"], "kappa", grid)


def performance_profile(
    ert: pd.DataFrame, factor: float, grid: Array | None = None
) -> pd.DataFrame:
    """Share of problems whose expected running time is within tau times the best method's.

    The share at tau = 1 is the share of problems on which the method is the fastest. A problem that
    no method solves is counted. The ratios depend on the methods that take part, so only the best
    method can be read from a profile, not an order of the others (Gould and Scott 2016).

    Parameters
    ----------
    ert : DataFrame
        As from `running_time.expected_running_time`.
    factor : float
        Target, as a multiple of the best known error.
    grid : ndarray, optional
        Values of tau; by default a logarithmic grid over all of them.

    Returns
    -------
    DataFrame
        Columns optimizer, tau and share.

    References
    ----------
    E. D. Dolan and J. J. Moré, "Benchmarking optimization software with performance profiles",
    2002.
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
    for optimizer, of_method in values.groupby(optimizers):
        within = np.searchsorted(np.sort(of_method.to_numpy(dtype=float)), grid, side="right")
        share = within / len(of_method)
        pieces.append(pd.DataFrame({"optimizer": optimizer, name: grid, "share": share}))
    return pd.concat(pieces, ignore_index=True)


def _log_grid(values: Array) -> Array:
    """Grid from the smallest to the largest finite value above zero; [1] if there is none."""
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


GAPS = (1e-3, 10.0)
"""Relative gaps to the best known error that score 1 and 0. The lower gap is the tightest target
(factor 1.001): smaller gaps are numerical, not a matter of identification. Random starts reach the
upper gap: within it every target (0.5, 0.1, 0.01, 0.001) raises the score."""


def area_over_curve(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    budget: float | Mapping[str, float] | None = None,
    axis: Axis = "evaluations",
) -> pd.DataFrame:
    """Area over the curve of the error of each run, in [0, 1]; more is better.

    It is the mean over [0, budget], linear in the axis, of

        1 - (log10(clip(gap, low, high)) - log10(low)) / (log10(high) - log10(low)),

    with gap = error / best known error - 1 (`running_time.references`) and the best error so far,
    and 0 before the first value. It is the exact integral of the step function; a run keeps its
    last value after its end. This is the AOCC of the reference for a relative gap; its sum over
    evaluations 1 to budget also counts the last value once, a difference of at most 1 / budget.

    Parameters
    ----------
    runs, curves : DataFrame
        As in `miho.load_runs`.
    budget : float or mapping of str to float, optional
        Upper end of the axis, for all problems or by problem. By default the largest cost of any
        run of the problem.
    axis : {'evaluations', 'seconds', 'cpu_seconds'}, optional
        The axis.

    Returns
    -------
    DataFrame
        Columns problem, optimizer, seed, budget and aocc, with a row per run.

    References
    ----------
    N. van Stein, D. Vermetten, A. V. Kononova and T. Bäck, "Explainable benchmarking for iterative
    optimization heuristics", 2024.
    """
    low, high = GAPS
    runs, curves = comparison(runs, curves)
    budgets = _budgets(runs, axis, budget)
    ends = curves["problem"].map(budgets).to_numpy(dtype=float)
    at = np.minimum(positions(curves, axis), ends)
    run = pd.Index(runs["id"]).get_indexer(curves["id"])
    is_last = np.append(run[1:] != run[:-1], True)
    until = np.where(is_last, ends, np.append(at[1:], 0.0))
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
