"""A dataset: named columns in SI units, one of them the output to be explained."""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miho.data.preview import Reading
from miho.quantities import Array
from miho.validate import whole


def file_name(path: str | os.PathLike[str]) -> str:
    """A dataset's name from its file: the stem, with "_" for what cannot name a folder."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", Path(path).stem)


def number_pair(value: object, label: str) -> tuple[float, float]:
    """`value` as (low, high), if it is two finite numbers, the lower first; else ValueError."""
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2:
        low, high = value
        numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in value)
        if numbers and -math.inf < low <= high < math.inf:
            return float(low), float(high)
    raise ValueError(f"{label} is {value!r}; give two finite numbers, the lower first")


@dataclass(frozen=True, eq=False)
class Dataset:
    """Columns of equal length (N,), float64, SI units and radians, ISO-W signs for tires.

    `columns` holds the inputs of the model, the conditions under which they were taken and the
    output; `units` names the unit of each. Columns are read-only: nobody edits shared data.
    `held_out` has rows that no fit sees, of the same columns and units, to validate with.
    `reading` describes the file that the data are from, and has no part in their identity.
    """

    name: str
    columns: Mapping[str, Array]
    units: Mapping[str, str]
    output: str
    held_out: Dataset | None = None
    reading: Reading | None = None

    def __post_init__(self) -> None:
        # Columns become read-only copies, finite and of one length, each with a unit.
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
        # Rows that are held out are data of the same kind.
        if self.held_out is not None:
            apart = self.held_out
            if (set(apart.columns), dict(apart.units), apart.output, apart.held_out) != (
                set(columns), dict(self.units), self.output, None,
            ):  # fmt: skip
                raise ValueError(
                    f"dataset {self.name}: held_out must have the same columns, units and output, "
                    f"and hold out nothing itself; it has {dict(apart.units)}, output "
                    f"{apart.output!r}"
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

    def select(self, rows: NDArray[np.bool_]) -> Dataset:
        """The rows that are True in a mask (N,), under the same name; `held_out` stays."""
        rows = np.asarray(rows)
        if rows.dtype != bool or rows.shape != (len(self),):
            raise ValueError(
                f"dataset {self.name}: rows are chosen by {len(self)} truth values; got "
                f"{rows.dtype} of shape {rows.shape}"
            )
        return replace(self, columns={key: column[rows] for key, column in self.columns.items()})

    def thinned(self, every: int) -> Dataset:
        """The first row of every so many; `held_out` stays."""
        whole("every", every, 1)
        return self.select(np.arange(len(self)) % every == 0)

    def hold_out(self, ranges: Mapping[str, Sequence[float]]) -> Dataset:
        """The same data with `held_out` set to the rows that lie in all of these ranges.

        `ranges` maps columns to (from, to), both included, in the column's unit.
        """
        if self.held_out is not None or not ranges:
            raise ValueError(
                f"dataset {self.name}: "
                + ("rows are held out already" if ranges else "no column to hold out by")
                + "; name columns and ranges once, such as {Fz: [3900, 4100]}"
            )
        inside = np.ones(len(self), dtype=bool)
        for name, bounds in ranges.items():
            low, high = number_pair(bounds, f"held_out of {name}")
            inside &= (self[name] >= low) & (self[name] <= high)
        if inside.all() or not inside.any():
            selection = ", ".join(
                f"{name} in [{low:g}, {high:g}]" for name, (low, high) in ranges.items()
            )
            spans = ", ".join(
                f"{name} from {self[name].min():g} to {self[name].max():g}" for name in ranges
            )
            raise ValueError(
                f"dataset {self.name}: {'every' if inside.any() else 'no'} row has {selection}; "
                f"hold out a part of the data, which has {spans}"
            )
        return replace(self.select(~inside), held_out=self.select(inside))

    @property
    def digest(self) -> str:
        """SHA-256 over names, units and bytes of every column, held-out rows too: the identity."""
        digest = hashlib.sha256(self.output.encode())
        for key in sorted(self.columns):
            digest.update(f"\0{key}\0{self.units[key]}\0".encode())
            digest.update(self.columns[key].astype("<f8").tobytes())
        if self.held_out is not None:
            digest.update(f"\0\0held out\0{self.held_out.digest}".encode())
        return digest.hexdigest()
