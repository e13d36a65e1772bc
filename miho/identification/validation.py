"""Does the model hold beyond the rows it was fitted to, and what do its errors still follow?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.identification.curve_fit import CurveFit
from miho.identification.refit import refit

Array = NDArray[np.float64]

MOST_LEVELS = 12
"""A condition with more distinct values than this is split into BINS groups of equal size."""
BINS = 5
FINE = 15
"""Groups of the first input, finer because the errors may wave along it."""


def root_mean_square(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def error_on(problem: CurveFit, theta: Array, dataset: Dataset) -> float:
    """Root-mean-square error of the model on other data of the same columns."""
    return root_mean_square(replace(problem, dataset=dataset).errors(theta))


def conditions(problem: CurveFit) -> list[str]:
    """The columns that say under which conditions a row was taken: all but output and slip.

    For a model of one input, every other column; for one of several, all but its first input.
    """
    first = next(iter(problem.model.inputs))
    return [name for name in problem.dataset.columns if name not in (first, problem.dataset.output)]


def groups(values: Array, bins: int = BINS) -> NDArray[np.intp]:
    """Which group each row belongs to, (N,): its level, or one of `bins` with as many rows each."""
    levels, index = np.unique(values, return_inverse=True)
    if levels.size <= MOST_LEVELS:
        return np.asarray(index)
    edges = np.quantile(values, np.linspace(0, 1, bins + 1)[1:-1])
    return np.searchsorted(edges, values, side="right")


def leave_one_out(problem: CurveFit, theta: Array, condition: str) -> pd.DataFrame:
    """Fit without one group of a condition, and the error on that group; a row per group.

    Columns: condition, from, to (of the group, in the condition's unit), rows, error of all rows
    on the group, error of the fit that has not seen it (both in the output's unit).
    """
    dataset = problem.dataset
    values = dataset[condition]
    index = groups(values)
    rows = []
    for group in np.unique(index):
        out = index == group
        if out.all() or len(dataset) - out.sum() <= len(problem.space):
            continue
        found = refit(problem, theta, (~out).astype(float)).theta
        rows.append(
            {
                "condition": condition,
                "from": values[out].min(),
                "to": values[out].max(),
                "rows": int(out.sum()),
                "error when seen": root_mean_square(problem.errors(theta)[out]),
                "error when left out": root_mean_square(problem.errors(found)[out]),
            }
        )
    return pd.DataFrame(rows)


def residual_trends(problem: CurveFit, theta: Array) -> pd.DataFrame:
    """How much of the errors' variance each column explains, by the means of groups of rows.

    The first input stands alone; another column together with it, because what a load does to
    the force has the sign of the slip. Columns: column, whether it is an input, explained (0 to
    1; epsilon squared, which is 0 on average where nothing is to be explained). What a column that
    is not an input explains is error no fit of this model can remove.
    """
    errors, dataset = problem.errors(theta), problem.dataset
    first = next(iter(problem.model.inputs))
    slip = groups(dataset[first], FINE)
    alone = _explained(errors, slip)
    rows = [(first, "yes", alone)]
    for name in conditions(problem):
        both = _explained(errors, slip * (MOST_LEVELS + 1) + groups(dataset[name]))
        is_input = "yes" if name in problem.model.inputs else "no"
        rows.append((name, is_input, max(0.0, both - alone)))
    return pd.DataFrame(rows, columns=["column", "an input", "explained"])


def _explained(errors: Array, index: NDArray[np.intp]) -> float:
    """Epsilon squared of a grouping of the errors (Kelley 1935); 0 if it cannot be told."""
    count = np.bincount(index)
    count, sums = count[count > 0], np.bincount(index, errors)[count > 0]
    n, k = errors.size, count.size
    total = float(np.sum((errors - errors.mean()) ** 2))
    if k < 2 or n <= k or total == 0:
        return 0.0
    between = float(np.sum(sums**2 / count)) - n * float(errors.mean()) ** 2
    within = (total - between) / (n - k)
    return max(0.0, (between - (k - 1) * within) / total)
