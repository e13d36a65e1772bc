"""Thousands of small fits of one model, side by side: no search, page or folder for each."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from miho.fitting.descents import Batch, Ends, descend
from miho.fitting.search import searched
from miho.fitting.statement import data_of, inputs_of, space_of
from miho.identification.constraints import constrained
from miho.identification.curve_fit import CurveFit
from miho.models.model import Model
from miho.models.tied import Tied
from miho.optim import Space
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

SEARCHED = 5
"""Datasets that are searched whole, evenly among all; the others start from where these ended."""
CHECKED = 20
"""So many are searched whole afterwards, to see whether the others can be believed: where a tenth
of all missed the optimum, one of 20 shows it nine times in ten."""
BETTER = 1e-6
"""A sum of squares is lower if it is so by this share."""
SLOW = 2.0
"""Seconds after which progress is shown, and between two lines of it."""


def fit_many(
    model: Model | Callable[..., Any],
    x: Any,
    y: Any,
    space: Space | Mapping[str, Any],
    *,
    by: str | None = None,
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    constraints: str | Sequence[str] = (),
    seed: int = 0,
) -> pd.DataFrame:
    """Fit a model to many datasets; a row for each, at the cost of arithmetic.

    The datasets are the groups of a data frame `x` that have one value in the column `by`, with `y`
    the name of a column; or else the rows of `y` (M, N), over columns (N,) or (M, N) in `x`.
    `model`, `space`, `fixed`, `tied` and `constraints` are those of `miho.fit`.

    A few datasets are searched whole. The others descend from the best of where those ended, and
    again from where others ended that are worse off; some are then searched whole too.
    The columns are each parameter and its standard error (`a`, `a_error`), the root-mean-square
    `error`, `rows`, and whether the descent `converged`. The table's `attrs` say of how many
    `checked` datasets the search found a `better` optimum, of which a warning tells.
    Raises ValueError for what does not fit together.
    """
    import pandas as pd

    keys, parts = _parts(x, y, by)
    named = space.names if isinstance(space, Space) else tuple(space)
    first, chosen, _ = data_of(model, *parts[0], None, {*named, *(fixed or ()), *(tied or ())})
    bounds = constrained(space_of(chosen, space, None, fixed or {}, tied or {}), constraints)
    problem = CurveFit(chosen, first, bounds, compiled=False)
    columns = [list(inputs_of(chosen, columns).values()) for columns, _ in parts]
    outputs = [output_of(*part) for part in parts]
    batch = Batch.of(problem.model, problem.space, columns, outputs)
    progress = _Progress(len(keys))

    def search(k: int) -> Array:
        dataset = data_of(chosen, *parts[k], None)[0]
        return searched(CurveFit(chosen, dataset, bounds, compiled=False), seed=seed).theta

    taken = {"error", "rows", "converged", *(f"{name}_error" for name in problem.space.names)}
    clash = sorted(taken.intersection(bounds.names))
    if clash:
        raise ValueError(f"{', '.join(clash)}: columns of the table have these names; use others")
    if any(parameter.prior is not None for parameter in bounds.parameters):
        raise ValueError("priors need miho.fit; leave them out")
    everyone = np.arange(len(keys))
    few = np.unique(np.linspace(0, len(keys) - 1, SEARCHED).round().astype(int))
    ends = descend(batch, everyone, np.array([search(int(k)) for k in few]), progress)
    worst_off = np.argsort(ends.squares, kind="stable")[:: max(1, len(keys) // SEARCHED)]
    ends = ends.better_of(descend(batch, everyone, ends.thetas[worst_off[:SEARCHED]], progress))
    checked = np.random.default_rng(seed).permutation(everyone)[:CHECKED]
    better = 0
    for k in checked:
        theta = search(int(k))
        squares = float(batch.squares(batch.residuals(theta[None], np.array([k])))[0])
        if squares < (1 - BETTER) * ends.squares[k]:
            better += 1
            ends.thetas[k], ends.squares[k], ends.converged[k] = theta, squares, True
    table = _table(problem, batch, ends, pd.Index(keys, name=by))
    table.attrs = {"checked": len(checked), "better": better}
    if better:
        warnings.warn(
            f"of {len(checked)} datasets that were searched whole, {better} have a better optimum "
            "than their descent found, and so may others; narrow the bounds",
            UserWarning,
            stacklevel=2,
        )
    return table


def _parts(x: Any, y: Any, by: str | None) -> tuple[list[Hashable], list[tuple[Any, Any]]]:
    """The name of each dataset, and its columns and output."""
    if by is not None:
        named = isinstance(by, str) and isinstance(y, str) and hasattr(x, "groupby")
        if not named or by not in x or y not in x:
            raise ValueError(
                f"by is {by!r} and y is {y!r}; give a data frame x that has both as columns"
            )
        groups = list(x.groupby(by, sort=False, dropna=False))
        if not groups:
            raise ValueError("the data frame has no rows; give some")
        return [key for key, _ in groups], [(group, y) for _, group in groups]
    if isinstance(y, str):
        raise ValueError(f"y is {y!r}; give by= as well, the column that tells datasets apart")
    values = np.asarray(y, dtype=float)
    if values.ndim != 2 or not values.size:
        raise ValueError(f"y has shape {values.shape}; give (datasets, rows), or a data frame, by=")

    def row(column: Any, k: int) -> Array:
        column = np.asarray(column, dtype=float)
        if column.ndim == 2 and len(column) != len(values):
            raise ValueError(f"x has {len(column)} datasets and y {len(values)}; give as many")
        return np.asarray(column[k] if column.ndim == 2 else column)

    def part(k: int) -> tuple[Any, Array]:
        if isinstance(x, Mapping) or hasattr(x, "columns"):
            return {name: row(x[name], k) for name in x}, values[k]
        whole = tuple(row(column, k) for column in (x if isinstance(x, tuple) else (x,)))
        return whole, values[k]

    return list(range(len(values))), [part(k) for k in range(len(values))]


def output_of(columns: Any, y: Any) -> Array:
    """The output's values, given as such or by the name of a column."""
    return np.asarray(columns[y] if isinstance(y, str) else y, dtype=float)


