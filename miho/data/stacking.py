"""Several outputs or datasets as one: their rows below each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from miho.data.dataset import Dataset
from miho.quantities import Array
from miho.validate import positive

OUTPUT, VALUE = "output", "value"


def stacked(data: Dataset, scales: Mapping[str, float]) -> Dataset:
    """The columns that `scales` names as one output, each in multiples of its scale.

    Scales are the standard deviations of the columns' errors, so that outputs of different units
    weigh what they should. Each row of `data` becomes one for each output: the column `output`
    counts them from 0, `value` [-] is the output, and all other columns stand in each.
    """
    for name, scale in scales.items():
        positive(f"scale of {name}", scale)
    taken = [name for name in (OUTPUT, VALUE) if name in data.columns]
    if not scales or taken:
        raise ValueError(
            f"dataset {data.name}: has a column {taken[0]!r} already; rename it"
            if taken
            else "scales is empty; name the columns that are outputs, with a scale for each"
        )
    outputs = ({**data.columns, VALUE: data[name] / scale} for name, scale in scales.items())
    columns = stacked_columns(list(outputs), OUTPUT)
    return Dataset(data.name, columns, {**data.units, OUTPUT: "-", VALUE: "-"}, VALUE)


def stacked_columns(parts: Sequence[Mapping[str, Array]], index: str) -> dict[str, Array]:
    """The columns of all parts below each other, 0 in the rows of a part that lacks one.

    The column `index` counts the parts from 0.
    """
    sizes = [next(iter(part.values())).size for part in parts]
    names = dict.fromkeys(name for part in parts for name in part)
    columns = {index: np.repeat(np.arange(len(parts), dtype=float), sizes)}
    for name in names:
        own = (part.get(name, np.zeros(n)) for part, n in zip(parts, sizes, strict=True))
        columns[name] = np.concatenate(list(own))
    return columns
