"""MATLAB files: the consortium's layout, and everything that is not a vector of numbers."""

import struct
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from miho.data import Dataset, load_mat
from miho.data.mat import read_variables
from miho.vehicle.data import sample_tir
from tests.faults.hostile_files import flip_bits, mat_bomb

TIRE = sample_tir("rf", n=300)
SETTINGS: dict[str, Any] = {
    "columns": ["alpha", "Fy", "Fz", "gamma", "pressure"],
    "units": ["deg", "N", "N", "deg", "kPa"],
    "output": "Fy",
    "headers": ["SA", "FY", "FZ", "IA", "P"],
    "convention": "sae",
}


def consortium(**changes: Any) -> dict[str, Any]:
    """A cornering file as the Tire Test Consortium writes it: column vectors, SAE, degrees."""
    columns = {
        "SA": -np.degrees(TIRE["alpha"]), "FY": -TIRE["Fy"], "FZ": -TIRE["Fz"],
        "IA": np.degrees(TIRE["gamma"]), "P": np.full(300, 83.0), "ET": np.arange(300.0),
    }  # fmt: skip
    return {name: column[:, None] for name, column in columns.items()} | changes


def saved(tmp_path: Path, variables: dict[str, Any], **how: Any) -> str:
    path = tmp_path / "run_1.mat"
    savemat(path, variables, **how)
    return str(path)


def load(path: str, **changes: Any) -> Dataset:
    return load_mat(path, **SETTINGS | changes)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["column", "row"])
def test_the_consortium_s_layout(tmp_path: Path, compressed: bool, kind: str) -> None:
    variables = consortium(tireid="x", channel={"name": ["SA"]})
    if kind == "row":
        variables["FY"] = variables["FY"].T
    path = saved(tmp_path, variables, do_compression=compressed)
    loaded = load(path, held_out={"Fz": [3900, 4100]})
    assert loaded.name == "run_1"
    assert dict(loaded.units) == {
        "alpha": "rad", "Fy": "N", "Fz": "N", "gamma": "rad", "pressure": "Pa",
    }  # fmt: skip
    inside = (TIRE["Fz"] >= 3900) & (TIRE["Fz"] <= 4100)
    assert loaded.held_out is not None
    for part, rows in ((loaded, ~inside), (loaded.held_out, inside)):
        for name in ("alpha", "Fy", "Fz", "gamma"):
            np.testing.assert_allclose(part[name], TIRE[name][rows], rtol=1e-15)
        assert (part["pressure"] == 83e3).all()


def test_whole_numbers_are_numbers(tmp_path: Path) -> None:
    loaded = load(saved(tmp_path, consortium(FZ=np.round(-TIRE["Fz"]).astype(np.int16))))
    assert np.array_equal(loaded["Fz"], np.round(TIRE["Fz"]))


