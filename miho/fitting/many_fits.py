"""Thousands of small fits of one model in one call, without a search or a report for each."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.fitting.arguments import by_label, data_of, model_of, space_of
from miho.fitting.datasets import Groups, Rows, check_bounds
from miho.fitting.descents import Batch, Ends, descend
from miho.fitting.machine_fits import MachineFits, checked
from miho.fitting.search import searched, title
from miho.identification.constraints import constrained, free_values
from miho.identification.curve_fit import CurveFit
from miho.models.model import Model
from miho.models.tied import Tied
from miho.optim import Budget, Space
from miho.optim.pace import Pace
from miho.quantities import Array
from miho.validate import whole

if TYPE_CHECKING:
    import pandas as pd

SEARCHED = 5
"""Number of datasets that get a whole search, evenly spaced among all; the other datasets start
from the optima of these searches."""
CHECKED = 20
"""Number of datasets that are searched longer afterwards, to check the others: if a tenth of all
missed the optimum, one of 20 shows it nine times in ten. If there are no more, all are searched
first."""
SCREENED, BEST = 512, 3
"""Common starting points of datasets with the same inputs, and how many a dataset descends from."""
BETTER = 1e-6
"""Relative decrease from which a sum of squares counts as lower."""
SLOW = 2.0
"""Seconds before the first line of progress."""


def fit_many(
    model: Model | Callable[..., Any],
    x: Any,
    y: Any,
    space: Space | Mapping[str, Any],
    *,
    by: str | Sequence[str] | None = None,
    start: Mapping[str, Any] | None = None,
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    constraints: str | Sequence[str] = (),
    seed: int = 0,
    convention: str = "iso-w",
    ranges: Mapping[str, Sequence[float] | None] | None = None,
) -> pd.DataFrame:
    """Fit a model to many datasets and return a table with one row for each.

    Formulas and other models are treated differently. Each dataset of a formula descends from the
    best of common starting points, bracket after bracket, until the descents agree. For other
    models a few datasets are searched, and the others descend from the best of the optima found
    there, then again from the best of other datasets' optima and, if all have the same inputs, of
    common starting points. Some datasets are then searched longer, to check the others; if that
    finds better optima, all descend from these too. With a `start`, each dataset descends from it,
    without a check.

    Parameters
    ----------
    model : Model or callable
        A function of input columns and parameters, or a `Model`, as in `miho.fit`.
    x : array_like, tuple, mapping or DataFrame
        With `by` a data frame of all datasets; else columns of shape (N,), which all datasets
        share, or (M, N).
    y : str or array_like of shape (M, N)
        With `by` the name of the output column; else the output of each dataset.
    space : Space or mapping of str
        Bounds of each parameter by name, as in `miho.fit`; priors are not supported.
    by : str or sequence of str, optional
        Column of `x` with one value for each dataset, or several such columns.
    start : mapping of str to float or array_like of shape (M,), optional
        A value for each free parameter, for all datasets or for each.
    fixed, tied, constraints, seed, convention, ranges : optional
        As in `miho.fit`.

    Returns
    -------
    DataFrame
        A row for each dataset, with columns for each parameter and its standard error (`a`,
        `a_error`; NaN at a bound or without a degree of freedom, infinite if the data do not
        determine the parameter), the root-mean-square `error` in
        the unit of the output, the number of `rows`, and whether the descent `converged`. `attrs`
        counts the `checked` datasets and those with a `better` optimum, which also raise a warning.

    Raises
    ------
    ValueError
        If model, data and settings do not fit together, or if no finite value was found.

    Examples
    --------
    >>> import numpy as np
    >>> import miho
    >>> t = np.linspace(0, 2, 50)
    >>> y = np.array([a * np.exp(-1.5 * t) for a in (1.0, 2.0, 3.0)])
    >>> table = miho.fit_many(lambda t, a, b: a * np.exp(-b * t), t, y, {"a": (0, 5), "b": (0, 10)})
    >>> table[["a", "b", "converged"]].round(4)
         a    b  converged
    0  1.0  1.5       True
    1  2.0  1.5       True
    2  3.0  1.5       True
    """
    whole("seed", seed, 0)
    check_bounds(space)
    start, fixed = by_label("start", start), by_label("fixed", fixed)
    tied = by_label("tied", tied)
    parts = Rows(x, y) if by is None else Groups(x, y, by)
    stated = convention, ranges, (space, tied, start, fixed)

    chosen = model_of(model, parts.part(0)[0], stated[-1])
    datasets = parts.of(chosen).in_signs_of(chosen, *stated)

    def dataset(k: int) -> Dataset:
        x, y = parts.part(k)
        return data_of(chosen, x, y, None, "raise", *stated)[0]

    starts = middle = None
    if start is not None:
        starts = {name: np.ravel(value) for name, value in start.items()}
        middle = {n: float(np.median(value)) if value.size else 0.0 for n, value in starts.items()}
    bounds = constrained(space_of(chosen, space, middle, fixed or {}, tied or {}), constraints)
    problem = CurveFit(chosen, dataset(0), bounds, compiled=False)
    taken = {"error", "rows", "converged", *(f"{name}_error" for name in problem.space.names)}
    clash = sorted(taken.intersection(bounds.names))
    if clash:
        raise ValueError(
            f"{', '.join(clash)}: reserved for columns of the result; rename these parameters"
        )
    if any(parameter.prior is not None for parameter in bounds.parameters):
        raise ValueError("priors: fit_many does not support them; remove them, or use miho.fit")
    thetas = None if starts is None else starts_of(problem, starts, len(datasets))

    @cache
    def search(k: int) -> Array:
        own = CurveFit(chosen, dataset(k), bounds, compiled=False)
        return searched(own, seed=seed, hints=False).theta

    fits = MachineFits.of(problem.model, problem.space, datasets)
    began, pace = time.perf_counter(), Pace(Budget(), SLOW)

    def progress(done: int) -> None:
        if pace.line_due():
            seconds = time.perf_counter() - began
            sys.stderr.write(f"fit_many: {done:,} of {len(datasets):,} datasets, {seconds:.0f} s\n")

    if fits is not None:
        ends, covariance, counts = _by_machine(fits, thetas, seed, progress)
    else:
        batch = Batch.of(problem.model, problem.space, datasets, np.arange(len(datasets)))
        ends, covariance, counts = _by_numpy(batch, thetas, search, seed, progress)
    if not np.isfinite(ends.squares).any():
        failed = ends.thetas if thetas is None else thetas
        problem.model.predict(failed[:1], *problem.inputs)  # raises with its reason, if any
        raise ValueError(f"{title(problem)}: no finite value was found")
    table = _table(problem, datasets.rows, ends, covariance, parts.index)
    table.attrs.update(counts)
    if counts["better"]:
        others = len(datasets) - counts["checked"]
        unsure = f"; the {others:,} others may have better optima too" if others else ""
        warnings.warn(
            f"a longer search of {counts['checked']} datasets found a better optimum for "
            f"{counts['better']} of them, from which all have descended now{unsure}; narrow the "
            "bounds",
            UserWarning,
            stacklevel=2,
        )
    return table


Results = tuple[Ends, Array, dict[str, int]]
"""Ends, their covariance (M, d, d), and the numbers of datasets checked and found better."""


def _by_machine(
    fits: MachineFits, starts: Array | None, seed: int, progress: Callable[[int], object]
) -> Results:
    """Fits of a formula, from starts (1 or M, d) if they are given."""
    everyone = np.arange(len(fits.datasets))
    if starts is not None:
        optima = fits.descend(everyone, starts[:, None, :], progress)
        return optima.ends, fits.covariance(optima), {"checked": 0, "better": 0}
    optima = fits.search(everyone, (seed, 0), progress)
    which = _to_check(len(everyone), seed)
    better = checked(fits, optima, which, seed, BETTER)
    if len(better):
        others = fits.descend(everyone, optima.thetas[better][None], progress)
        lower = np.flatnonzero(others.squares < (1 - BETTER) * optima.squares)
        optima.put(lower, others.some(lower))
    return optima.ends, fits.covariance(optima), {"checked": len(which), "better": len(better)}


def _by_numpy(
    batch: Batch,
    starts: Array | None,
    search: Callable[[int], Array],
    seed: int,
    progress: Callable[[int], object],
) -> Results:
    """Fits of any model, with whole searches of a few datasets."""
    count = len(batch.rows)
    everyone = np.arange(count)
    if starts is not None:
        each = np.broadcast_to(starts, (count, starts.shape[1]))
        ends = descend(batch, everyone, each[None], progress)
        return ends, batch.covariance(ends), {"checked": 0, "better": 0}
    spaced = np.linspace(0, count - 1, SEARCHED).round().astype(int)
    few = everyone if count <= CHECKED else spaced
    ends = descend(batch, everyone, np.array([search(int(k)) for k in few]), progress)
    worst_off = np.argsort(ends.squares, kind="stable")[:: max(1, count // SEARCHED)]
    ends = ends.better_of(descend(batch, everyone, ends.thetas[worst_off[:SEARCHED]], progress))
    for starts in batch.screened(SCREENED, BEST, progress) if count > len(few) else ():
        ends = ends.better_of(descend(batch, everyone, starts[None], progress))
    which, better = _to_check(count, seed), list[Array]()
    for k in which:
        theta = search(int(k))
        squares = float(batch.squares(batch.residuals(theta[None], np.array([k])))[0])
        if squares < (1 - BETTER) * ends.squares[k]:
            better.append(theta)
            ends.thetas[k], ends.squares[k], ends.converged[k] = theta, squares, True
    if better:
        ends = ends.better_of(descend(batch, everyone, np.array(better), progress))
    return ends, batch.covariance(ends), {"checked": len(which), "better": len(better)}


def _to_check(count: int, seed: int) -> NDArray[np.intp]:
    return np.random.default_rng(seed).permutation(np.arange(count))[:CHECKED]


def starts_of(problem: CurveFit, start: Mapping[str, Array], count: int) -> Array:
    """Starts (1 or M, d) from values of each parameter, (1,) or (M,)."""
    for name, values in start.items():
        if values.size not in (1, count):
            raise ValueError(
                f"start: {name} has {values.size} values for {count} datasets; expected one value, "
                "or one for each"
            )
    rows = np.stack(np.broadcast_arrays(*map(np.float64, start.values())), axis=-1)
    space, model = problem.space, problem.model
    if isinstance(model, Tied):
        named = [dict(zip(start, row.tolist(), strict=True)) for row in rows]
        thetas = np.array([free_values(space, model.ties, values) for values in named])
    else:
        thetas = rows[:, [[*start].index(name) for name in space.names]]
    for k, name in enumerate(space.names):
        inside = (space.low[k] <= thetas[:, k]) & (thetas[:, k] <= space.high[k])
        if not inside.all():
            value = thetas[np.flatnonzero(~inside)[0], k]
            raise ValueError(
                f"start: {name} is {value:g}; expected {space.low[k]:g} to {space.high[k]:g}"
            )
    return np.ascontiguousarray(thetas)


def _table(
    problem: CurveFit, rows: NDArray[np.int64], ends: Ends, covariance: Array, index: Any
) -> pd.DataFrame:
    """A row per dataset; standard errors are NaN at a bound and without a degree of freedom.

    They are infinite where the data do not determine a parameter.
    """
    import pandas as pd

    variances = np.diagonal(covariance, axis1=1, axis2=2)
    unknown, free = np.isnan(variances), np.isinf(variances)
    names, values, model = problem.space.names, ends.thetas, problem.model
    if isinstance(model, Tied):
        own = [*model.ties.names, *(p.name for p in problem.space.parameters if p.stands_for)]
        extra = [k for k, name in enumerate(names) if name not in own]
        slopes = np.broadcast_to(np.eye(len(names))[extra], (len(values), len(extra), len(names)))
        slopes = np.concatenate([model.ties.value_slopes(values), slopes], axis=1)
        values = np.concatenate([model.ties.values(values), values[:, extra]], axis=1)
        covariance = slopes @ np.nan_to_num(covariance, posinf=0.0) @ slopes.transpose(0, 2, 1)
        unknown, free = (((slopes != 0) & some[:, None, :]).any(axis=2) for some in (unknown, free))
        names = (*model.ties.names, *(names[k] for k in extra))
    errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    errors = np.where(unknown, np.nan, np.where(free, np.inf, errors))
    columns: dict[str, Any] = {}
    for k, name in enumerate(names):
        columns |= {name: values[:, k], f"{name}_error": errors[:, k]}
    columns |= {"error": np.sqrt(ends.squares / rows), "rows": rows, "converged": ends.converged}
    return pd.DataFrame(columns, index=index)
