"""The curves of many runs in one file, which reads several times as fast as their own files.

    root/.compact/curves    <SHA-256 of all that follows>, <header as JSON>, columns of float64

It is a cache and can always be rebuilt. Each curve is filed under the SHA-256 of the `curve.json`
it was read from, so a run that was added, changed or replaced since then is never given another
one's numbers. Like every checksum here it finds damage and no forgery.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
from array import array
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import orjson
from filelock import FileLock

from miho.study.files import LARGEST
from miho.study.identity import canonical
from miho.study.places import inside
from miho.study.scan import CheckedRun, scan

FOLDER, NAME = ".compact", "curves"
FORMAT = 1
COLUMNS = ("evaluations", "seconds", "cpu_seconds", "error")
DOUBLE = 8
DIGEST = 64


@dataclass
class Curves:
    """Many curves, one after the other.

    `columns` are of equal length; `spans` holds the first row of each curve and the row behind its
    last by the SHA-256 of its `curve.json`.
    """

    columns: dict[str, array[float]] = field(
        default_factory=lambda: {name: array("d") for name in COLUMNS}
    )
    spans: dict[str, tuple[int, int]] = field(default_factory=dict)

    def add(self, digest: str, text: bytes) -> None:
        """Append the curve that this JSON holds; raises ValueError if it holds none."""
        try:
            curve = orjson.loads(text)
            columns = [array("d", curve[name]) for name in COLUMNS[:-1]]
            columns.append(array("d", map(error_of, curve["loss"])))
        except (ValueError, LookupError, TypeError, OverflowError) as error:
            raise ValueError(f"holds no curve: {type(error).__name__}: {error}") from None
        (length, *other_lengths) = {len(column) for column in columns}
        if other_lengths:
            raise ValueError("holds no curve: its columns differ in length")
        if not all(math.isfinite(sum(column)) for column in columns[:-1]):
            raise ValueError("holds no curve: what it spent is not finite")
        start = len(self.columns["error"])
        for name, column in zip(COLUMNS, columns, strict=True):
            self.columns[name].extend(column)
        self.spans[digest] = (start, start + length)

    def gathered(self, name: str, digests: list[str]) -> array[float]:
        """One column of these curves, in this order."""
        column, rows = self.columns[name], array("d")
        for digest in digests:
            start, stop = self.spans[digest]
            rows.extend(column[start:stop])
        return rows


def error_of(loss: float | None) -> float:
    """The error of a loss, its root; NaN where there is none."""
    return math.nan if loss is None or loss < 0 else math.sqrt(loss)


def without_theta(curve: bytes) -> bytes:
    """A `curve.json` up to its parameters, which are most of it: its keys are sorted."""
    end = curve.find(b',"theta":')
    return curve if end < 0 else curve[:end] + b"}"


def compact(top: Path) -> int:
    """Write the curves of all undamaged runs below `top` into one file; returns how many.

    Raises FileNotFoundError if there is no such folder, and OSError if it cannot be written.
    """
    if not top.is_dir():
        raise FileNotFoundError(f"{top}: no such folder of runs; run something first")
    curves = Curves()
    for run in scan(top):
        if isinstance(run, CheckedRun):
            with contextlib.suppress(ValueError):
                curves.add(run.digest, without_theta(run.curve))
    folder = inside(top, FOLDER)
    folder.mkdir(exist_ok=True)
    with FileLock(folder / "lock"):
        _write(curves, folder)
    return len(curves.spans)


def compacted(top: Path) -> Curves:
    """The curves of the last compaction; none if there was none or its file is damaged."""
    try:
        return _read(str(top / FOLDER / NAME))
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return Curves()


def _write(curves: Curves, folder: Path) -> None:
    header = canonical(
        {
            "format": FORMAT,
            "byteorder": sys.byteorder,
            "rows": len(curves.columns["error"]),
            "spans": curves.spans,
        }
    )
    parts = [header.encode() + b"\n", *(curves.columns[name].tobytes() for name in COLUMNS)]
    digest = sha256()
    for part in parts:
        digest.update(part)
    temporary = folder / f".{NAME}"
    temporary.unlink(missing_ok=True)
    try:
        with temporary.open("xb") as file:
            file.writelines([digest.hexdigest().encode() + b"\n", *parts])
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(folder / NAME)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _read(path: str) -> Curves:
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as file:
        size = os.fstat(descriptor).st_size
        expected = file.readline(DIGEST + 1)
        line = file.readline(LARGEST)
        header = json.loads(line)
        rows = header["rows"]
        columns = len(COLUMNS) * rows * DOUBLE
        if [header["format"], header["byteorder"]] != [FORMAT, sys.byteorder]:
            raise ValueError("written by another version or machine")
        if not isinstance(rows, int) or size != len(expected) + len(line) + columns:
            raise ValueError("not as long as its header says")
        digest = sha256(line)
        curves = Curves()
        for column in curves.columns.values():
            column.fromfile(file, rows)
            digest.update(column)
    if expected != digest.hexdigest().encode() + b"\n":
        raise ValueError("checksum does not match")
    for key, (start, stop) in header["spans"].items():
        if not 0 <= start <= stop <= rows:
            raise ValueError("holds a curve that is not within its rows")
        curves.spans[key] = (start, stop)
    return curves