FY = -TIRE["Fy"]
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "text": ({"FY": "no"}, "FY: has class char; save it as a vector of numbers"),
    "truth": ({"FY": FY > 0}, "FY: has class logical"),
    "a structure": ({"FY": {"data": FY}}, "FY: has class struct"),
    "cells": ({"FY": FY.astype(object)}, "FY: has class cell"),
    "complex": ({"FY": FY + 1j}, "FY: has class complex; save it as a vector"),
    "a matrix": ({"FY": FY.reshape(-1, 2)}, "FY: has size 150x2; save a vector"),
    "a block": ({"FY": FY.reshape(-1, 2, 3)}, "FY: has size 50x2x3; save a vector"),
    "nothing": ({"FY": np.empty((0, 0))}, "FY: has size 0x0; save a vector"),
    "another length": ({"FY": FY[1:]}, "FY: 299 numbers, but SA has 300; choose"),
    "NaN": ({"FY": np.where(np.arange(300) == 7, np.nan, FY)}, r"FY(8): is nan, not a finite"),
    "infinity": ({"P": np.r_[np.inf, np.full(299, 80.0)]}, r"P(1): is inf, not a finite"),
    "other signs": ({"FZ": TIRE["Fz"]}, "FZ: Fz is mostly negative, but it is positive in ISO-W"),
    "a rising force": ({"FY": -FY}, "FY: Fy rises with alpha"),
    "another unit": (
        {"FY": FY / 1e3},
        " N, expected 15 to 60000; is the column in kN, daN, lbf or kgf?",
    ),
    "a constant": ({"FY": 0 * FY + 100}, "FY: column 'FY' has the same value in every row"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_variables_are_named(tmp_path: Path, case: str) -> None:
    changes, message = BAD[case]
    path = saved(tmp_path, consortium(**changes))
    with pytest.raises(ValueError, match="; ") as error:
        load(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)
    assert str(error.value).isprintable()


def test_a_missing_variable_lists_the_others(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Q: no such variable; choose headers from ET, FY, FZ, IA"):
        load(saved(tmp_path, consortium()), headers=["SA", "FY", "FZ", "IA", "Q"])


@pytest.mark.parametrize(
    ("number", "kind"), [(16, "function"), (3, "object"), (5, "sparse"), (2, "struct")]
)
def test_what_could_hold_code_is_refused_unread(tmp_path: Path, number: int, kind: str) -> None:
    """SciPy writes no functions: the class of a vector of doubles, 6, is changed in the file."""
    path = Path(saved(tmp_path, consortium()))
    data = bytearray(path.read_bytes())
    flags = data.rindex(b"\x06\0\0\0\x08\0\0\0\x06", 0, data.index(b"\x02\0FY\0\0")) + 8
    data[flags] = number
    path.write_bytes(data)
    with pytest.raises(ValueError, match=f"FY: has class {kind}; save it"):
        load(str(path))


KINDS = {
    "version 7.3": (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(520), "MATLAB 7.3 file; save"),
    "HDF5": (b"\x89HDF\r\n\x1a\n".ljust(520), "MATLAB 7.3 file; save it with save(..., '-v7')"),
    "a CSV": (b"alpha,Fy\n1,2\n", "not a MATLAB file; save one"),
    "nothing": (b"", "not a MATLAB file"),
    "only a header": (b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM", "SA: no such variable"),
    "a stump": (b"MATLAB 5.0 MAT-file", "not a MATLAB file"),
    "cut in a tag": (b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM\x0e\0", "is damaged; copy"),
}


@pytest.mark.parametrize("case", KINDS)
def test_other_files(tmp_path: Path, case: str) -> None:
    content, message = KINDS[case]
    path = tmp_path / "x.mat"
    path.write_bytes(content)
    with pytest.raises(ValueError, match="; ") as error:
        load(str(path))
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load(str(tmp_path / "none.mat"))
    with pytest.raises(ValueError, match="is not a file but a folder; name a file"):
        load(str(tmp_path))
    path = tmp_path / "huge.mat"
    with path.open("wb") as stream:
        stream.write(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM")
        stream.truncate(2**30)
    with pytest.raises(ValueError, match="larger than 64 MiB"):
        load(str(path))


def test_damaged_files_give_one_line(tmp_path: Path) -> None:
    """Random bytes changed, and the file cut; MATLAB's own files are compressed, with checksums."""
    path = Path(saved(tmp_path, consortium(), do_compression=True))
    whole = load(str(path)).digest
    data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    rng = np.random.default_rng(3)
    errors = 0
    for _ in range(200):
        changed = data.copy()
        changed[rng.integers(128, data.size, size=2)] ^= rng.integers(1, 256, size=2, dtype="u1")
        path.write_bytes(changed[: rng.integers(200, 2 * data.size)].tobytes())
        try:
            assert load(str(path)).digest == whole
        except ValueError as error:
            assert str(error).startswith(f"{path}: ")
            assert str(error).isprintable()
            errors += 1
    assert errors > 100


def test_flipped_bits_are_refused_or_do_no_harm(tmp_path: Path) -> None:
    ends, slowest = flip_bits(tmp_path, 1400)
    assert set(ends) == {"refused", "as it was"}
    assert ends.total() >= 1000
    assert ends["refused"] > 500
    assert slowest < 2.0


def element(kind: int, data: bytes, order: str = "<") -> bytes:
    """A data element; 4 bytes or less stand in its tag, as MATLAB writes them."""
    if len(data) <= 4:
        return struct.pack(f"{order}I", len(data) << 16 | kind) + data.ljust(4, b"\0")
    return struct.pack(f"{order}II", kind, len(data)) + data + bytes(-len(data) % 8)


def vector(name: bytes, kind: int, numbers: Any, stored: int, order: str) -> bytes:
    """A matrix element of a class of numbers, stored as another type."""
    content = element(6, struct.pack(f"{order}II", kind, 0), order)
    content += element(5, struct.pack(f"{order}ii", 1, len(numbers)), order)
    content += element(1, name, order) + element(stored, numbers.tobytes(), order)
    return struct.pack(f"{order}II", 14, len(content)) + content


@pytest.mark.parametrize("order", ["<", ">"])
def test_either_byte_order_and_doubles_stored_as_integers(tmp_path: Path, order: str) -> None:
    """As MATLAB writes whole numbers (MAT-File Format, "Data Compression"); SciPy reads the same.

    Stored as something that doubles are never stored as, such as 64-bit integers, they are damaged.
    """
    whole = np.array([1, -2, 300])
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack(f"{order}H", 0x0100)
    head += b"IM" if order == "<" else b"MI"
    path = tmp_path / "x.mat"
    path.write_bytes(head + vector(b"SA", 6, whole.astype(f"{order}i2"), 3, order))
    loaded = read_variables(path)["SA"]
    assert np.frombuffer(loaded.data, loaded.stored).tolist() == whole.tolist()
    assert loadmat(path)["SA"].tolist() == [whole.tolist()]
    path.write_bytes(head + vector(b"SA", 6, whole.astype(f"{order}i8"), 12, order))
    with pytest.raises(ValueError, match=r"x\.mat: the file is damaged; copy or save it again"):
        read_variables(path)


def test_what_takes_too_much_room_is_refused_unread(tmp_path: Path) -> None:
    """Ten numbers by what the header says, half a gigabyte of zeros by what follows."""
    path = tmp_path / "bomb.mat"
    mat_bomb(path)
    assert path.stat().st_size < 4e6
    tracemalloc.start()
    started = time.process_time()
    with pytest.raises(ValueError, match=r"bomb.mat: larger than 128 MiB when decompressed; "):
        load_mat(str(path), ["alpha", "Fy"], ["rad", "N"], "Fy")
    seconds, peak = time.process_time() - started, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seconds < 1.0
    assert peak < 200e6
