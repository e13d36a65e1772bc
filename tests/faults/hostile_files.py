"""Files that are enormous or say so, that no program of ours writes, or with a bit flipped."""

from __future__ import annotations

import json
import os
import shutil
import struct
import time
import tracemalloc
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from miho.data import load_csv, load_mat
from miho.data.mat import read_variables
from miho.optim import Budget, RandomSearch, minimize
from miho.study import Identity, Store, execute, load_runs
from miho.study.identity import canonical, sha256
from miho.testing import DecayFit
from miho.vehicle.models import load_tir

COLUMNS, UNITS = ("alpha", "Fy"), ("rad", "N")


def refuse_large(folder: Path) -> tuple[float, float, int]:
    """The longest time in seconds, the most memory in bytes, and how many were refused."""
    longest = most = 0.0
    refused = 0
    for make, read in LARGE:
        path = folder / "large"
        make(path)
        tracemalloc.start()
        started = time.perf_counter()
        try:
            read(str(path))
        except ValueError as error:
            refused += str(error).startswith(str(path)) and str(error).isprintable()
        longest = max(longest, time.perf_counter() - started)
        most = max(most, float(tracemalloc.get_traced_memory()[1]))
        tracemalloc.stop()
        path.unlink()
    return longest, most, refused


def _sparse(path: Path) -> None:
    """A gigabyte of nothing behind a good header."""
    path.write_bytes(b"alpha,Fy\n0.1,-300\n")
    os.truncate(path, 2**30)


def _one_line(path: Path) -> None:
    path.write_bytes(b"1" * 2**20)
    os.truncate(path, 10**9)


def _small_one_line(path: Path) -> None:
    """One line within the limit of size, but not within that of lines."""
    path.write_bytes(b"alpha,Fy\n" + b"1" * (3 << 20))


def mat_bomb(path: Path) -> None:
    """A MATLAB file of half a megabyte, whose ten numbers take 512 MB."""
    inner = 1 << 29
    head = _element(6, struct.pack("<II", 6, 0)) + _element(5, struct.pack("<ii", 10, 1))
    head += _element(1, b"alpha")
    body = struct.pack("<II", 14, len(head) + 8 + inner) + head + struct.pack("<II", 9, inner)
    packer = zlib.compressobj(1)
    parts = [packer.compress(body)]
    parts += [packer.compress(bytes(1 << 20)) for _ in range(inner >> 20)]
    packed = b"".join([*parts, packer.flush()])
    start = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack("<H", 0x0100) + b"IM"
    path.write_bytes(start + struct.pack("<II", 15, len(packed)) + packed)


def _element(kind: int, data: bytes) -> bytes:
    """A data element of a MAT-file, padded to eight bytes."""
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def _as_csv(path: str) -> object:
    return load_csv(path, COLUMNS, UNITS, "Fy")


def _as_mat(path: str) -> object:
    return load_mat(path, COLUMNS, UNITS, "Fy")


LARGE: list[tuple[Callable[[Path], None], Callable[[str], object]]] = [
    (_sparse, _as_csv), (_one_line, _as_csv), (_small_one_line, _as_csv),
    (_sparse, load_tir), (_one_line, load_tir), (_small_one_line, load_tir),
    (_sparse, _as_mat), (mat_bomb, _as_mat),
]  # fmt: skip

DEEP = "[" * 100_000
RESULTS: dict[str, tuple[str, str]] = {
    # name: (path of the value in the file, the JSON that stands there)
    "a deep curve": ("curve.json", DEEP),
    "a deep result": ("result.json/facts", DEEP),
    "a deep configuration": ("config.json", '{"a":' * 100_000),
    "a list for a result": ("result.json", "[]"),
    "a list for a curve": ("curve.json", "[]"),
    "a number for a curve": ("curve.json", "1"),
    "a curve without columns": ("curve.json", "{}"),
    "columns of other lengths": ("curve.json/loss", "[1.0]"),
    "a curve of text": ("curve.json/loss", '["' + "x" * 1000 + '"]'),
    "a number of a million digits": ("curve.json/evaluations", "[" + "9" * 1_000_000 + "]"),
    "a loss of 400 digits": ("result.json/loss", "9" * 400),
    "an infinite loss": ("result.json/loss", "1e999"),
    "a loss that is no number": ("result.json/loss", "NaN"),
    "a loss of text": ("result.json/loss", '"small"'),
    "a seed of text": ("result.json/seed", '"zero"'),
    "a seed of 400 digits": ("result.json/seed", "9" * 400),
    "no parameters": ("result.json/parameters", "null"),
    "parameters of text": ("result.json/parameters", '["a", "b"]'),
    "more values than parameters": ("result.json/theta", "[1.0, 2.0, 3.0, 4.0]"),
    "facts of text": ("result.json/facts", '"none"'),
    "checksums of text": ("result.json/files", '"none"'),
}
"""What a stranger can write, with checksums that are right."""


def survive_results(root: Path, seconds: float) -> int:
    """How many hostile runs leave the others readable: skipped or read, in time and no matter."""
    execute(Store(root), _identity(0), _record, DecayFit.space, {"unit": "V"})
    good = execute(Store(root), _identity(1), _record, DecayFit.space, {"unit": "V"}).run
    if good is None:
        raise RuntimeError("the run that is to be spoilt is missing")
    kept = root.parent / "kept"
    shutil.copytree(good.folder, kept)
    survived = 0
    for place, text in RESULTS.values():
        shutil.rmtree(good.folder)
        shutil.copytree(kept, good.folder)
        _forge(good.folder, place, text)
        survived += _readable(root, good.folder, seconds)
    return survived


def _readable(root: Path, spoilt: Path, seconds: float) -> bool:
    started = time.perf_counter()
    try:
        found = load_runs(root)
        curves = found.curves
    except Exception:  # noqa: BLE001 -- whatever is raised, the other run cannot be read
        return False
    others = {path.parent.name for path in root.rglob("result.json")} - {spoilt.name}
    return (
        time.perf_counter() - started < seconds
        and str(spoilt) in {*map(str, found.runs["folder"]), *map(str, found.damaged["folder"])}
        and others <= set(found.runs["id"])
        and others <= set(curves["id"])
    )


def _forge(folder: Path, place: str, text: str) -> None:
    """Put `text` into a file of a run and make the checksums right."""
    name, _, key = place.partition("/")
    result = json.loads((folder / "result.json").read_bytes())
    del result["sha256"]
    if name != "result.json":
        whole = json.loads((folder / name).read_bytes())
        written = _with(whole, key, text)
        (folder / name).write_text(written, encoding="utf-8")
        result["files"][name] = sha256(written)
        key, text = "", canonical(result)
    unsigned = _with(result, key, text)
    signature = f',"sha256":"{sha256(unsigned)}"'
    signed = unsigned[:-1] + signature + unsigned[-1:] if unsigned.endswith("}") else unsigned
    (folder / "result.json").write_text(signed, encoding="utf-8")


def _with(whole: dict[str, Any], key: str, text: str) -> str:
    """The JSON of a mapping with `text` in the place of a value, or of everything."""
    return canonical(whole | {key: "@"}).replace('"@"', text) if key else text


def _identity(seed: int) -> Identity:
    return Identity("decay", "random", seed, {}, "c0de", "da7a")


def _record() -> Any:
    return minimize(RandomSearch(), DecayFit(), Budget(evaluations=20), 0)


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