def _table(problem: CurveFit, batch: Batch, ends: Ends, index: pd.Index) -> pd.DataFrame:
    """A row per dataset; standard errors are NaN at a bound and without a degree of freedom."""
    import pandas as pd

    covariance = batch.covariance(ends)
    unknown = np.isnan(np.diagonal(covariance, axis1=1, axis2=2))
    names, values, model = problem.space.names, ends.thetas, problem.model
    if isinstance(model, Tied):
        own = [*model.ties.names, *(p.name for p in problem.space.parameters if p.stands_for)]
        extra = [k for k, name in enumerate(names) if name not in own]
        slopes = np.broadcast_to(np.eye(len(names))[extra], (len(values), len(extra), len(names)))
        slopes = np.concatenate([model.ties.value_slopes(values), slopes], axis=1)
        values = np.concatenate([model.ties.values(values), values[:, extra]], axis=1)
        covariance = slopes @ np.nan_to_num(covariance) @ slopes.transpose(0, 2, 1)
        unknown = ((slopes != 0) & unknown[:, None, :]).any(axis=2)
        names = (*model.ties.names, *(names[k] for k in extra))
    errors = np.where(unknown, np.nan, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))
    columns: dict[str, Any] = {}
    for k, name in enumerate(names):
        columns |= {name: values[:, k], f"{name}_error": errors[:, k]}
    columns |= {
        "error": np.sqrt(ends.squares / batch.rows),
        "rows": batch.rows,
        "converged": ends.converged,
    }
    return pd.DataFrame(columns, index=index)


@dataclass
class _Progress:
    """How many of all descents are done, on stderr now and then."""

    total: int
    started: float = field(default_factory=time.perf_counter)
    shown: float = 0.0

    def __call__(self, done: int) -> None:
        seconds = time.perf_counter() - self.started
        if seconds - self.shown >= SLOW:
            self.shown = seconds
            line = f"fit_many: {done:,} of {self.total:,} datasets, {seconds:.0f} s\n"
            sys.stderr.write(line)
