"""From a tire property file (.tir) to a `MagicFormula`, and back."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from math import isfinite, isinf
from pathlib import Path

from miho.models.magic_formula import MagicFormula
from miho.models.magic_formula_parameters import (
    CONSTANTS,
    InvalidParameterError,
    MagicFormulaParameters,
    Version,
    parameter_names,
    required_names,
)
from miho.models.tir_format import KEYS, SECTION_OF, SI_UNITS, TURNSLIP_NAMES
from miho.models.tir_reader import (
    Fault,
    PropertyFile,
    Table,
    Value,
    printable,
    raise_first,
    read_lines,
)

VERSIONS: dict[float, Version] = {
    5: "5.2", 6: "5.2", 21: "5.2", 52: "5.2", 61: "6.1", 62: "6.2",
}  # fmt: skip
"""The version of the Magic Formula by FITTYP."""


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
            lines.append(f"{key:<24} = {_value_text(name, key, value)}")
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
    needs them, unreadable ones with one warning that lists them; a range that is left blank does
    not limit then. Raises `TirError`.
    """
    file, faults = read_lines(os.fspath(path), strict=strict)
    version = _version(file)

    # Faults in lines that a force needs are errors in any case, others only if strict.
    needed = [fault for fault in faults if _is_needed(fault, version)]
    raise_first([fault.error for fault in needed], [fault.place for fault in needed])
    if strict:
        _check_vocabulary(file, version)
    elif faults:
        places = ", ".join(fault.place for fault in faults)
        warnings.warn(
            f"{file.path}: {len(faults)} lines that no force needs cannot be read and are left "
            f"out: {places}",
            UserWarning,
            stacklevel=2,
        )

    values = {**CONSTANTS[version], **_coefficients(file, version)}
    try:
        parameters = MagicFormulaParameters(version=version, **values)
    except InvalidParameterError as error:
        key = error.key
        raise file.error(SECTION_OF[key], key, str(error), "correct the value") from None
    return MagicFormula(parameters)


def _is_needed(fault: Fault, version: Version) -> bool:
    """Whether a force depends on a line: on a unit, the version, a coefficient or a range."""
    if (fault.section, fault.key) == ("MODEL", "FITTYP"):
        return True
    if fault.section == "UNITS":
        return fault.key in KEYS["UNITS"]
    limits = fault.section.endswith("_RANGE")
    read = fault.key in parameter_names(version) and SECTION_OF[fault.key] == fault.section
    return read and not (limits and fault.blank)


def _coefficients(file: PropertyFile, version: Version) -> dict[str, float]:
    """The parameters of a version that the file has; raises TirError if it lacks a required one."""
    values: dict[str, float] = {}
    missing: dict[str, list[str]] = {}
    for name in sorted(parameter_names(version)):
        section = SECTION_OF[name]
        value = file.sections.get(section, {}).get(name)
        if isinstance(value, str):
            problem = f"{name} is the text {printable(value)}"
            raise file.error(section, name, problem, "write a number")
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
    return values


def _version(file: PropertyFile) -> Version:
    fittyp = file.sections.get("MODEL", {}).get("FITTYP")
    if fittyp is None:
        return "5.2"
    if isinstance(fittyp, str) or fittyp not in VERSIONS:
        problem = f"FITTYP = {printable(fittyp)} is not a Magic Formula version known here"
        remedy = f"use one of {', '.join(f'{number:g}' for number in VERSIONS)}"
        raise file.error("MODEL", "FITTYP", problem, remedy)
    return VERSIONS[fittyp]


def _check_vocabulary(file: PropertyFile, version: Version) -> None:
    """Refuse sections and keys that the version does not have."""
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
    raise_first(errors, places)
    present = [name for name in TURNSLIP_NAMES if name in file.sections]
    if len(present) > 1:
        problem = f"[{present[1]}] is the same section as [{present[0]}]"
        raise file.error(present[1], "", problem, "keep one of the two")


def _entries(file: PropertyFile) -> Iterator[tuple[str, str]]:
    """All (section, key) of a file, and (section, "") of each section itself."""
    for section, entries in file.sections.items():
        yield section, ""
        for key in entries:
            yield section, key


def _property_file(parameters: MagicFormulaParameters) -> PropertyFile:
    """The property file with the parameters of the version, without ranges that do not limit."""
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


def _value_text(section: str, key: str, value: Value) -> str:
    """A value as it stands in a file; raises ValueError for text that cannot."""
    if isinstance(value, float | int):
        return repr(float(value))
    if not value.isprintable() or "'" in value:
        raise ValueError(
            f"[{section}] {key}: {value!r} cannot stand between quotes; use plain text without '"
        )
    return f"'{value}'"
