"""A strict reader for numbers in comma-separated text."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from miho.data.dataset import Dataset, file_name
from miho.data.measurements import Layout
from miho.data.text_lines import CSVError, lines_of
from miho.quantities import Array
from miho.validate import one_of

TIME = re.compile(r"\d:\d\d|\d{4}-\d\d-\d\d")
"""A part of a text that is a time or a date."""
BLOCK = 10_000
"""Lines that are read at a time; a block with a fault is read again cell by cell."""

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t"}
DECIMALS = {"point": ".", "comma": ","}
"""Names of the characters, which would need nested quotes on a command line."""
MISSING = ("raise", "drop")
NO_NUMBER = {"", "nan", "na", "n/a", "#n/a", "null", "none"}
"""Cells that mark a missing number, in lower case."""


@dataclass(frozen=True)
class TextFormat:
    """Format of a text table.

    Parameters
    ----------
    delimiter : str, optional
        A key of `DELIMITERS` or the character itself. By default a comma, or a semicolon or tab if
        only that gives the requested columns.
    decimal : str
        A key of `DECIMALS` or the character itself.
    skip_rows : int
        Lines before the line that names the columns.
    drop_rows : sequence of int
        Numbers of further lines without data (for example a line of units), counted from 1.
    comment : str, optional
        Prefix of lines that are ignored.
    missing : {'raise', 'drop'}
        'drop' ignores rows with a requested cell that is empty or one of `NO_NUMBER`.

    Raises
    ------
    ValueError
        For an invalid setting.
    """

    delimiter: str | None = None
    decimal: str = "point"
    skip_rows: int = 0
    drop_rows: Sequence[int] = ()
    comment: str | None = None
    missing: str = "raise"

    def __post_init__(self) -> None:
        if self.delimiter is not None:
            delimiter = DELIMITERS.get(self.delimiter, self.delimiter)
            if delimiter not in DELIMITERS.values():
                raise ValueError(
                    f"delimiter is {self.delimiter!r}; choose from {', '.join(DELIMITERS)}, or "
                    "null to detect it from the header"
                )
            object.__setattr__(self, "delimiter", delimiter)
        object.__setattr__(self, "decimal", DECIMALS.get(self.decimal, self.decimal))
        if self.decimal not in DECIMALS.values():
            raise ValueError(f"decimal is {self.decimal!r}; choose from {', '.join(DECIMALS)}")
        if type(self.skip_rows) is not int or self.skip_rows < 0:
            raise ValueError(f"skip_rows is {self.skip_rows!r}; expected a number of lines")
        listed = isinstance(self.drop_rows, Sequence) and not isinstance(self.drop_rows, str)
        if not listed or not all(type(line) is int and line > 0 for line in self.drop_rows):
            raise ValueError(
                f"drop_rows is {self.drop_rows!r}; list the numbers of lines, counted from 1"
            )
        if self.comment is not None and not (isinstance(self.comment, str) and self.comment):
            raise ValueError(f"comment is {self.comment!r}; give the prefix of such lines")
        one_of("missing", self.missing, MISSING)


PLAIN = TextFormat()


def read_numbers(
    path: Path, columns: Sequence[str], *, header: bool, text: TextFormat = PLAIN
) -> dict[str, Array]:
    """Read columns (N,) of a comma-separated file by name; every cell must be a finite number.

    With a `header`, the first line must name the requested columns, in any order; further columns
    are ignored. Without one, the file must contain just these columns in this order. Cells may be
    in double quotes. Raises CSVError for any fault, FileNotFoundError for a missing file.
    """
    return TextTable(path, columns, header, text).numbers()


def load_csv(
    path: str,
    columns: Sequence[str],
    units: Sequence[str],
    output: str,
    headers: Sequence[str] | None = None,
    convention: str = "iso-w",
    flip: Sequence[str] = (),
    ranges: Mapping[str, Sequence[float] | None] | None = None,
    held_out: Mapping[str, Sequence[float]] | None = None,
    where: Mapping[str, Sequence[float]] | None = None,
    every: int = 1,
    delimiter: str | None = None,
    decimal: str = "point",
    skip_rows: int = 0,
    drop_rows: Sequence[int] = (),
    comment: str | None = None,
    missing: str = "raise",
    name: str | None = None,
) -> Dataset:
    r"""Load a dataset from a text file with a header line, in SI units, radians and ISO-W signs.

    Parameters
    ----------
    path : str
        The file.
    columns, units, output, headers, convention, flip, ranges, held_out, where, every
        See `miho.data.measurements.Layout`.
    delimiter, decimal, skip_rows, drop_rows, comment, missing
        See `miho.data.csv.TextFormat`.
    name : str, optional
        Name of the dataset; by default the name of the file.

    Returns
    -------
    Dataset
        The selected rows.

    Raises
    ------
    CSVError
        For a fault in the file.
    ValueError
        For an invalid setting.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "pulse.csv")
    ...     _ = path.write_text("time,voltage\n0,1\n10,2\n")
    ...     load_csv(str(path), ["t", "u"], ["ms", "V"], "u", headers=["time", "voltage"])
    <Dataset pulse: 2 rows; columns: t [s], u [V]; output: u>
    """
    layout = Layout(
        columns, units, output, headers, convention, flip, ranges, held_out, where, every
    )
    text = TextFormat(delimiter, decimal, skip_rows, drop_rows, comment, missing)
    table = TextTable(Path(path), layout.all_names, header=True, text=text)
    numbers = table.numbers()
    return layout.dataset(name or file_name(path), path, numbers, table.fault, table.notes)


class TextTable:
    """The lines of a file, and the positions of the requested columns in them."""

    def __init__(
        self, path: Path, columns: Sequence[str], header: bool, text: TextFormat = PLAIN
    ) -> None:
        self.path = path
        self.columns = tuple(columns)
        self.decimal, self.drops = text.decimal, text.missing == "drop"
        self.lines = lines_of(path)
        self.line_numbers: Sequence[int] = range(1, len(self.lines) + 1)
        self._leave_out(text)
        self.delimiter = text.delimiter or self._detect_delimiter(header)
        blank, end = r"[ \t]" if self.delimiter != "\t" else " ", re.escape(self.delimiter)
        self.cell = re.compile(
            rf'{blank}*"((?:[^"]|"")*)"{blank}*(?={end}|$)|([^"{end}]*)(?={end}|$)'
        )
        self.first = self.incomplete = 0
        self.width = len(columns)
        self.positions = list(range(len(columns)))
        if header:
            self._read_header()

    @property
    def notes(self) -> list[str]:
        """Differences of the file from plain CSV, as phrases."""
        words = {value: key for key, value in DELIMITERS.items()}
        notes = [] if self.delimiter == "," else [f"separated by {words[self.delimiter]}s"]
        notes += ["decimal commas"] if self.decimal == "," else []
        counts = {
            "line{} ignored": self.left_out,
            "row{} with a missing number ignored": self.incomplete,
        }
        return notes + [f"{n:,} {s.format('s' * (n != 1))}" for s, n in counts.items() if n]

    def _leave_out(self, text: TextFormat) -> None:
        """Remove the lines before the header, the listed lines and comments."""
        beyond = [line for line in (text.skip_rows, *text.drop_rows) if line > len(self.lines)]
        if beyond:
            last = len(self.lines)
            problem = f"this is the last line, but line {beyond[0]} is to be ignored"
            raise CSVError(self.path, last, 1, f"{problem}; correct drop_rows or skip_rows")
        dropped = {*range(1, text.skip_rows + 1), *text.drop_rows}
        remaining = [
            number
            for number in self.line_numbers
            if number not in dropped
            and not (text.comment and self.lines[number - 1].startswith(text.comment))
        ]
        self.left_out = len(self.lines) - len(remaining)
        if not self.left_out:
            return
        if not remaining:
            raise CSVError(self.path, 1, 1, "all lines are ignored; keep some")
        self.lines = [self.lines[number - 1] for number in remaining]
        self.line_numbers = remaining

    def _detect_delimiter(self, header: bool) -> str:
        """The delimiter that gives the requested columns in the header; a comma by default."""
        candidates = sorted(DELIMITERS.values(), key=self.decimal.__eq__)
        line = self.lines[0]
        for candidate in candidates:
            if header and self._names_columns(line, candidate):
                return candidate
        present = [candidate for candidate in candidates if candidate in line]
        return (present or candidates)[0]

    def _names_columns(self, line: str, delimiter: str) -> bool:
        return set(self.columns) <= {cell.strip().strip('"') for cell in line.split(delimiter)}

    def _error(self, line: int, column: int, problem: str) -> CSVError:
        """An error at a line of `lines`, counted from 0."""
        return CSVError(self.path, self.line_numbers[line], column, problem)

    def _read_header(self) -> None:
        names = [text.strip() for _, text in self._cells(0)]
        for name in self.columns:
            if name not in names:
                problem = f"no column {name!r} in the header {self.lines[0].strip()[:80]!r}"
                raise self._error(0, 1, f"{problem}; {self._header_remedy(name, names)}")
            if names.count(name) > 1:
                column = self._cells(0)[names.index(name, names.index(name) + 1)][0]
                raise self._error(0, column, f"column {name!r} appears twice; keep one")
        self.first = 1
        self.width = len(names)
        self.positions = [names.index(name) for name in self.columns]

    def _header_remedy(self, name: str, names: Sequence[str]) -> str:
        """Advice for a column that the header does not name."""
        for number, line in zip(self.line_numbers[1:50], self.lines[1:50], strict=True):
            if any(self._names_columns(line, delimiter) for delimiter in DELIMITERS.values()):
                return f"line {number} names the columns: set skip_rows={number - 1}"
        if len(names) == 1 and re.search(r"\S[\s|:]+\S", names[0]):
            return "separate columns with commas"
        if all(_number(header) is not None for header in names):
            return "begin the file with a line that names the columns"
        close = [header for header in names if header.casefold() == name.casefold()]
        close += get_close_matches(name, names, n=1)
        if close:
            return f"rename it, or set headers=[..., {close[0][:40]!r}, ...]"
        return "give the names in the file in the same order: headers=[...]"

    def numbers(self) -> dict[str, Array]:
        """The requested columns, (N,) each."""
        rows = len(self.lines) - self.first
        if not rows:
            raise self._error(0, 1, "no rows of data; give at least one")
        values = np.empty((rows, len(self.columns)))
        for start in range(0, rows, BLOCK):
            stop = min(start + BLOCK, rows)
            block = self._plain_block(start, stop)
            if block is None:  # cell by cell, to locate a fault
                values[start:stop] = [self._row(row) for row in range(start, stop)]
            else:
                values[start:stop] = block
        values = self._complete(values) if np.isnan(values).any() else values
        return {name: values[:, column].copy() for column, name in enumerate(self.columns)}

    def _complete(self, values: Array) -> Array:
        """The rows (n, k) without missing numbers; `lines` keeps the same rows."""
        missing = np.isnan(values)
        complete = ~missing.any(axis=1)
        self.incomplete = int(np.count_nonzero(~complete))
        if self.incomplete and not (self.drops and complete.any()):
            row, k = np.argwhere(missing)[0]
            text = self._cells(int(row) + self.first)[self.positions[k]][1].strip()
            problem = f"{text!r} in column {self.columns[k]!r} is not a finite number"
            count = f"a number is missing in {self.incomplete:,} of {len(values):,} rows"
            remedy = "correct the cells"
            remedy += ", or ignore such rows with missing=drop" if complete.any() else ""
            raise self.fault(self.columns[k], int(row), f"{problem}; {count}; {remedy}")
        rows = [*range(self.first), *(np.flatnonzero(complete) + self.first).tolist()]
        self.lines = [self.lines[row] for row in rows]
        self.line_numbers = [self.line_numbers[row] for row in rows]
        return np.asarray(values[complete])

    def fault(self, name: str, row: int | None, problem: str) -> CSVError:
        """An error about the header of a column, or about its cell in a row counted from 0."""
        line = 0 if row is None else row + self.first
        column = self._cells(line)[self.positions[self.columns.index(name)]][0]
        return self._error(line, column, problem)

    def _plain_block(self, start: int, stop: int) -> Array | None:
        """Rows of numbers, read at once, or None unless every cell is plainly a number."""
        lines = self.lines[self.first + start : self.first + stop]
        text = "\n".join(lines)
        if not text.isascii() or '"' in text or text.isspace():
            return None
        if any(line.count(self.delimiter) != self.width - 1 for line in lines):
            return None
        if self.decimal == ",":
            if "." in text or self.delimiter == ",":
                return None
            lines = text.replace(",", ".").split("\n")
        try:
            values = np.loadtxt(
                lines, delimiter=self.delimiter, comments=None, usecols=self.positions, ndmin=2
            )
        except ValueError:
            return None
        whole = values.shape == (len(lines), len(self.columns)) and np.isfinite(values).all()
        return values if whole else None

    def _row(self, row: int) -> list[float]:
        """The numbers of a row, read cell by cell; raises CSVError at the first invalid cell."""
        line = row + self.first
        cells = self._cells(line)
        if len(cells) != self.width:
            remedy = "add or remove cells, and write decimals with a point"
            if self.delimiter != ",":
                remedy = "add or remove cells"
            if not self.lines[line].strip():
                remedy = "remove the empty line"
            problem = f"{len(cells)} cells; every row must have {self.width}; {remedy}"
            raise self._error(line, 1, problem)
        values = []
        for name, position in zip(self.columns, self.positions, strict=True):
            column, text = cells[position]
            value = _number(text, self.decimal)
            if text.strip().lower() in NO_NUMBER:
                value = math.nan
            if value is None:
                problem = f"{text.strip()[:40]!r} in column {name!r} is not a finite number"
                remedy = "correct the cell, remove the row, or ignore it with drop_rows"
                if TIME.search(text):
                    remedy = "write times as seconds since the first row"
                other_decimal = "comma" if self.decimal == "." else "point"
                if _number(text, DECIMALS[other_decimal]) is not None:
                    remedy = f"write decimals with '{self.decimal}', or set decimal={other_decimal}"
                raise self._error(line, column, f"{problem}; {remedy}")
            values.append(value)
        return values

    def _cells(self, line: int) -> list[tuple[int, str]]:
        """The cells of a line (from 0): the first column of each (from 1), and its text."""
        text = self.lines[line]
        cells = []
        start = 0
        while True:
            match = self.cell.match(text, start)
            if match is None:
                quote = text.index('"', start) + 1
                problem = "quote inside a cell or never closed"
                remedy = "quote whole cells on one line, or none"
                raise self._error(line, quote, f"{problem}; {remedy}")
            quoted = match[1]
            cells.append((start + 1, match[2] if quoted is None else quoted.replace('""', '"')))
            start = match.end() + 1
            if start > len(text):
                return cells


def _number(cell: str, decimal: str = ".") -> float | None:
    """The cell's value if it is a finite number in CSV notation, else None."""
    if not cell.isascii() or "_" in cell or (decimal == "," and "." in cell):
        return None
    if decimal == ",":
        cell = cell.replace(",", ".")
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
