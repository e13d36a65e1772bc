"""A preview of a file, to be checked before a model is fitted to its data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from miho.quantities import Array

if TYPE_CHECKING:
    from miho.data.dataset import Dataset


SHOWN = 3
"""Number of rows that a preview shows."""


@dataclass(frozen=True)
class ColumnSummary:
    """Name, unit, smallest and largest number, and first numbers of a column."""

    name: str
    unit: str
    low: float
    high: float
    first: tuple[float, ...]

    @classmethod
    def of(cls, name: str, unit: str, values: Array) -> ColumnSummary:
        """Summarize a column (N,)."""
        first = tuple(float(value) for value in values[:SHOWN])
        return cls(name, unit, float(values.min()), float(values.max()), first)


@dataclass(frozen=True)
class Reading:
    """The columns of a file in its names, units and signs, and notes on how it was read."""

    path: str
    rows: int
    columns: tuple[ColumnSummary, ...]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, path: str, numbers: Mapping[str, Array], units: Sequence[str], notes: Sequence[str]
    ) -> Reading:
        """Describe columns (N,) with their units."""
        columns = tuple(
            ColumnSummary.of(name, unit, values)
            for (name, values), unit in zip(numbers.items(), units, strict=True)
        )
        return cls(path, next(iter(numbers.values())).size, columns, tuple(notes))


def preview(dataset: Dataset) -> str | None:
    """Columns of the file and of the dataset as aligned text; None if there is no file."""
    reading = dataset.reading
    if reading is None:
        return None
    notes = f" ({'; '.join(reading.notes)})" if reading.notes else ""
    units = dataset.units
    summaries = [
        ColumnSummary.of(name, units[name], values) for name, values in dataset.columns.items()
    ]
    if summaries == list(reading.columns):
        summaries, heading = [], "used as they are"
    else:
        heading = "used, in SI units and ISO signs"
    held = f", {len(dataset.held_out)} more held out" if dataset.held_out is not None else ""
    cells = [_cells(column) for column in (*reading.columns, *summaries)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = [_aligned(row, widths) for row in cells]
    count = len(reading.columns)
    return "\n".join(
        [
            f"{reading.path}: {reading.rows} rows{notes}; name, unit, range, first rows:",
            *lines[:count],
            f"{heading}: {len(dataset)} rows{held}",
            *lines[count:],
        ]
    )


def _cells(column: ColumnSummary) -> list[str]:
    numbers = (column.low, column.high, *column.first)
    texts = [f"{value:.5g}" for value in numbers] + [""] * (SHOWN - len(column.first))
    return [column.name, column.unit, texts[0], "to", texts[1], "|", *texts[2:]]


def _aligned(row: Sequence[str], widths: Sequence[int]) -> str:
    """Align name and unit to the left, numbers to the right."""
    name, unit, *numbers = zip(row, widths, strict=True)
    texts = [text.ljust(width) for text, width in (name, unit)]
    return "  ".join(["", *texts, *(text.rjust(width) for text, width in numbers)]).rstrip()
