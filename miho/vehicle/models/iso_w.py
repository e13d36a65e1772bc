"""Columns of a tire in ISO-W signs, checked like the columns of a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from miho.data.conventions import conventions_of, sign_problem, to_iso_w
from miho.data.measurements import Layout
from miho.quantities import Array


def in_iso_w(
    inputs: Mapping[str, Array], force: str, output: Array, convention: str
) -> tuple[dict[str, Array], Array]:
    """Return inputs and output (N,) in ISO-W signs; the output is the `force` of this name."""
    columns = to_iso_w({**inputs, force: output}, convention)
    return {name: columns[name] for name in inputs}, columns[force]


def check_iso_w(
    inputs: Mapping[str, Array],
    units: Sequence[str],
    force: str,
    output: Array,
    convention: str,
    ranges: Mapping[str, Sequence[float] | None] | None,
    *,
    signs: bool = True,
) -> None:
    """Raise ValueError if the size of a column (N,) is impossible for a tire, or its sign.

    All columns are in SI units and in the signs of `convention`; `units` names the unit of each
    input and of the force. `miho.data.measurements.Layout` documents `convention` and `ranges`. If
    `signs` is false, signs are not checked.
    """
    numbers = {**inputs, force: output}
    layout = Layout([*numbers], units, force, convention=convention, ranges=ranges)
    # The dataset refuses rows that are not finite, and columns of different lengths.
    if len({column.shape for column in numbers.values()}) > 1 or not np.ndim(output):
        return
    finite = np.flatnonzero(np.isfinite([*numbers.values()]).all(axis=0))
    if not finite.size:
        return

    def fault(column: str, row: int | None, problem: str) -> ValueError:
        return ValueError(f"{column}{'' if row is None else f', row {finite[row] + 1}'}: {problem}")

    checked = {name: column[finite] for name, column in numbers.items()}
    columns, named = layout.sized_columns(checked, fault)
    wrong = sign_problem(columns, named) if signs else None
    if wrong is not None:
        fitting = conventions_of(columns, named, convention)
        setting = f"set convention={' or '.join(map(repr, fitting))}, or " * bool(fitting)
        remedy = f"{setting}negate {' or '.join(wrong.negated)}"
        raise fault(wrong.column, None, f"{wrong.problem}; {remedy}")
