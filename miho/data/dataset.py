"""A dataset: named columns in SI units, one of them the output to be explained."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def file_name(path: str | os.PathLike[str]) -> str:
    """A dataset's name from its file: the stem, with "_" for what cannot name a folder."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", Path(path).stem)


@dataclass(frozen=True, eq=False)
class Dataset:
    """Columns of equal length (N,), float64, SI units and radians, ISO-W signs for tires.

    `columns` holds the inputs of the model, the conditions under which they were taken and the
    output; `units` names the unit of each. Columns are read-only: nobody edits shared data.
    """

    name: str
    columns: Mapping[str, Array]
    units: Mapping[str, str]
    output: str

    def __post_init__(self) -> None:
        columns = {}
        for key, values in self.columns.items():
            column = np.array(values, dtype=float)
            if column.ndim != 1 or not np.isfinite(column).all():
                raise ValueError(
                    f"dataset {self.name}: column {key!r} must be one finite number per row; "
                    f"got shape {column.shape} with "
                    f"{np.count_nonzero(~np.isfinite(column))} not finite"
                )
            column.flags.writeable = False
            columns[key] = column
        if self.output not in columns:
            raise ValueError(
                f"dataset {self.name}: output {self.output!r} is not a column; "
                f"columns are {', '.join(columns)}"
            )
        lengths = {key: column.size for key, column in columns.items()}
        if len(set(lengths.values())) != 1 or not next(iter(lengths.values())):
            raise ValueError(
                f"dataset {self.name}: columns differ in length or are empty: {lengths}"
            )
        if set(self.units) != set(columns):
            raise ValueError(
                f"dataset {self.name}: every column needs a unit; got {dict(self.units)}"
            )
        object.__setattr__(self, "columns", columns)

    def __len__(self) -> int:
        return self.columns[self.output].size

    def __getitem__(self, column: str) -> Array:
        """The column of that name, (N,)."""
        try:
            return self.columns[column]
        except KeyError:
            raise ValueError(
                f"dataset {self.name}: no column {column!r}; columns are {', '.join(self.columns)}"
            ) from None

    @property
    def digest(self) -> str:
        """SHA-256 over names, units and the bytes of every column: the identity of the data."""
        digest = hashlib.sha256(self.output.encode())
        for key in sorted(self.columns):
            digest.update(f"\0{key}\0{self.units[key]}\0".encode())
            digest.update(self.columns[key].astype("<f8").tobytes())
        return digest.hexdigest()
