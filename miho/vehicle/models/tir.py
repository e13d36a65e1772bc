"""Reading a `MagicFormula` from a tire property file (.tir), and writing it."""

from __future__ import annotations

import os
import warnings
from math import isfinite, isinf
from pathlib import Path

from miho.vehicle.models.magic_formula import MagicFormula
from miho.vehicle.models.magic_formula_parameters import (
    CONSTANTS,
    InvalidParameterError,
    MagicFormulaParameters,
    Version,
    parameter_names,
    required_names,
)
from miho.vehicle.models.tir_format import KEYS, SECTION_OF, SI_UNITS, TURNSLIP_NAMES
from miho.vehicle.models.tir_reader import (
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
"""Version of the Magic Formula for each value of FITTYP."""


def write_tir(file: PropertyFile | MagicFormula, path: str | os.PathLike[str]) -> None:
    """Write a property file in SI units, without comments.

    Reading the file gives the same numbers bit for bit. Of a `MagicFormula`, only the parameters
    are written; infinite ranges and the other fields are not part of a property file.

    Parameters
    ----------
    file : PropertyFile or MagicFormula
        Content of the file.
    path : str or PathLike
        File to write; an existing file is replaced.

    Raises
    ------
    ValueError
        If text or numbers cannot be represented in a property file.
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
    """Load the tire of a property file: MF 5.2 (FITTYP 5, 6, 21, 52 or absent), 6.1 or 6.2.

    The file must contain every coefficient in the force equations of its version. Scaling factors
    default to 1 (LMUV to 0), and missing ranges are unlimited.

    Parameters
    ----------
    path : str or PathLike
        The .tir file.
    strict : bool, optional
        By default, unknown sections, unknown keys and unreadable lines are errors. If false, they
        are ignored unless a force depends on them, a warning lists the unreadable lines, and
        blank ranges are unlimited.

    Returns
    -------
    MagicFormula
        The tire, in SI units and radians.

    Raises
    ------
    TirError
        If the file cannot be used; the message has path, line and column.

    Examples
    --------
    >>> import miho
    >>> from miho.vehicle.data import embedded_tire
    >>> tire = miho.load_tir(embedded_tire("lf"))
    >>> tire.parameters.version, tire.parameters.FNOMIN
    ('6.1', 3114.0)
    """
    file, faults = read_lines(os.fspath(path), strict=strict)
    version = _version(file)

    # Faults in lines that a force depends on are always errors, others only if strict.
    needed = [fault for fault in faults if _is_needed(fault, version)]
    raise_first([fault.error for fault in needed], [fault.place for fault in needed])
    if strict:
        _check_vocabulary(file, version)
    elif faults:
        places = ", ".join(fault.place for fault in faults)
        warnings.warn(
            f"{file.path}: ignored {len(faults)} unreadable lines that no force depends on: "
            f"{places}",
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
    """Return whether a force depends on a line with a unit, version, coefficient or range."""
    if (fault.section, fault.key) == ("MODEL", "FITTYP"):
        return True
    if fault.section == "UNITS":
        return fault.key in KEYS["UNITS"]
    limits = fault.section.endswith("_RANGE")
    read = fault.key in parameter_names(version) and SECTION_OF[fault.key] == fault.section
    return read and not (limits and fault.blank)


def _coefficients(file: PropertyFile, version: Version) -> dict[str, float]:
    """Return the parameters in a file; raises TirError if a required one is missing."""
    values: dict[str, float] = {}
    missing: dict[str, list[str]] = {}
    for name in sorted(parameter_names(version)):
        section = SECTION_OF[name]
        value = file.sections.get(section, {}).get(name)
        if isinstance(value, str):
            problem = f"expected a number for {name}, got the text {printable(value)}"
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
        problem = f"FITTYP = {printable(fittyp)} is not a supported Magic Formula version"
        remedy = f"use one of {', '.join(f'{number:g}' for number in VERSIONS)}"
        raise file.error("MODEL", "FITTYP", problem, remedy)
    return VERSIONS[fittyp]


def _check_vocabulary(file: PropertyFile, version: Version) -> None:
    """Refuse sections and keys that the version does not have."""
    errors, places = [], []
    entries = [(section, key) for section in file.sections for key in ("", *file.sections[section])]
    for section, key in entries:
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
        problem = f"[{present[1]}] is another name of the section [{present[0]}]"
        raise file.error(present[1], "", problem, "keep one of the two")


def _property_file(parameters: MagicFormulaParameters) -> PropertyFile:
    """Return the property file with the parameters of the version, without infinite ranges."""
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
    """Return the text of a value in a file; raises ValueError for text that cannot be quoted."""
    if isinstance(value, float | int):
        return repr(float(value)).removesuffix(".0")  # some readers take FITTYP for a whole number
    if not value.isprintable() or "'" in value:
        raise ValueError(
            f"[{section}] {key}: {value!r} cannot be quoted; use printable text without '"
        )
    return f"'{value}'"
