"""Combine several outputs or datasets by stacking their rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from miho.data.dataset import Dataset
from miho.quantities import Array
from miho.validate import positive

OUTPUT, VALUE = "output", "value"


def stacked(data: Dataset, scales: Mapping[str, float]) -> Dataset:
    """Stack the columns that `scales` names as one output, each divided by its scale.

    Parameters
    ----------
    data : Dataset
        The data.
    scales : mapping of str to float
        Standard deviation of the errors of each output column, which makes the outputs comparable.

    Returns
    -------
    Dataset
        One row per row of `data` and output. The column `output` counts the outputs from 0, `value`
        [-] is the scaled output, and all other columns are repeated.

    Raises
    ------
    ValueError
        If `scales` is empty, or `data` already has a column `output` or `value`.

    Examples
    --------
    >>> from miho.data import Dataset, stacked
    >>> units = {"t": "s", "x": "m", "v": "m/s"}
    >>> motion = Dataset("motion", {"t": [0, 1], "x": [0, 2], "v": [3, 1]}, units, "x")
    >>> stacked(motion, {"x": 0.1, "v": 0.5})["value"].tolist()
    [0.0, 20.0, 6.0, 2.0]
    """
    for name, scale in scales.items():
        positive(f"scale of {name}", scale)
    taken = [name for name in (OUTPUT, VALUE) if name in data.columns]
    if not scales or taken:
        raise ValueError(
            f"dataset {data.name}: has a column {taken[0]!r} already; rename it"
            if taken
            else "scales is empty; name the output columns, with a scale for each"
        )
    outputs = ({**data.columns, VALUE: data[name] / scale} for name, scale in scales.items())
    columns = stacked_columns(list(outputs), OUTPUT)
    return Dataset(data.name, columns, {**data.units, OUTPUT: "-", VALUE: "-"}, VALUE)


def stacked_columns(parts: Sequence[Mapping[str, Array]], index: str) -> dict[str, Array]:
    """Stack the columns of all parts; a column that a part lacks is 0 in its rows.

    The column `index` counts the parts from 0.
    """
    sizes = [next(iter(part.values())).size for part in parts]
    names = dict.fromkeys(name for part in parts for name in part)
    columns = {index: np.repeat(np.arange(len(parts), dtype=float), sizes)}
    for name in names:
        own = (part.get(name, np.zeros(n)) for part, n in zip(parts, sizes, strict=True))
        columns[name] = np.concatenate(list(own))
    return columns
