"""The curves of many runs in one file, which reads several times as fast as their separate files.

    root/.compact/curves    <SHA-256 of the rest>, NumPy's npz of digests, lengths, columns

The file is a cache and can be rebuilt. Each curve is stored under the SHA-256 of the `curve.json`
from which it was read, so a run that was added, changed or replaced later never gets the curve of
another. Like every checksum here, it detects damage, not forgery.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
from hashlib import sha256
from pathlib import Path

import numpy as np
import orjson
from filelock import FileLock
from numpy.typing import NDArray

from miho.study.files import write_bytes
from miho.study.places import inside
from miho.study.scan import CheckedRun, scan

Curve = NDArray[np.float64]
"""Rows `COLUMNS`; a column for each improvement and one for the end."""

FOLDER, NAME = ".compact", "curves"
COLUMNS = ("evaluations", "seconds", "cpu_seconds", "error")
DIGEST = 64


def curve_of(text: bytes) -> Curve:
    """The curve in a JSON text; raises ValueError if there is none."""
    try:
        values = orjson.loads(text)
        rows = [*(values[name] for name in COLUMNS[:-1]), list(map(error_of, values["loss"]))]
        curve = np.array(rows)
    except (ValueError, LookupError, TypeError, OverflowError) as error:
        raise ValueError(f"contains no curve: {type(error).__name__}: {error}") from None
    if curve.ndim != 2 or curve.dtype.kind not in "iuf":
        raise ValueError("contains no curve: its columns are not lists of numbers")
    if not np.isfinite(curve[:-1]).all():
        raise ValueError("contains no curve: its evaluations or seconds are not finite")
    return curve.astype(float)


def error_of(loss: float | None) -> float:
    """The error of a loss, its square root; NaN if there is none."""
    return math.nan if loss is None or loss < 0 else math.sqrt(loss)


def without_theta(curve: bytes) -> bytes:
    """A `curve.json` without its parameters, which are most of it; its keys are sorted."""
    end = curve.find(b',"theta":')
    return curve if end < 0 else curve[:end] + b"}"


def compact(top: Path) -> int:
    """Write the curves of all undamaged runs below `top` into one file.

    Parameters
    ----------
    top : Path
        Folder of runs.

    Returns
    -------
    int
        Number of curves.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist.
    OSError
        If the file cannot be written.
    """
    if not top.is_dir():
        raise FileNotFoundError(f"{top}: no such folder of runs; run something first")
    curves: dict[str, Curve] = {}
    for run in scan(top):
        if isinstance(run, CheckedRun):
            with contextlib.suppress(ValueError):
                curves[run.digest] = curve_of(without_theta(run.curve))
    folder = inside(top, FOLDER)
    folder.mkdir(exist_ok=True)
    with FileLock(folder / "lock"):
        write_bytes(folder / NAME, _packed(curves))
    return len(curves)


def compacted(top: Path) -> dict[str, Curve]:
    """The curves of the last compaction by the SHA-256 of their `curve.json`.

    The result is empty if there was no compaction or the file is damaged; the runs have separate
    files.
    """
    try:
        return _unpacked(top / FOLDER / NAME)
    except Exception:  # noqa: BLE001 -- errors of damaged archives are not documented
        return {}


def _packed(curves: dict[str, Curve]) -> bytes:
    archive = io.BytesIO()
    np.savez(
        archive,
        digests=np.array(list(curves), dtype=f"S{DIGEST}"),
        lengths=np.array([curve.shape[1] for curve in curves.values()], dtype=np.int64),
        columns=np.hstack([np.empty((len(COLUMNS), 0)), *curves.values()]),
    )
    data = archive.getvalue()
    return sha256(data).hexdigest().encode() + b"\n" + data


def _unpacked(path: Path) -> dict[str, Curve]:
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as file:
        expected, data = file.readline(DIGEST + 1), file.read()
    if expected != sha256(data).hexdigest().encode() + b"\n":
        raise ValueError("checksum does not match")
    with np.load(io.BytesIO(data)) as archive:  # refuses pickles by default
        digests, lengths, columns = (archive[key] for key in ("digests", "lengths", "columns"))
    if columns.shape != (len(COLUMNS), lengths.sum()) or len(digests) != len(lengths):
        raise ValueError("the lengths of its columns and curves differ")
    pieces = np.split(columns, np.cumsum(lengths)[:-1], axis=1)
    return {digest.decode(): piece for digest, piece in zip(digests, pieces, strict=True)}
