"""The strict reader: what it takes, and where it says what it does not."""

from pathlib import Path

import numpy as np
import pytest

from miho.data import CSVError, load_csv
from miho.data.csv import read_numbers


def file(tmp_path: Path, data: str | bytes) -> Path:
    path = tmp_path / "data.csv"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def test_columns_by_name(tmp_path: Path) -> None:
    path = file(tmp_path, "\ufefftime,Fy,alpha\r\n0,1e3,0.1\r\n1,-2.5, -0.2 \r\n\r\n")
    found = read_numbers(path, ["alpha", "Fy"], header=True)
    assert found["alpha"].tolist() == [0.1, -0.2]
    assert found["Fy"].tolist() == [1000.0, -2.5]


def test_a_dataset(tmp_path: Path) -> None:
    path = file(tmp_path, "alpha,Fy\n0.1,-1\n0.2,-2\n")
    dataset = load_csv(str(path), ["alpha", "Fy"], ["rad", "N"], "Fy", "mine")
    assert (dataset.name, len(dataset), dataset.units["Fy"]) == ("mine", 2, "N")
    with pytest.raises(ValueError, match="one unit a column"):
        load_csv(str(path), ["alpha", "Fy"], ["rad"], "Fy")


BAD = {
    "a text cell": ("a,b\n1,2\n3,four\n", "3:3", "'four' in column 'b'"),
    "an empty cell": ("a,b\n1,\n", "2:3", "'' in column 'b'"),
    "NaN": ("a,b\nnan,1\n", "2:1", "not a finite number"),
    "infinity": ("a,b\n1,-inf\n", "2:3", "not a finite number"),
    "overflow": ("a,b\n1,1e999\n", "2:3", "not a finite number"),
    "an underscore": ("a,b\n1_0,1\n", "2:1", "'1_0'"),
    "a decimal comma": ("a,b\n1,5,2\n", "2:1", "3 cells; every row must have 2"),
    "a short row": ("a,b\n1,2\n3\n", "3:1", "1 cells"),
    "a blank line inside": ("a,b\n1,2\n\n3,4\n", "3:1", "1 cells"),
    "a missing column": ("a,c\n1,2\n", "1:1", "no column 'b' in the header 'a,c'"),
    "a column twice": ("a,b,b\n1,2,3\n", "1:1", "'b' is there twice"),
    "no rows": ("a,b\n", "1:1", "no rows of data"),
    "nothing": ("", "1:1", "empty"),
    "other digits": ("a,b\n1,٣\n", "2:3", "not a finite number"),
    "not UTF-8": (b"a,b\n1,\xff\n", "2:3", "not UTF-8"),
    "a long line": ("a,b\n" + "1" * 10_001, "2:10000", "longer than"),
    "semicolons": ("a;b\n1;2\n", "1:1", "separate columns with commas"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_name_line_and_column(tmp_path: Path, case: str) -> None:
    data, place, message = BAD[case]
    path = file(tmp_path, data)
    with pytest.raises(CSVError) as error:
        read_numbers(path, ["a", "b"], header=True)
    assert str(error.value).startswith(f"{path}:{place}: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_huge_files_are_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.csv"
    with path.open("wb") as stream:
        stream.truncate(2**30)
    with pytest.raises(CSVError, match="larger than 64 MiB"):
        read_numbers(path, ["a"], header=True)


def test_numbers_survive_a_round_trip(tmp_path: Path) -> None:
    values = np.random.default_rng(0).standard_normal(200)
    path = file(tmp_path, "\n".join(repr(v) for v in values.tolist()))
    assert np.array_equal(read_numbers(path, ["x"], header=False)["x"], values)
