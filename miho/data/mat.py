"""Measurements in MATLAB files: each column is a variable of numbers.

SciPy's compiled reader ends the process on some damaged files, so this reader is written in Python.
It supports the part of the MAT-File Format 5 that measurements need: real arrays of numbers,
compressed or not. Every size is checked before it is used.

References
----------
The MathWorks, "MAT-File Format", R2023b, ch. 1.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miho.data.dataset import Dataset, file_name
from miho.data.measurements import Fault, Layout
from miho.quantities import Array
from miho.regular_file import NotAFileError, read_regular

MAX_BYTES = 64 * 2**20
MAX_INFLATED = 128 * 2**20
MAX_ROWS = 4_000_000
CHUNK = 2**20
HEADER = 128

# Types of data elements (table 1-1) and their number formats.
INT8, INT32, UINT32, MATRIX, COMPRESSED, UTF8 = 1, 5, 6, 14, 15, 16
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8",
          13: "u8"}  # fmt: skip

# Classes of arrays (table 1-3): numbers with their formats, and others.
NUMBERS = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8",
           15: "u8"}  # fmt: skip
OTHERS = {1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 16: "function",
          17: "opaque"}  # fmt: skip
OPAQUE = 17
COMPLEX, LOGICAL = 0x0800, 0x0200  # flags next to the class


class DamagedError(ValueError):
    """Bytes that violate the format."""


@dataclass(frozen=True)
class Variable:
    """A variable: its class in words, its size, and the stored bytes of its numbers."""

    kind: str
    shape: tuple[int, ...]
    stored: np.dtype[np.generic]
    data: memoryview


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
    where: Mapping[str, Sequence[float]] | None = None,
    every: int = 1,
    name: str | None = None,
) -> Dataset:
    """Load a dataset from a MATLAB file of version 5 to 7.2, in SI units, radians and ISO-W signs.

    No code in the file is run; objects and functions are refused unread. Compressed variables,
    which MATLAB writes by default, have a checksum, so that damage is detected. Uncompressed
    variables (-v6) have no checksum: damage to their numbers goes unnoticed.

    Parameters
    ----------
    path : str
        The file.
    columns, units, output
        See `miho.data.measurements.Layout`.
    headers : sequence of str, optional
        Names of the variables, which are vectors of numbers, if they differ from `columns`.
    convention, flip, ranges, held_out, where, every
        See `miho.data.measurements.Layout`.
    name : str, optional
        Name of the dataset; by default the name of the file.

    Returns
    -------
    Dataset
        The selected rows.

    Raises
    ------
    ValueError
        For a fault in the file or an invalid setting.
    FileNotFoundError
        If the file does not exist.
    """
    layout = Layout(
        columns, units, output, headers, convention, flip, ranges, held_out, where, every
    )

    def fault(variable: str, row: int | None, problem: str) -> ValueError:
        element = "" if row is None else f"({row + 1})"
        return ValueError(f"{path}: {variable}{element}: {problem}")

    variables = read_variables(Path(path))
    numbers = {variable: _column(variable, variables, fault) for variable in layout.all_names}
    first = layout.names[0]
    for variable, column in numbers.items():
        if column.size != numbers[first].size:
            problem = f"{column.size} numbers, but {first} has {numbers[first].size}"
            raise fault(variable, None, f"{problem}; choose variables of one length")
    return layout.dataset(name or file_name(path), path, numbers, fault)


def read_variables(path: Path) -> dict[str, Variable]:
    """Variables of a file by name; raises ValueError if it is no such file or damaged."""
    try:
        data = read_regular(path, MAX_BYTES + 1)
    except NotAFileError as error:
        raise ValueError(str(error)) from None
    except PermissionError:
        raise ValueError(f"{path}: cannot be read; check its permissions") from None
    if data.startswith(b"MATLAB 7.3 MAT-file") or b"\x89HDF\r\n\x1a\n" in data[:1024]:
        raise ValueError(f"{path}: MATLAB 7.3 file; save it with save(..., '-v7')")
    if not data.startswith(b"MATLAB 5.0 MAT-file") or data[126:HEADER] not in (b"IM", b"MI"):
        raise ValueError(f"{path}: not a MATLAB file; save one with save(..., '-v7')")
    if len(data) > MAX_BYTES:
        raise ValueError(f"{path}: larger than {MAX_BYTES >> 20} MiB; save fewer variables or rows")
    order = "<" if data[126:HEADER] == b"IM" else ">"
    variables: dict[str, Variable] = {}
    try:
        if struct.unpack(f"{order}H", data[124:126]) != (0x0100,):
            raise DamagedError
        for matrix in _matrices(memoryview(data)[HEADER:], order):
            name, variable = _variable(matrix, order)
            if name in variables:
                raise DamagedError
            variables[name] = variable
    except MemoryError:
        raise ValueError(
            f"{path}: larger than {MAX_INFLATED >> 20} MiB when decompressed; save fewer "
            "variables or rows"
        ) from None
    except (DamagedError, zlib.error):
        raise ValueError(f"{path}: the file is damaged; copy or save it again") from None
    return variables


def _matrices(data: memoryview, order: str) -> Iterator[memoryview]:
    """Contents of the matrix elements in a file."""
    inflated = 0
    while data:
        kind, size, _ = _tag(data, order)
        content, data = data[8 : 8 + size], data[8 + size :]
        if kind == COMPRESSED:
            whole = _inflated(content, MAX_INFLATED - inflated, order)
            inflated += len(whole)
            kind, content = struct.unpack(f"{order}I", whole[:4])[0], whole[8:]
        if kind != MATRIX:
            raise DamagedError
        yield content


def _inflated(packed: memoryview, limit: int, order: str) -> memoryview:
    """Decompress an element, which must have the length in its tag and a valid checksum.

    Raises MemoryError before decompressing more than `limit` bytes.
    """
    inflate = zlib.decompressobj()
    whole = bytearray(inflate.decompress(packed, 8))
    if len(whole) < 8:
        raise DamagedError
    size = 8 + struct.unpack(f"{order}I", whole[4:])[0]
    if size > limit:
        raise MemoryError
    while not inflate.eof:
        chunk = inflate.decompress(inflate.unconsumed_tail, CHUNK)
        whole += chunk
        stuck = not chunk and not inflate.unconsumed_tail and not inflate.eof
        if stuck or len(whole) > size:
            raise DamagedError
    if inflate.unused_data or len(whole) != size:
        raise DamagedError
    return memoryview(whole)


def _tag(data: memoryview, order: str) -> tuple[int, int, bool]:
    """Type and size in bytes of the element that begins here, and whether it is a small one.

    A small element has its size in the upper half of its type, and its data in the same 8 bytes.
    """
    if len(data) < 8:
        raise DamagedError
    kind, size = struct.unpack(f"{order}II", data[:8])
    small = kind >> 16
    if small:
        kind, size = kind & 0xFFFF, small
    if size > (4 if small else len(data) - 8):
        raise DamagedError
    return kind, size, bool(small)


def _element(data: memoryview, order: str) -> tuple[int, memoryview, memoryview]:
    """Type and content of the element that begins here, and the data after its padding."""
    kind, size, small = _tag(data, order)
    if small:
        return kind, data[4 : 4 + size], data[8:]
    return kind, data[8 : 8 + size], data[8 + size + -size % 8 :]


def _variable(matrix: memoryview, order: str) -> tuple[str, Variable]:
    """Name and content of a matrix element; the content is read only if it is numbers."""
    # The flags, which contain the class, and the size.
    kind, flags, rest = _element(matrix, order)
    if kind != UINT32 or len(flags) != 8:
        raise DamagedError
    word = struct.unpack(f"{order}I", flags[:4])[0]
    number = word & 0xFF
    shape: tuple[int, ...] = ()
    if number != OPAQUE:
        kind, sizes, rest = _element(rest, order)
        if kind != INT32 or len(sizes) < 8 or len(sizes) % 4:
            raise DamagedError
        shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    # The name.
    kind, text, rest = _element(rest, order)
    if kind not in (INT8, UTF8) or min(shape, default=0) < 0:
        raise DamagedError
    name = bytes(text).decode("latin-1" if kind == INT8 else "utf-8", "replace")
    if number in OTHERS:
        return name, Variable(OTHERS[number], shape, np.dtype("V0"), rest[:0])
    if number not in NUMBERS:
        raise DamagedError
    # The numbers.
    own = np.dtype(order + NUMBERS[number])
    kind, content, rest = _element(rest, order)
    stored = np.dtype(order + STORED.get(kind, "V0"))
    # Numbers are stored in their format or, to save space, as smaller integers.
    smaller = stored.kind in "iu" and stored.itemsize < own.itemsize
    if not (stored == own or smaller) or len(content) != math.prod(shape) * stored.itemsize:
        raise DamagedError
    if word & COMPLEX:
        return name, Variable("complex", shape, stored, content)
    if rest:
        raise DamagedError
    return name, Variable("logical" if word & LOGICAL else "number", shape, stored, content)


def _column(name: str, variables: Mapping[str, Variable], fault: Fault) -> Array:
    """The numbers of a variable (N,), which must be a vector of finite numbers."""
    if name not in variables:
        names = ", ".join(sorted(repr(header)[1:-1] for header in variables if header)[:40])
        raise fault(name, None, f"no such variable; choose headers from {names or 'another file'}")
    variable = variables[name]
    if variable.kind != "number":
        raise fault(name, None, f"has class {variable.kind}; save it as a vector of numbers")
    shape = variable.shape
    if len(shape) != 2 or min(shape) != 1 or max(shape) > MAX_ROWS:
        problem = f"has size {'x'.join(map(str, shape))}"
        raise fault(name, None, f"{problem}; save a vector of 1 to {MAX_ROWS} numbers")
    column = np.frombuffer(variable.data, dtype=variable.stored).astype(float)
    bad = np.flatnonzero(~np.isfinite(column))
    if bad.size:
        row = int(bad[0])
        problem = f"is {float(column[row]):g}, not a finite number; remove the row"
        raise fault(name, row, problem)
    return column
