"""The curve of a stored run: its error over evaluations and seconds."""

from __future__ import annotations

import math

import numpy as np
import orjson
from numpy.typing import NDArray

Curve = NDArray[np.float64]
"""Rows `COLUMNS`; a column for each improvement and one for the end."""

COLUMNS = ("evaluations", "seconds", "cpu_seconds", "error")


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
