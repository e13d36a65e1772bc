"""A strict reader of tire property files (.tir), and the records that it returns."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isfinite, prod
from typing import NamedTuple, NoReturn

from miho.regular_file import NotAFileError, read_regular
from miho.vehicle.models.tir_format import (
    DIMENSIONS,
    PRESSURE,
    PRESSURE_FACTORS,
    SI_UNITS,
    TABLES,
    UNIT_FACTORS,
    Dimension,
)

MAX_BYTES = 4 * 2**20
MAX_LINE = 10_000
MAX_LISTED = 60
"""Largest number of further faults in the message of the first one."""

_LINE_END = re.compile(r"\r\n|\r|\n")
_CONTENT = re.compile(r"""(?:[^$!#'"]|'[^']*'|"[^"]*")*""")  # up to a comment
_HEADER = re.compile(r"\[\s*([A-Za-z_][A-Za-z0-9_ ]*?)\s*\]")
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x0c\x0e-\x1f\x7f]")

Value = float | str


class TirError(ValueError):
    """Error for a property file that cannot be used, as `path:line:column: problem; remedy`."""

    @classmethod
    def at(cls, path: str, line: int, column: int, problem: str, remedy: str) -> TirError:
        """Return an error at a line and column from 1, with a printable path on one line."""
        name = path if path.isprintable() else repr(path)
        return cls(f"{name}:{line}:{column}: {problem}; {remedy}")


@dataclass(frozen=True)
class Table:
    """Table of a section, for example [SHAPE], in SI units; `columns` are names, or ()."""

    columns: tuple[str, ...] = ()
    rows: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class PropertyFile:
    """Content of a .tir file in SI units and radians, with sections and keys in order.

    [UNITS] therefore always contains meter, newton, radian, kg and second. Names are upper case.
    `places` maps (section, key) to the (line, column) of a value, and (section, "") to the
    position of a header. `places`, `path` and `lines` serve for messages; == ignores them.
    """

    sections: Mapping[str, Mapping[str, Value]]
    tables: Mapping[str, Table] = field(default_factory=dict)
    path: str = field(default="<memory>", compare=False)
    places: Mapping[tuple[str, str], tuple[int, int]] = field(default_factory=dict, compare=False)
    lines: int = field(default=1, compare=False)

    def error(self, section: str, key: str, problem: str, remedy: str) -> TirError:
        """Return an error at a key, or at the section's header, or at the last line."""
        last = (self.lines, 1)
        place = self.places.get((section, key)) or self.places.get((section, "")) or last
        return TirError.at(self.path, *place, problem, remedy)


def read_tir(path: str | os.PathLike[str]) -> PropertyFile:
    """Read a property file: any line ends, `$ ! #` comments, latin-1, quoted strings, tables.

    Numbers are converted to SI units by [UNITS], which is required. Unknown sections and keys are
    kept unchanged. Raises `TirError` for any ambiguous or unreadable content.
    """
    return read_lines(os.fspath(path), strict=True)[0]


def read_lines(name: str, *, strict: bool) -> tuple[PropertyFile, list[Fault]]:
    """Return the content of a file and its unreadable lines, which are left out.

    If strict, raises TirError at the first unreadable line.
    """
    reader = _Reader(name)
    for number, raw in enumerate(_lines(name), start=1):
        reader.read_line(number, raw)
    if strict:
        raise_first([fault.error for fault in reader.faults], [f.place for f in reader.faults])
    return reader.property_file(), reader.faults


def raise_first(errors: Sequence[TirError], places: Sequence[str]) -> None:
    """Raise the first error, if any, with the places of the others in its message."""
    if len(errors) > 1:
        more = ", ".join(places[1 : MAX_LISTED + 1]) + ", ..." * (len(places) > MAX_LISTED + 1)
        raise TirError(f"{errors[0]}; likewise {len(places) - 1} more: {more}")
    if errors:
        raise errors[0]


class Fault(NamedTuple):
    """A line that cannot be read as KEY = value.

    The key is "" if the line has none. A line is `blank` if its key has no value.
    """

    line: int
    section: str
    key: str
    blank: bool
    error: TirError

    @property
    def place(self) -> str:
        """Key and line number as text."""
        return f"{self.key or 'a line'} in line {self.line}"


def _lines(path: str) -> list[str]:
    """Return the lines of a file; raises TirError if it cannot be a property file."""
    refused = partial(TirError.at, path)
    try:
        data = read_regular(path, MAX_BYTES + 1)
    except (FileNotFoundError, NotADirectoryError, NotAFileError) as error:
        problem = "is not a file" if isinstance(error, NotAFileError) else "there is no such file"
        raise refused(1, 1, problem, "give the path of a .tir file") from None
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
        raise refused(1, 1, problem, "check the permissions") from None
    if len(data) > MAX_BYTES:
        problem = f"is larger than {MAX_BYTES} bytes"
        raise refused(1, 1, problem, "a property file is a few kilobytes")
    lines = _LINE_END.split(data.removeprefix(b"\xef\xbb\xbf").decode("latin-1"))
    for number, line in enumerate(lines, start=1):
        if len(line) > MAX_LINE:
            problem = f"line longer than {MAX_LINE} characters"
            raise refused(number, MAX_LINE + 1, problem, "split it")
        if control := _CONTROL.search(line):
            problem = f"control character {control.group()!r}"
            remedy = "save the file as plain text (latin-1 or UTF-8)"
            raise refused(number, control.start() + 1, problem, remedy)
    return lines[:-1] if len(lines) > 1 and not lines[-1] else lines


class _Reader:
    """Reads a file line by line; `property_file` returns the content in SI units.

    Unreadable lines that do not affect other lines are collected in `faults`.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.faults: list[Fault] = []
        self.number = 1
        self.section = ""
        self.sections: dict[str, dict[str, Value]] = {}
        self.places: dict[tuple[str, str], tuple[int, int]] = {}
        self.columns: dict[str, tuple[str, ...]] = {}
        self.rows: dict[str, list[tuple[float, ...]]] = {}

    def fail(self, column: int, problem: str, remedy: str) -> NoReturn:
        raise self.error(column, problem, remedy)

    def read_line(self, number: int, raw: str) -> None:
        self.number = number
        content = self._without_comment(raw)
        text = content.strip()
        column = len(content) - len(content.lstrip()) + 1
        if not text:
            return
        if text.startswith("["):
            self._header(text, column)
        elif not self.section:
            problem = f"{printable(text)} before the first section"
            self.fail(column, problem, "begin with [MDI_HEADER]")
        elif self.section == "MDI_HEADER" and text[0] in "({'\"":
            return  # free-text comment of the header
        elif "=" in text:
            self._entry(content)
        elif self.section in TABLES:
            self._row(text, column)
        else:
            problem = f"{printable(text)} is not of the form KEY = value"
            self._add_fault("", self.error(column, problem, "add the '='"))

    def error(self, column: int, problem: str, remedy: str) -> TirError:
        return TirError.at(self.path, self.number, column, problem, remedy)

    def _add_fault(self, key: str, error: TirError, blank: bool = False) -> None:
        self.faults.append(Fault(self.number, self.section, key, blank, error))

    def _without_comment(self, raw: str) -> str:
        match = _CONTENT.match(raw)
        content = match.group() if match else ""
        rest = raw[len(content) :]
        if rest[:1] in ("'", '"'):
            self.fail(len(content) + 1, f"quote {rest[0]} is never closed", "close it")
        return content

    def _header(self, text: str, column: int) -> None:
        match = _HEADER.fullmatch(text)
        if not match:
            self.fail(column, f"{printable(text)} is not a section header", "write [NAME] alone")
        name = match.group(1).upper()
        if name in self.sections:
            line = self.places[name, ""][0]
            self.fail(column, f"section [{name}] is already in line {line}", "merge the two")
        self.section = name
        self.sections[name] = {}
        self.places[name, ""] = (self.number, column)

    def _entry(self, content: str) -> None:
        name_part, _, value_part = content.partition("=")
        column = len(name_part) - len(name_part.lstrip()) + 1
        key = name_part.strip().upper()
        if not _KEY.fullmatch(key):
            problem = f"{printable(name_part.strip())} is not a key"
            self._add_fault("", self.error(column, problem, "use letters, digits and _"))
            return
        if key in self.sections[self.section]:
            line = self.places[self.section, key][0]
            self.fail(column, f"{key} is already given in line {line}", "keep one of the two")
        column = len(name_part) + 2 + len(value_part) - len(value_part.lstrip())
        try:
            self.sections[self.section][key] = self._value(value_part.strip(), column, key)
        except TirError as error:
            self._add_fault(key, error, blank=not value_part.strip())
        self.places[self.section, key] = (self.number, column)

    def _value(self, text: str, column: int, key: str) -> Value:
        if not text:
            self.fail(column, f"{key} has no value", "write a number or a 'text'")
        if text[0] in "'\"":
            if text.find(text[0], 1) != len(text) - 1:
                self.fail(column, f"{printable(text)} is more than one quoted text", "keep one")
            return text[1:-1].strip()
        return self._finite(text, column)

    def _finite(self, text: str, column: int) -> float:
        if not _NUMBER.fullmatch(text):
            remedy = "write a finite number, for example -1.5e-3, or a quoted 'text'"
            self.fail(column, f"{printable(text)} is not a number", remedy)
        value = float(text)
        if not isfinite(value):
            self.fail(column, f"{printable(text)} is not a finite number", "write a smaller number")
        return value

    def _row(self, text: str, column: int) -> None:
        width = len(TABLES[self.section])
        names = text[1:-1].split() if text.startswith("{") and text.endswith("}") else None
        if names is not None:
            if self.section in self.columns or self.section in self.rows:
                self.fail(column, "column names after the first row", "name the columns once")
            if len(names) != width:
                problem = f"expected {width} column names, got {len(names)}"
                self.fail(column, problem, "name each column")
            self.columns[self.section] = tuple(names)
            return
        row = tuple(
            self._finite(cell.group(), column + cell.start()) for cell in re.finditer(r"\S+", text)
        )
        if len(row) != width:
            problem = f"expected {width} numbers in a row of [{self.section}], got {len(row)}"
            self.fail(column, problem, f"write {width} numbers")
        rows = self.rows.setdefault(self.section, [])
        self.places[self.section, f"row {len(rows)}"] = self.number, column
        rows.append(row)

    def property_file(self) -> PropertyFile:
        # Factors to SI units, from [UNITS] before it is converted.
        file = PropertyFile(self.sections, {}, self.path, self.places, self.number)
        factors = _unit_factors(file)
        pressure = _pressure_factor(file)

        def si(section: str, key: str, value: float, dimension: Dimension) -> float:
            factor = prod(f**n for f, n in zip(factors, dimension, strict=True))
            if dimension == PRESSURE and pressure is not None:
                factor = pressure
            converted = value * factor
            if not isfinite(converted):
                problem = f"{value} is not finite in SI units"
                raise file.error(section, key, problem, "write a smaller number")
            return converted

        # Single values, then [UNITS] itself, then tables, column by column.
        for (section, key), dimension in DIMENSIONS.items():
            value = self.sections.get(section, {}).get(key)
            if isinstance(value, float):
                self.sections[section][key] = si(section, key, value, dimension)
        self.sections["UNITS"].update(SI_UNITS)
        if pressure is not None:
            self.sections["UNITS"]["PRESSURE"] = "pascal"
        tables = {
            section: Table(
                self.columns.get(section, ()),
                tuple(
                    tuple(
                        si(section, f"row {i}", number, dimension)
                        for number, dimension in zip(row, dimensions, strict=True)
                    )
                    for i, row in enumerate(self.rows.get(section, ()))
                ),
            )
            for section, dimensions in TABLES.items()
            if section in self.sections
        }
        return PropertyFile(self.sections, tables, self.path, self.places, self.number)


def _unit_factors(file: PropertyFile) -> tuple[float, ...]:
    """Return the factors to SI units of length, force, angle, mass and time."""
    units = file.sections.get("UNITS")
    if units is None:
        raise file.error("UNITS", "", "there is no [UNITS] section", "add it with all units")
    factors = []
    for quantity, factor_of in UNIT_FACTORS.items():
        unit = units.get(quantity)
        if unit is None:
            remedy = f"add {quantity} = '{SI_UNITS[quantity]}' or the unit of the file"
            raise file.error("UNITS", "", f"[UNITS] lacks {quantity}", remedy)
        if not isinstance(unit, str) or unit.lower() not in factor_of:
            problem = f"{printable(unit)} is not a unit of {quantity}"
            raise file.error("UNITS", quantity, problem, f"use one of {', '.join(factor_of)}")
        factors.append(factor_of[unit.lower()])
    return tuple(factors)


def _pressure_factor(file: PropertyFile) -> float | None:
    """Return the factor to Pa of the unit of pressure, None if the file has none."""
    unit = file.sections["UNITS"].get("PRESSURE")
    if unit is None:
        return None
    if not isinstance(unit, str) or unit.lower() not in PRESSURE_FACTORS:
        problem = f"{printable(unit)} is not a unit of PRESSURE"
        raise file.error("UNITS", "PRESSURE", problem, f"use one of {', '.join(PRESSURE_FACTORS)}")
    return PRESSURE_FACTORS[unit.lower()]


def printable(value: Value) -> str:
    """Return a value for a message: printable, short and on one line."""
    if isinstance(value, str):
        return repr(value if len(value) <= 40 else value[:39] + "…")
    return f"{value:g}"
