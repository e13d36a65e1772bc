"""A strict reader for numbers in comma-separated text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miho.data.dataset import Dataset, file_name

Array = NDArray[np.float64]

MAX_BYTES = 64 * 2**20
MAX_LINE = 10_000


class CSVError(ValueError):
    """One line saying file, line and column, what is wrong and what to do."""

    def __init__(self, path: Path, line: int, column: int, problem: str) -> None:
        super().__init__(f"{path}:{line}:{column}: {problem}")


def read_numbers(path: Path, columns: Sequence[str], *, header: bool) -> dict[str, Array]:
    """The columns of a comma-separated file by name, (N,) each, every cell a finite number.

    With a `header`, the first line must name the columns asked for, in any order and among
    others, which are not read; without one, the file must have just these columns in this order.
    Raises CSVError for anything else, FileNotFoundError if there is no file.
    """
    lines = _lines(path)
    first = 0
    positions = list(range(len(columns)))
    width = len(columns)
    if header:
        names = [name.strip().strip('"') for name in lines[0].split(",")]
        width = len(names)
        for name in columns:
            if name not in names:
                remedy = "rename it or choose other columns"
                if len(names) == 1 and ";" in lines[0]:
                    remedy = "separate columns with commas and write decimals with a point"
                found = f"no column {name!r} in the header {lines[0].strip()[:80]!r}"
                raise CSVError(path, 1, 1, f"{found}; {remedy}")
            if names.count(name) > 1:
                raise CSVError(path, 1, 1, f"column {name!r} is there twice; keep one")
        positions = [names.index(name) for name in columns]
        first = 1
    values = np.empty((len(lines) - first, len(columns)))
    for row, text in enumerate(lines[first:]):
        cells = text.split(",")
        if len(cells) != width:
            raise CSVError(
                path, row + first + 1, 1, f"{len(cells)} cells; every row must have {width}"
            )
        for column, position in enumerate(positions):
            number = _number(cells[position])
            if number is None:
                raise CSVError(
                    path,
                    row + first + 1,
                    1 + sum(len(cell) + 1 for cell in cells[:position]),
                    f"{cells[position].strip()[:40]!r} in column {columns[column]!r} is not a "
                    "finite number; correct the cell or remove the row",
                )
            values[row, column] = number
    if not len(values):
        raise CSVError(path, 1, 1, "no rows of data; give at least one")
    return {name: values[:, column].copy() for column, name in enumerate(columns)}


def load_csv(
    path: str, columns: Sequence[str], units: Sequence[str], output: str, name: str | None = None
) -> Dataset:
    """A dataset from a file with a header line, in SI units, radians and ISO-W signs.

    `columns` are read by name and `units` name their units in the same order. The dataset is
    called after the file unless `name` is given.
    """
    if len(columns) != len(units):
        raise ValueError(f"{len(columns)} columns and {len(units)} units; give one unit a column")
    numbers = read_numbers(Path(path), columns, header=True)
    return Dataset(name or file_name(path), numbers, dict(zip(columns, units, strict=True)), output)


def _lines(path: Path) -> list[str]:
    if path.exists() and not path.is_file():
        raise CSVError(path, 1, 1, "is not a file; name one")
    if path.stat().st_size > MAX_BYTES:
        raise CSVError(path, 1, 1, f"larger than {MAX_BYTES >> 20} MiB; split the file")
    data = path.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        raise CSVError(path, line, column, "not UTF-8 text; save the file as UTF-8") from None
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise CSVError(path, 1, 1, "the file is empty; give rows of numbers")
    for position, row in enumerate(lines, start=1):
        if len(row) > MAX_LINE:
            raise CSVError(path, position, MAX_LINE, f"line longer than {MAX_LINE} characters")
    return lines


def _number(cell: str) -> float | None:
    """The cell's value if it is a finite number as CSV writes it, else None."""
    if not cell.isascii() or "_" in cell:
        return None
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
