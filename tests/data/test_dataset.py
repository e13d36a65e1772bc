"""Datasets refuse what cannot be data, and know their identity."""

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


def test_columns_are_copies_that_nobody_edits() -> None:
    mine = np.array([1.0, 2.0])
    dataset = make(x=mine)
    mine[0] = 9
    assert dataset["x"][0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        dataset["x"][0] = 9


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"x": (1.0, np.nan)}, "'x' must be one finite number per row"),
        ({"x": ((1.0, 2.0),)}, "got shape"),
        ({"x": (1.0,)}, "differ in length"),
        ({"x": (), "y": ()}, "empty"),
        ({"output": "z"}, "output 'z' is not a column"),
        ({"units": {"x": "m"}}, "every column needs a unit"),
    ],
)
def test_bad_data(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**changes)


def test_unknown_column() -> None:
    with pytest.raises(ValueError, match="no column 'z'; columns are x, y"):
        make()["z"]
