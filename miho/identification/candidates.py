"""Rows that could be measured next: of tables, datasets or grids, in groups or one by one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.models.model import Model
from miho.quantities import Array

Candidates = pd.DataFrame | Dataset | Mapping[str, Array]
"""Rows that could be measured; or levels of each input, of which each combination is a row."""


def candidate_rows(model: Model, candidates: Candidates) -> pd.DataFrame:
    """The candidates as rows; raises ValueError where they do not fit the model."""
    if isinstance(candidates, Dataset):
        frame = pd.DataFrame(dict(candidates.columns))
        for name, unit in model.inputs.items():
            if candidates.units.get(name, unit) != unit:
                raise ValueError(
                    f"candidates: {name!r} is in {candidates.units[name]}; the model takes {unit}"
                )
    elif isinstance(candidates, pd.DataFrame):
        frame = candidates.reset_index(drop=True)
    else:
        levels = [np.ravel(np.asarray(values)) for values in candidates.values()]
        grid = np.meshgrid(*levels, indexing="ij")
        frame = pd.DataFrame(dict(zip(candidates, map(np.ravel, grid), strict=True)))
    missing = [name for name in model.inputs if name not in frame.columns]
    if missing or frame.empty:
        raise ValueError(
            f"candidates: {'no column ' + repr(missing[0]) if missing else 'no rows'}; give rows "
            f"with all inputs of the model, {', '.join(model.inputs)}"
        )
    for name in model.inputs:
        values = pd.to_numeric(frame[name], errors="coerce").to_numpy(float)
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise ValueError(
                f"candidates: {name!r} in row {row} (from 0) is {frame[name].iloc[row]!r}; give a "
                "finite number"
            )
        frame = frame.assign(**{name: values})
    return frame


def group_numbers(model: Model, frame: pd.DataFrame, groups: str | None) -> NDArray[np.intp]:
    """The group of each candidate (m,), numbered from 0; each row is its own without `groups`."""
    if groups is None:
        if model.ordered:
            raise ValueError(
                "groups is None, and the model needs rows in order; name the column that numbers "
                "the manoeuvres to choose from"
            )
        return np.arange(len(frame))
    if groups not in frame.columns:
        raise ValueError(f"groups is {groups!r}; columns are {', '.join(map(str, frame.columns))}")
    return np.asarray(pd.factorize(frame[groups])[0], dtype=np.intp)


def derivatives(model: Model, theta: Array, rows: pd.DataFrame, group: NDArray[np.intp]) -> Array:
    """Derivatives (m, d) of predictions; a model with a memory sees each group by itself."""
    columns = [rows[name].to_numpy(float) for name in model.inputs]
    if model.ordered:
        J = np.empty((len(rows), theta.size))
        for number in range(group.max() + 1):
            part = group == number
            J[part] = model.jacobian(theta, *(column[part] for column in columns))
    else:
        J = model.jacobian(theta, *columns)
    if not np.isfinite(J).all():
        row = int(np.flatnonzero(~np.isfinite(J).all(axis=1))[0])
        raise ValueError(
            f"candidate row {row} (from 0): the model's derivatives are not finite there; leave "
            "it out"
        )
    return J
