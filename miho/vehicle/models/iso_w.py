"""Columns of a tire in ISO-W signs, checked like the columns of a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from miho.data.conventions import to_iso_w
from miho.data.measurements import Layout
from miho.quantities import Array


def in_iso_w(
    inputs: Mapping[str, Array],
    units: Sequence[str],
    force: str,
    output: Array,
    convention: str,
    ranges: Mapping[str, Sequence[float] | None] | None,
) -> tuple[dict[str, Array], Array]:
    """Return inputs and output (N,) in ISO-W signs; the output is the `force` of this name.

    All columns are in SI units; `units` names the unit of each input and of the force.
    `miho.data.measurements.Layout` documents `convention` and `ranges`. Raises ValueError if the
    size or the sign of a column is impossible for a tire.
    """
    numbers = {**inputs, force: output}
    layout = Layout([*numbers], units, force, convention=convention, ranges=ranges)
    # The dataset refuses rows that are not finite, and columns of different lengths.
    if len({column.shape for column in numbers.values()}) == 1 and np.ndim(output):
        finite = np.flatnonzero(np.isfinite([*numbers.values()]).all(axis=0))

        def fault(column: str, row: int | None, problem: str) -> ValueError:
            return ValueError(
                f"{column}{'' if row is None else f', row {finite[row] + 1}'}: {problem}"
            )

        if finite.size:
            layout.si_columns({name: column[finite] for name, column in numbers.items()}, fault)
    columns = to_iso_w(numbers, convention)
    return {name: columns[name] for name in inputs}, columns[force]
