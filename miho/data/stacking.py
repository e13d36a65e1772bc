"""Several outputs in one dataset: their rows below each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from miho.data.dataset import Dataset
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
    values = np.concatenate([data[name] / scale for name, scale in scales.items()])
    columns = {name: np.tile(column, len(scales)) for name, column in data.columns.items()}
    columns |= {OUTPUT: np.repeat(np.arange(len(scales)), len(data)), VALUE: values}
    return Dataset(data.name, columns, {**data.units, OUTPUT: "-", VALUE: "-"}, VALUE)
