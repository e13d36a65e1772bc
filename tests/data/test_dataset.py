"""Datasets refuse what cannot be data, and know their identity."""

import hashlib
import struct

import numpy as np
import pytest

from miho import Dataset

UNITS = {"x": "m", "y": "N"}


def make(x: object = (1.0, 2.0), y: object = (3.0, 4.0), **changes: object) -> Dataset:
    return Dataset(
        **{"name": "d", "columns": {"x": x, "y": y}, "units": UNITS, "output": "y"} | changes
    )


def test_digest_is_the_content() -> None:
    assert make().digest == make().digest
    assert make().digest != make(y=(3.0, 4.1)).digest
    assert make().digest != make(units={"x": "km", "y": "N"}).digest
    assert make().digest == make(name="another name").digest
    held = make(held_out=make(y=(5.0, 6.0)))
    assert len({make().digest, held.digest, make(held_out=make()).digest}) == 3


def test_the_digest_of_published_runs_stays() -> None:
    """SHA-256 of b"y", then for x and y of b"\\0", name, b"\\0", unit, b"\\0" and the bytes."""
    digest = hashlib.sha256(b"y")
    for key, unit, values in (("x", "m", (1.0, 2.0)), ("y", "N", (3.0, 4.0))):
        digest.update(f"\0{key}\0{unit}\0".encode() + struct.pack("<2d", *values))
    assert make().digest == digest.hexdigest()


def test_columns_are_copies_that_nobody_edits() -> None:
    values = np.array([1.0, 2.0])
    dataset = make(x=values)
    values[0] = 9
    assert dataset["x"][0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        dataset["x"][0] = 9


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"x": (1.0, np.nan)}, "'x' must be one finite number per row"),
        ({"x": 0.0}, r"'x' must be one finite number per row; got the shape \(\)"),
        ({"x": ((1.0, 2.0),)}, r"got the shape \(1, 2\)"),
        ({"x": np.ma.array([1.0, 2.0], mask=[0, 1])}, "got nan in row 2, 1 not finite in all"),
        ({"x": (1j, 2.0)}, "column 'x' is complex128; expected real numbers"),
        (
            {"x": np.array([1, 2], "M8[s]")},
            r"'x' is datetime64\[s\]; expected",
        ),
        ({"x": ("low", "high")}, "column 'x' is <U4; expected real numbers"),
        ({"x": (1.0,)}, "differ in length"),
        ({"x": (), "y": ()}, "empty"),
        ({"output": "z"}, "output 'z' is not a column"),
        ({"units": {"x": "m"}}, "every column needs a unit"),
        ({"held_out": make(units={"x": "km", "y": "N"})}, "held_out must have the same"),
        ({"held_out": make(output="x")}, "held_out must have the same"),
        ({"held_out": make(held_out=make())}, "no held_out rows"),
    ],
)
def test_bad_data(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**changes)


def test_unknown_column() -> None:
    with pytest.raises(ValueError, match="no column 'z'; columns are x, y"):
        make()["z"]


LOADS = Dataset(
    "loads",
    {"x": np.arange(6.0), "Fz": np.array([1e3, 2e3, 3e3] * 2), "y": np.arange(6.0) ** 2},
    {"x": "m", "Fz": "N", "y": "N"},
    "y",
)


def test_rows_are_selected_by_a_mask() -> None:
    chosen = LOADS.select(LOADS["x"] > 3)
    assert (chosen.name, chosen["y"].tolist()) == ("loads", [16.0, 25.0])
    assert LOADS.hold_out({"Fz": [3e3, 3e3]}).select(np.array([True] * 4)).held_out is not None
    for rows in (np.array([0, 1]), np.array([True])):
        with pytest.raises(ValueError, match="expected a mask of 6 truth values"):
            LOADS.select(rows)
    with pytest.raises(ValueError, match="empty"):
        LOADS.select(LOADS["x"] > 9)


def test_rows_are_held_out_by_ranges() -> None:
    split = LOADS.hold_out({"Fz": [2e3, 3e3], "x": (0, 4)})
    assert split["x"].tolist() == [0.0, 3.0, 5.0]
    assert split.held_out is not None
    assert split.held_out["x"].tolist() == [1.0, 2.0, 4.0]
    assert (split.held_out.name, split.held_out.output) == ("loads", "y")


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"Fz": [0, 9e3]}, r"every row has Fz in \[0, 9000\]; .* Fz from 1000 to 3000"),
        ({"Fz": [5e3, 9e3]}, "no row has Fz"),
        ({"Fz": [2e3, 1e3]}, r"held_out of Fz is \[2000.0, 1000.0\]; give two finite numbers"),
        ({"Fz": [2e3, np.nan]}, "two finite numbers"),
        ({"Fz": [2e3]}, "two finite numbers"),
        ({"Fz": ["a", "b"]}, "two finite numbers"),
        ({"Fz": 2e3}, "two finite numbers"),
        ({"Fy": [1, 2]}, "no column 'Fy'"),
        ({}, "no columns are given"),
    ],
)
def test_bad_splits(ranges: dict[str, list[float]], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LOADS.hold_out(ranges)


def test_rows_are_held_out_once() -> None:
    with pytest.raises(ValueError, match="held out already"):
        LOADS.hold_out({"Fz": [2e3, 3e3]}).hold_out({"Fz": [1e3, 1e3]})


def test_a_dataset_is_shown_in_one_line() -> None:
    split = LOADS.hold_out({"Fz": [2e3, 3e3], "x": (0, 4)})
    assert "3 rows, 3 held out" in repr(split)
    assert "Fz [N]" in repr(split)
    assert "array" not in repr(split)
