"""Candidate rows of a design: from tables, datasets or grids, in groups or one by one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.identification.curve_fit_checks import LARGEST
from miho.models.model import Model
from miho.quantities import Array

Candidates = pd.DataFrame | Dataset | Mapping[str, Array] | Array
"""Rows that could be measured, or levels of each input, whose combinations are the rows; an array
has the levels of a single input."""


def candidate_rows(model: Model, candidates: Candidates) -> pd.DataFrame:
    """The candidates as rows; raises ValueError if they do not fit the model."""
    if isinstance(candidates, Dataset):
        frame = pd.DataFrame(dict(candidates.columns))
        for name, unit in model.inputs.items():
            if candidates.units.get(name, unit) != unit:
                raise ValueError(
                    f"candidates: {name!r} is in {candidates.units[name]}; expected {unit}, the "
                    "unit of the model"
                )
    elif isinstance(candidates, pd.DataFrame):
        frame = candidates.reset_index(drop=True)
    else:
        if not isinstance(candidates, Mapping):  # levels of the first input
            candidates = {next(iter(model.inputs)): candidates}
        levels = [np.ravel(np.asarray(values)) for values in candidates.values()]
        grid = np.meshgrid(*levels, indexing="ij")
        frame = pd.DataFrame(dict(zip(candidates, map(np.ravel, grid), strict=True)))
    missing = [name for name in model.inputs if name not in frame.columns]
    if missing or frame.empty:
        raise ValueError(
            f"candidates: {'no column ' + repr(missing[0]) if missing else 'no rows'}; expected "
            f"rows with all inputs of the model, {', '.join(model.inputs)}"
        )
    for name in model.inputs:
        values = pd.to_numeric(frame[name], errors="coerce").to_numpy(float)
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise ValueError(
                f"candidates: {name!r} in row {row} (from 0) is {frame[name].iloc[row]!r}; "
                "expected a finite number"
            )
        frame = frame.assign(**{name: values})
    return frame


def group_numbers(model: Model, frame: pd.DataFrame, groups: str | None) -> NDArray[np.intp]:
    """The group of each candidate (m,), from 0; without `groups` each row is a group."""
    if groups is None:
        if model.ordered:
            raise ValueError(
                "groups is None; expected the column that numbers the manoeuvres, because the "
                "model needs rows in order"
            )
        return np.arange(len(frame))
    if groups not in frame.columns:
        raise ValueError(
            f"groups is {groups!r}; expected one of the columns "
            f"{', '.join(map(str, frame.columns))}"
        )
    return np.asarray(pd.factorize(frame[groups])[0], dtype=np.intp)


def derivatives(model: Model, theta: Array, rows: pd.DataFrame, group: NDArray[np.intp]) -> Array:
    """Derivatives (m, d) of predictions; a model that needs rows in order gets single groups."""
    columns = [rows[name].to_numpy(float) for name in model.inputs]
    if model.ordered:
        J = np.empty((len(rows), theta.size))
        for number in range(group.max() + 1):
            part = group == number
            J[part] = model.jacobian(theta, *(column[part] for column in columns))
    else:
        J = model.jacobian(theta, *columns)
    usable = (np.abs(J) < LARGEST).all(axis=1)  # squares of larger ones overflow
    if not usable.all():
        row = int(np.flatnonzero(~usable)[0])
        raise ValueError(
            f"candidates: the derivatives of the model are not finite in row {row} (from 0); "
            "remove the row"
        )
    return J
