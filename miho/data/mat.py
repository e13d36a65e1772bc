"""Measurements in MATLAB files: each column a variable of numbers."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import scipy.io
from numpy.typing import NDArray

from miho.data.dataset import Dataset, file_name
from miho.data.measurements import Fault, Layout

Array = NDArray[np.float64]
T = TypeVar("T")

MAX_BYTES = 64 * 2**20
MAX_INFLATED = 128 * 2**20
MAX_ROWS = 4_000_000
CHUNK = 2**20
COMPRESSED = 15  # miCOMPRESSED, MAT-File Format 5, table 1-1
NUMBERS = (
    "double",
    "single",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
)
DAMAGE = (
    ValueError, TypeError, LookupError, NotImplementedError, ArithmeticError, EOFError, MemoryError,
    OSError, zlib.error, scipy.io.matlab.MatReadError,
)  # fmt: skip
"""What SciPy raises for files that are not what they say."""


def load_mat(
    path: str,
    columns: Sequence[str],
    units: Sequence[str],
    output: str,
    headers: Sequence[str] | None = None,
    convention: str = "iso-w",
    flip: Sequence[str] = (),
    ranges: Mapping[str, Sequence[float] | None] | None = None,
    held_out: Mapping[str, Sequence[float]] | None = None,
    name: str | None = None,
) -> Dataset:
    """A dataset from a MATLAB file of version 5 to 7.2, in SI units, radians and ISO-W signs.

    `headers` are the names of the variables, vectors of numbers, if they differ from `columns`;
    all other settings are those of `miho.data.measurements.Layout`. Only these variables are read,
    by SciPy, and nothing in the file is run; objects and functions are refused unread. Raises
    ValueError naming the file and the variable, FileNotFoundError if there is no file.
    """
    layout = Layout(columns, units, output, headers, convention, flip, ranges, held_out)
    _check(Path(path))

    def fault(variable: str, row: int | None, problem: str) -> ValueError:
        element = "" if row is None else f"({row + 1})"
        return ValueError(f"{path}: {variable}{element}: {problem}")

    known = {key: (shape, kind) for key, shape, kind in _told(path, lambda: scipy.io.whosmat(path))}
    for variable in layout.names:
        _check_variable(variable, known, fault)
    wanted = list(layout.names)
    found = _told(path, lambda: scipy.io.loadmat(path, variable_names=wanted))
    numbers = {}
    for variable in wanted:
        column = np.asarray(found[variable]).ravel()
        _check_numbers(variable, column, fault)
        numbers[variable] = column.astype(float)
    first = layout.names[0]
    for variable, column in numbers.items():
        if column.size != numbers[first].size:
            problem = f"{column.size} numbers, but {first} has {numbers[first].size}"
            raise fault(variable, None, f"{problem}; choose variables of one length")
    return layout.dataset(name or file_name(path), numbers, fault)


def _told(path: str, read: Callable[[], T]) -> T:
    """What SciPy reads, or one line for whatever it raises."""
    try:
        return read()
    except DAMAGE:
        raise ValueError(f"{path}: is damaged; copy or save it again") from None


def _check(file: Path) -> None:
    """Refuse what is no MATLAB file of these versions, by its size and first bytes."""
    if file.exists() and not file.is_file():
        raise ValueError(f"{file}: is not a file; name one")
    try:
        with file.open("rb") as stream:
            head = stream.read(1024)
    except PermissionError:
        raise ValueError(f"{file}: cannot be read; check its permissions") from None
    if head.startswith(b"MATLAB 7.3 MAT-file") or b"\x89HDF\r\n\x1a\n" in head:
        raise ValueError(f"{file}: MATLAB 7.3 file; save it with save(..., '-v7')")
    if not head.startswith(b"MATLAB 5.0 MAT-file") or head[126:128] not in (b"IM", b"MI"):
        raise ValueError(f"{file}: not a MATLAB file; save one with save(..., '-v7')")
    if file.stat().st_size > MAX_BYTES:
        raise ValueError(f"{file}: larger than {MAX_BYTES >> 20} MiB; save fewer variables or rows")
    if _inflated(file, "<" if head[126:128] == b"IM" else ">") > MAX_INFLATED:
        raise ValueError(
            f"{file}: holds more than {MAX_INFLATED >> 20} MiB when decompressed; save fewer "
            "variables or rows"
        )


def _inflated(file: Path, order: str) -> int:
    """Bytes that the compressed variables of a file would take, counted up to MAX_INFLATED.

    SciPy makes room for what a variable says of its size, in memory. Nothing is kept here.
    """
    total = 0
    with file.open("rb") as stream:
        stream.seek(128)
        while len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind != COMPRESSED:
                stream.seek(size, os.SEEK_CUR)
                continue
            inflate = zlib.decompressobj()
            packed = stream.read(size)
            while packed and not inflate.eof and total <= MAX_INFLATED:
                try:
                    total += len(inflate.decompress(packed, CHUNK))
                except zlib.error:
                    break  # SciPy says what is wrong with it
                packed = inflate.unconsumed_tail
    return total


def _check_variable(
    name: str, known: Mapping[str, tuple[tuple[int, ...], str]], fault: Fault
) -> None:
    if name not in known:
        names = ", ".join(sorted(repr(other)[1:-1] for other in known if other)[:40])
        raise fault(name, None, f"no such variable; choose headers from {names or 'another file'}")
    shape, kind = known[name]
    if kind not in NUMBERS:
        raise fault(name, None, f"is of class {kind}; save it as a vector of numbers")
    if len(shape) != 2 or min(shape) != 1 or max(shape) > MAX_ROWS:
        problem = f"has size {'x'.join(map(str, shape))}"
        raise fault(name, None, f"{problem}; save a vector of 1 to {MAX_ROWS} numbers")


def _check_numbers(name: str, column: NDArray[np.generic], fault: Fault) -> None:
    if np.iscomplexobj(column):
        raise fault(name, None, "is of class complex; save it as a vector of numbers")
    bad = np.flatnonzero(~np.isfinite(column.astype(float)))
    if bad.size:
        row = int(bad[0])
        problem = f"is {float(column[row]):g}, not a finite number; remove the row"
        raise fault(name, row, problem)
