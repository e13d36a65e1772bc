"""MATLAB files with one bit flipped: each is refused in one line, or read as it was."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from miho.data import load_mat
from miho.data.mat import read_variables

SETTINGS: dict[str, Any] = {
    "columns": ["alpha", "Fy", "Fz"], "units": ["deg", "N", "N"], "output": "Fy",
    "headers": ["SA", "FY", "FZ"], "convention": "sae", "name": "flipped",
}  # fmt: skip


def flip_bits(folder: Path, count: int, seed: int = 24) -> tuple[Counter[str], float]:
    """How `count` flips end ("refused", "as it was", "wrong" or what is raised); most seconds.

    They are shared by files with one class of numbers each, compressed or not, with other kinds of
    variables, and small. Bits of uncompressed numbers are left out: they have no checksum.
    """
    rng = np.random.default_rng(seed)
    ends: Counter[str] = Counter()
    slowest = 0.0
    path = folder / "flipped.mat"
    files = list(_files(folder))
    for file in files:
        data, good = file.read_bytes(), load_mat(str(file), **SETTINGS).digest
        bits = _described(file, data)
        for bit in rng.choice(bits, min(count // len(files) + 1, bits.size), replace=False):
            flipped = bytearray(data)
            flipped[bit // 8] ^= 1 << bit % 8
            path.write_bytes(flipped)
            started = time.perf_counter()
            ends[_end(path, good)] += 1
            slowest = max(slowest, time.perf_counter() - started)
    return ends, slowest


def _end(path: Path, good: str) -> str:
    try:
        return "as it was" if load_mat(str(path), **SETTINGS).digest == good else "wrong"
    except ValueError as error:
        one_line = str(error).startswith(f"{path}: ") and str(error).isprintable()
        return "refused" if one_line else f"ValueError: {error}"
    except Exception as error:  # noqa: BLE001 -- what else is raised is the finding
        return type(error).__name__


def _files(folder: Path) -> Iterator[Path]:
    """Healthy files, written by SciPy."""
    slip = np.linspace(-12.0, 12.0, 200)[:, None]
    columns = {"SA": slip, "FY": -2500 * np.sin(slip / 8), "FZ": -3000 - 90 * np.cos(slip)}
    more = {"tireid": "x", "channel": {"name": ["SA"]}, "ET": np.arange(200), "ok": slip > 0}
    kinds: dict[str, tuple[dict[str, Any], bool]] = {
        "doubles": (columns, False),
        "compressed": (columns | more, True),
        "others": (columns | more, False),
        "singles": ({name: column.astype("f4") for name, column in columns.items()}, False),
        "integers": ({name: column.astype("i2") for name, column in columns.items()}, False),
        "small": ({name: column[::50] for name, column in columns.items()}, False),
        "small, compressed": ({name: column[::50] for name, column in columns.items()}, True),
    }
    for name, (variables, compressed) in kinds.items():
        path = folder / f"{name}.mat"
        savemat(path, variables, do_compression=compressed)
        yield path


def _described(file: Path, data: bytes) -> NDArray[np.intp]:
    """The bits of a file but those of numbers that stand in it uncompressed."""
    free = np.ones(len(data), dtype=bool)
    for name in SETTINGS["headers"]:
        numbers = bytes(read_variables(file)[name].data)
        place = data.find(numbers)
        if place >= 0:
            free[place : place + len(numbers)] = False
    return np.flatnonzero(np.repeat(free, 8))
