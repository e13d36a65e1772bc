"""A preview of a file, to be checked before a model is fitted to its data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING

from miho.quantities import Array

if TYPE_CHECKING:
    from miho.data.dataset import Dataset


SHOWN = 3
"""Number of rows that a preview shows."""


@dataclass(frozen=True)
class Reading:
    """The columns of a file in its names, units and signs, as text, and notes on its reading.

    The text of a column has its name, unit, smallest and largest number, and first numbers.
    """

    path: str
    rows: int
    columns: tuple[list[str], ...]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, path: str, numbers: Mapping[str, Array], units: Sequence[str], notes: Sequence[str]
    ) -> Reading:
        """Describe columns (N,) with their units."""
        columns = map(_summary, numbers, units, numbers.values())
        return cls(path, next(iter(numbers.values())).size, tuple(columns), tuple(notes))


def preview(dataset: Dataset) -> str | None:
    """Columns of the file and of the dataset as aligned text; None if there is no file."""
    reading = dataset.reading
    if reading is None:
        return None
    notes = f" ({'; '.join(reading.notes)})" if reading.notes else ""
    used = [_summary(name, dataset.units[name], dataset[name]) for name in dataset.columns]
    heading = "used, in SI units and ISO signs"
    if used == list(reading.columns):
        used, heading = [], "used as they are"
    held = f", {len(dataset.held_out)} more held out" if dataset.held_out is not None else ""
    lines = _aligned([*reading.columns, *used])
    count = len(reading.columns)
    return "\n".join(
        [
            f"{reading.path}: {reading.rows} rows{notes}; name, unit, range, first rows:",
            *lines[:count],
            f"{heading}: {len(dataset)} rows{held}",
            *lines[count:],
        ]
    )


def _summary(name: str, unit: str, values: Array) -> list[str]:
    low, high, *first = (f"{value:.5g}" for value in (values.min(), values.max(), *values[:SHOWN]))
    return [name, unit, low, "to", high, "|", *first]


def _aligned(rows: Sequence[list[str]]) -> list[str]:
    """Lines with names and units aligned to the left, numbers to the right."""
    columns = []
    for number, cells in enumerate(zip_longest(*rows, fillvalue="")):
        width = max(map(len, cells))
        columns.append([cell.ljust(width) if number < 2 else cell.rjust(width) for cell in cells])
    return ["  ".join(["", *line]).rstrip() for line in zip(*columns, strict=True)]
