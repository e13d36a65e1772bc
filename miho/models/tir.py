"""Tire property files (.tir): a strict reader, a writer, and the way to a `MagicFormula`."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, isinf, prod
from pathlib import Path
from typing import NamedTuple, NoReturn

from miho.models.magic_formula import MagicFormula
from miho.models.magic_formula_parameters import (
    CONSTANTS,
    InvalidParameterError,
    MagicFormulaParameters,
    Version,
    parameter_names,
    required_names,
)
from miho.models.tir_format import (
    DIMENSIONS,
    KEYS,
    PRESSURE,
    PRESSURE_FACTORS,
    SECTION_OF,
    SI_UNITS,
    TABLES,
    TURNSLIP_NAMES,
    UNIT_FACTORS,
    Dimension,
)
from miho.regular_file import NotAFileError, read_regular

MAX_BYTES = 4 * 2**20
MAX_LINE = 10_000
MAX_LISTED = 60
"""So many further faults are named in the message of the first."""

_VERSIONS: dict[float, Version] = {
    5: "5.2", 6: "5.2", 21: "5.2", 52: "5.2", 61: "6.1", 62: "6.2",
}  # fmt: skip

_LINE_END = re.compile(r"\r\n|\r|\n")
_CONTENT = re.compile(r"""(?:[^$!#'"]|'[^']*'|"[^"]*")*""")  # up to a comment
_HEADER = re.compile(r"\[\s*([A-Za-z_][A-Za-z0-9_ ]*?)\s*\]")
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x0c\x0e-\x1f\x7f]")

Value = float | str


class TirError(ValueError):
    """A property file that cannot be used; one line `path:line:column: problem; remedy`."""

    @classmethod
    def at(cls, path: str, line: int, column: int, problem: str, remedy: str) -> TirError:
        """Line and column count from 1; the path is made printable so that one line stays one."""
        printable = path if path.isprintable() else repr(path)
        return cls(f"{printable}:{line}:{column}: {problem}; {remedy}")


@dataclass(frozen=True)
class Table:
    """Rows of numbers in SI units, such as [SHAPE]; `columns` as the file names them, or ()."""

    columns: tuple[str, ...] = ()
    rows: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class PropertyFile:
    """What a .tir file says, in SI units and radians; sections and keys in the file's order.

    [UNITS] therefore always reads meter, newton, radian, kg, second. Names are upper case.
    `places` gives (line, column) of each value under (section, key) and of each section header
    under (section, ""); it, `path` and `lines` say where things stood and do not count in ==.
    """

    sections: Mapping[str, Mapping[str, Value]]
    tables: Mapping[str, Table] = field(default_factory=dict)
    path: str = field(default="<memory>", compare=False)
    places: Mapping[tuple[str, str], tuple[int, int]] = field(default_factory=dict, compare=False)
    lines: int = field(default=1, compare=False)

    def error(self, section: str, key: str, problem: str, remedy: str) -> TirError:
        """An error at that key, else at its section's header, else at the last line."""
        last = (self.lines, 1)
        place = self.places.get((section, key)) or self.places.get((section, "")) or last
        return TirError.at(self.path, *place, problem, remedy)


def read_tir(path: str | os.PathLike[str]) -> PropertyFile:
    """Read a property file: any line ends, `$ ! #` comments, latin-1, quoted strings, tables.

    Numbers are converted to SI by [UNITS], which is required. Unknown sections and keys are kept
    as they are. Raises `TirError` for anything that cannot be read with certainty.
    """
    return _read(os.fspath(path), strict=True)[0]


def _read(name: str, *, strict: bool) -> tuple[PropertyFile, list[_Fault]]:
    """The file, and the lines that were left out because they cannot be read; none if strict."""
    reader = _Reader(name)
    for number, raw in enumerate(_lines(name), start=1):
        reader.read_line(number, raw)
    if strict:
        _refuse([fault.error for fault in reader.faults], [_where(f) for f in reader.faults])
    return reader.finish(), reader.faults


def _where(fault: _Fault) -> str:
    return f"{fault.key or 'a line'} in line {fault.line}"


def _refuse(errors: Sequence[TirError], places: Sequence[str]) -> None:
    """Raise the first of these errors, if any, with the places of the others in the same line."""
    if len(errors) > 1:
        more = ", ".join(places[1 : MAX_LISTED + 1]) + ", ..." * (len(places) > MAX_LISTED + 1)
        raise TirError(f"{errors[0]}; likewise {len(places) - 1} more: {more}")
    if errors:
        raise errors[0]


def write_tir(file: PropertyFile | MagicFormula, path: str | os.PathLike[str]) -> None:
    """Write in SI units; reading it back gives the same numbers bit for bit. No comments.

    Of a `MagicFormula` its parameters are written, so that `load_tir` gives the same tire; its
    other fields are not part of a property file, nor are ranges that do not limit. Raises
    `ValueError` for text or numbers that a property file cannot hold.
    """
    if isinstance(file, MagicFormula):
        file = _property_file(file.parameters)
    lines = []
    for name, entries in file.sections.items():
        lines.append(f"[{name}]")
        for key, value in entries.items():
            lines.append(f"{key:<24} = {_written(name, key, value)}")
        table = file.tables.get(name, Table())
        if table.columns:
            lines.append("{" + " ".join(table.columns) + "}")
        lines += [" ".join(repr(float(number)) for number in row) for row in table.rows]
        lines.append("")
    Path(path).write_bytes("\n".join(lines).encode("latin-1"))


def load_tir(path: str | os.PathLike[str], strict: bool = True) -> MagicFormula:
    """The tire a property file describes: MF 5.2 (FITTYP 5, 6, 21, 52 or absent), 6.1 or 6.2.

    Every coefficient the version's force equations read must be there; scaling factors default
    to 1 (LMUV to 0) and absent ranges do not limit. `strict` refuses sections and keys that the
    version does not have, and lines that cannot be read; without it they are ignored if no force
    needs them, unreadable ones with one warning that lists them. Raises `TirError`.
    """
    file, faults = _read(os.fspath(path), strict=strict)
    version = _version(file)
    needed = [f for f in faults if f.key in parameter_names(version) | {*UNIT_FACTORS, "FITTYP"}]
    _refuse([fault.error for fault in needed], [_where(fault) for fault in needed])
    if strict:
        _check_vocabulary(file, version)
    elif faults:
        left_out = ", ".join(_where(fault) for fault in faults)
        warnings.warn(
            f"{file.path}: {len(faults)} lines that no force needs cannot be read and are left "
            f"out: {left_out}",
            UserWarning,
            stacklevel=2,
        )
    values: dict[str, float] = {}
    missing: dict[str, list[str]] = {}
    for name in sorted(parameter_names(version)):
        section = SECTION_OF[name]
        value = file.sections.get(section, {}).get(name)
        if isinstance(value, str):
            raise file.error(section, name, f"{name} is the text {_shown(value)}", "write a number")
        if value is not None:
            values[name] = value
        elif name in required_names(version):
            missing.setdefault(section, []).append(name)
    for section, names in missing.items():
        raise file.error(
            section,
            "",
            f"[{section}] lacks {', '.join(names)}, which MF {version} needs",
            "add it" if len(names) == 1 else "add them",
        )
    try:
        parameters = MagicFormulaParameters(version=version, **{**CONSTANTS[version], **values})
    except InvalidParameterError as error:
        key = error.key
        raise file.error(SECTION_OF[key], key, str(error), "correct the value") from None
    return MagicFormula(parameters)


def _lines(path: str) -> list[str]:
    remedy = "give the path of a .tir file"
    try:
        data = read_regular(path, MAX_BYTES + 1)
    except (FileNotFoundError, NotADirectoryError):
        raise TirError.at(path, 1, 1, "there is no such file", remedy) from None
    except NotAFileError:
        raise TirError.at(path, 1, 1, "is not a file", remedy) from None
    except OSError as error:
        raise TirError.at(
            path, 1, 1, f"cannot be read ({error.strerror})", "check the permissions"
        ) from None
    if len(data) > MAX_BYTES:
        raise TirError.at(
            path, 1, 1, f"is larger than {MAX_BYTES} bytes", "a property file is a few kilobytes"
        )
    lines = _LINE_END.split(data.removeprefix(b"\xef\xbb\xbf").decode("latin-1"))
    for number, line in enumerate(lines, start=1):
        if len(line) > MAX_LINE:
            raise TirError.at(
                path, number, MAX_LINE + 1, f"line longer than {MAX_LINE} characters", "split it"
            )
        if found := _CONTROL.search(line):
            raise TirError.at(
                path,
                number,
                found.start() + 1,
                f"control character {found.group()!r}",
                "save the file as plain text (latin-1 or UTF-8)",
            )
    return lines[:-1] if len(lines) > 1 and not lines[-1] else lines


class _Fault(NamedTuple):
    """A line that cannot be read as KEY = value; the key is "" where there is none."""

    line: int
    key: str
    error: TirError


class _Reader:
    """Collects one file line by line; `finish` converts the units.

    Lines that spoil no other are kept as `faults`.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.faults: list[_Fault] = []
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
            self.fail(column, f"{_shown(text)} before the first section", "begin with [MDI_HEADER]")
        elif self.section == "MDI_HEADER" and text[0] in "({'\"":
            return  # the header's free-text comment block
        elif "=" in text:
            self._entry(content)
        elif self.section in TABLES:
            self._row(text, column)
        else:
            problem = f"{_shown(text)} is not of the form KEY = value"
            self._keep("", self.error(column, problem, "add the '='"))

    def error(self, column: int, problem: str, remedy: str) -> TirError:
        return TirError.at(self.path, self.number, column, problem, remedy)

    def _keep(self, key: str, error: TirError) -> None:
        self.faults.append(_Fault(self.number, key, error))

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
            self.fail(column, f"{_shown(text)} is not a section header", "write [NAME] by itself")
        name = match.group(1).upper()
        if name in self.sections:
            line = self.places[name, ""][0]
            self.fail(column, f"section [{name}] was already in line {line}", "merge the two")
        self.section = name
        self.sections[name] = {}
        self.places[name, ""] = (self.number, column)

    def _entry(self, content: str) -> None:
        left, _, right = content.partition("=")
        column = len(left) - len(left.lstrip()) + 1
        key = left.strip().upper()
        if not _KEY.fullmatch(key):
            problem = f"{_shown(left.strip())} is not a key"
            self._keep("", self.error(column, problem, "use letters, digits and _"))
            return
        if key in self.sections[self.section]:
            line = self.places[self.section, key][0]
            self.fail(column, f"{key} was already given in line {line}", "keep one of the two")
        column = len(left) + 2 + len(right) - len(right.lstrip())
        try:
            self.sections[self.section][key] = self._value(right.strip(), column, key)
        except TirError as error:
            self._keep(key, error)
        self.places[self.section, key] = (self.number, column)

    def _value(self, text: str, column: int, key: str) -> Value:
        if not text:
            self.fail(column, f"{key} has no value", "write a number or a 'text'")
        if text[0] in "'\"":
            if text.find(text[0], 1) != len(text) - 1:
                self.fail(column, f"{_shown(text)} is more than one quoted text", "keep one")
            return text[1:-1].strip()
        return self._finite(text, column)

    def _finite(self, text: str, column: int) -> float:
        if not _NUMBER.fullmatch(text):
            remedy = "write a finite number such as -1.5e-3, or a quoted 'text'"
            self.fail(column, f"{_shown(text)} is not a number", remedy)
        value = float(text)
        if not isfinite(value):
            self.fail(column, f"{_shown(text)} is not a finite number", "write a smaller number")
        return value

    def _row(self, text: str, column: int) -> None:
        width = len(TABLES[self.section])
        names = text[1:-1].split() if text.startswith("{") and text.endswith("}") else None
        if names is not None:
            if self.section in self.columns or self.section in self.rows:
                self.fail(column, "column names after the first row", "name the columns once")
            if len(names) != width:
                self.fail(column, f"{len(names)} column names, {width} columns", "name each one")
            self.columns[self.section] = tuple(names)
            return
        row = tuple(
            self._finite(cell.group(), column + cell.start()) for cell in re.finditer(r"\S+", text)
        )
        if len(row) != width:
            self.fail(column, f"{len(row)} numbers in a row of [{self.section}]", f"give {width}")
        self.places[self.section, f"row {len(self.rows.get(self.section, ()))}"] = (
            self.number,
            column,
        )
        self.rows.setdefault(self.section, []).append(row)

    def finish(self) -> PropertyFile:
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
    units = file.sections.get("UNITS")
    if units is None:
        raise file.error("UNITS", "", "there is no [UNITS] section", "add it: numbers need units")
    factors = []
    for quantity, known in UNIT_FACTORS.items():
        unit = units.get(quantity)
        if unit is None:
            remedy = f"add {quantity} = '{SI_UNITS[quantity]}' or what it is"
            raise file.error("UNITS", "", f"[UNITS] lacks {quantity}", remedy)
        if not isinstance(unit, str) or unit.lower() not in known:
            problem = f"{_shown(unit)} is not a unit of {quantity}"
            raise file.error("UNITS", quantity, problem, f"use one of {', '.join(known)}")
        factors.append(known[unit.lower()])
    return tuple(factors)


def _pressure_factor(file: PropertyFile) -> float | None:
    """Factor to Pa of a unit of pressure of its own, which newer files have; None without one."""
    unit = file.sections["UNITS"].get("PRESSURE")
    if unit is None:
        return None
    if not isinstance(unit, str) or unit.lower() not in PRESSURE_FACTORS:
        problem = f"{_shown(unit)} is not a unit of PRESSURE"
        raise file.error("UNITS", "PRESSURE", problem, f"use one of {', '.join(PRESSURE_FACTORS)}")
    return PRESSURE_FACTORS[unit.lower()]


def _version(file: PropertyFile) -> Version:
    fittyp = file.sections.get("MODEL", {}).get("FITTYP")
    if fittyp is None:
        return "5.2"
    if isinstance(fittyp, str) or fittyp not in _VERSIONS:
        problem = f"FITTYP = {_shown(fittyp)} is not a Magic Formula version known here"
        remedy = f"use one of {', '.join(f'{number:g}' for number in _VERSIONS)}"
        raise file.error("MODEL", "FITTYP", problem, remedy)
    return _VERSIONS[fittyp]


def _check_vocabulary(file: PropertyFile, version: Version) -> None:
    errors, places = [], []
    for section, key in _entries(file):
        coefficient = section.endswith("_COEFFICIENTS") and key
        if section not in KEYS:
            problem = f"section [{section}] is unknown"
        elif key and key not in KEYS[section]:
            problem = f"key {key} is unknown in [{section}]"
        elif coefficient and key in CONSTANTS[version]:
            problem = f"key {key} does not exist in MF {version}"
        elif coefficient and isinstance(file.sections[section][key], str):
            problem = f"{key} is text, not a number"
        else:
            continue
        remedy = "correct or remove it, or load with strict=False"
        errors.append(file.error(section, key, problem, remedy))
        places.append(f"[{section}] {key}".strip())
    _refuse(errors, places)
    present = [name for name in TURNSLIP_NAMES if name in file.sections]
    if len(present) > 1:
        problem = f"[{present[1]}] is the same section as [{present[0]}]"
        raise file.error(present[1], "", problem, "keep one of the two")


def _entries(file: PropertyFile) -> Iterator[tuple[str, str]]:
    for section, entries in file.sections.items():
        yield section, ""
        for key in entries:
            yield section, key


def _shown(value: Value) -> str:
    """The value as it goes into a message: printable, on one line and not too long."""
    if isinstance(value, str):
        return repr(value if len(value) <= 40 else value[:39] + "…")
    return f"{value:g}"


def _property_file(parameters: MagicFormulaParameters) -> PropertyFile:
    version = parameters.version
    sections: dict[str, dict[str, Value]] = {
        "MDI_HEADER": {"FILE_TYPE": "tir", "FILE_VERSION": 3.0, "FILE_FORMAT": "ASCII"},
        "UNITS": dict(SI_UNITS),
        "MODEL": {"FITTYP": float(version.replace(".", ""))},
    }
    for name, value in vars(parameters).items():
        if name not in parameter_names(version) or (isinf(value) and name[-3:] in ("MIN", "MAX")):
            continue
        if not isfinite(value):
            raise ValueError(f"{name} is {value}; a property file can only hold finite numbers")
        sections.setdefault(SECTION_OF[name], {})[name] = value
    return PropertyFile(sections)


def _written(section: str, key: str, value: Value) -> str:
    if isinstance(value, float | int):
        return repr(float(value))
    if not value.isprintable() or "'" in value:
        raise ValueError(
            f"[{section}] {key}: {value!r} cannot stand between quotes; use plain text without '"
        )
    return f"'{value}'"
