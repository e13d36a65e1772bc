"""A dataset: named columns in SI units, one of them the output to be explained."""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array
from miho.validate import is_number, whole

if TYPE_CHECKING:
    from miho.data.preview import Reading


def file_name(path: str | os.PathLike[str]) -> str:
    """Name of a file's dataset: the stem, with "_" for characters unsuitable for folders."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", Path(path).stem)


def number_pair(value: object, label: str) -> tuple[float, float]:
    """Return `value` as (low, high); raises ValueError unless it is two finite numbers in order."""
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2:
        low, high = value
        if is_number(low) and is_number(high) and -math.inf < low <= high < math.inf:
            return float(low), float(high)
    raise ValueError(f"{label} is {value!r}; give two finite numbers, the lower first")


@dataclass(frozen=True, eq=False)
class Dataset:
    """Columns of equal length (N,), float64, in SI units and radians; ISO-W signs for tires.

    Parameters
    ----------
    name : str
        Name of the dataset.
    columns : mapping of str to array_like
        Inputs of the model, conditions of the measurement and the output. The dataset keeps
        read-only copies.
    units : mapping of str to str
        Unit of each column.
    output : str
        Name of the output column.
    held_out : Dataset, optional
        Rows with the same columns and units that no fit uses, for validation.
    reading : Reading, optional
        Description of the source file. It is not part of the data's identity.

    Raises
    ------
    ValueError
        If a column is not finite, has no unit or has another length.

    Examples
    --------
    >>> from miho.data import Dataset
    >>> data = Dataset("line", {"x": [0, 1, 2], "y": [1, 3, 5]}, {"x": "s", "y": "m"}, "y")
    >>> data = data.hold_out({"x": (2, 2)})
    >>> len(data), len(data.held_out)
    (2, 1)
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
            dtype = getattr(values, "dtype", np.asarray(values).dtype)
            if getattr(dtype, "kind", "O") in "cmMSUV":  # also dates of pandas with a time zone
                raise ValueError(
                    f"dataset {self.name}: column {key!r} is {dtype}; expected real numbers"
                )
            column = np.array(values, dtype=float)
            if np.ma.is_masked(values):
                column[np.ma.getmaskarray(values)] = np.nan
            lost = np.flatnonzero(~np.isfinite(column))
            if column.ndim != 1 or lost.size:
                got = f"the shape {column.shape}"
                if column.ndim == 1:
                    got = f"{column[lost[0]]} in row {lost[0] + 1}, {lost.size:,} not finite in all"
                raise ValueError(
                    f"dataset {self.name}: column {key!r} must be one finite number per row; "
                    f"got {got}"
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
        # Held-out rows have the same columns and units.
        if self.held_out is not None:
            apart = self.held_out
            if (set(apart.columns), dict(apart.units), apart.output, apart.held_out) != (
                set(columns), dict(self.units), self.output, None,
            ):  # fmt: skip
                raise ValueError(
                    f"dataset {self.name}: held_out must have the same columns, units and output, "
                    f"and no held_out rows; it has {dict(apart.units)}, output "
                    f"{apart.output!r}"
                )
        object.__setattr__(self, "columns", columns)

    def __repr__(self) -> str:
        """One line with the name, the number of rows, and the columns with their units."""
        units = (f"{name} [{self.units[name]}]" for name in self.columns)
        held_out = "" if self.held_out is None else f", {len(self.held_out):,} held out"
        return (
            f"<Dataset {self.name}: {len(self):,} rows{held_out}; columns: {', '.join(units)}; "
            f"output: {self.output}>"
        )

    def __len__(self) -> int:
        return self.columns[self.output].size

    def __iter__(self) -> Iterator[str]:
        """Names of the columns, as of a mapping."""
        return iter(self.columns)

    def __getitem__(self, column: str) -> Array:
        """The column of that name, (N,)."""
        try:
            return self.columns[column]
        except KeyError:
            raise ValueError(
                f"dataset {self.name}: no column {column!r}; columns are {', '.join(self.columns)}"
            ) from None

    def select(self, rows: NDArray[np.bool_]) -> Dataset:
        """The rows with True in a mask (N,), under the same name; `held_out` is kept."""
        rows = np.asarray(rows)
        if rows.dtype != bool or rows.shape != (len(self),):
            raise ValueError(
                f"dataset {self.name}: expected a mask of {len(self)} truth values; got "
                f"{rows.dtype} of shape {rows.shape}"
            )
        return replace(self, columns={key: column[rows] for key, column in self.columns.items()})

    def thinned(self, every: int) -> Dataset:
        """The first of every `every` rows; `held_out` is kept."""
        whole("every", every, 1)
        return self.select(np.arange(len(self)) % every == 0)

    def hold_out(self, ranges: Mapping[str, Sequence[float]]) -> Dataset:
        """Hold out the rows that are in all of these ranges.

        Parameters
        ----------
        ranges : mapping of str to sequence of float
            For each column, (from, to), both included, in the column's unit.

        Returns
        -------
        Dataset
            The other rows, with the selected ones in `held_out`.

        Raises
        ------
        ValueError
            If rows are held out already, or the ranges contain no row or every row.
        """
        if self.held_out is not None or not ranges:
            raise ValueError(
                f"dataset {self.name}: "
                + ("rows are held out already" if ranges else "no columns are given")
                + "; give columns and ranges once, for example {Fz: [3900, 4100]}"
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
        """SHA-256 over names, units and bytes of all columns, including held-out rows."""
        digest = hashlib.sha256(self.output.encode())
        for key in sorted(self.columns):
            digest.update(f"\0{key}\0{self.units[key]}\0".encode())
            digest.update(self.columns[key].astype("<f8").tobytes())
        if self.held_out is not None:
            digest.update(f"\0\0held out\0{self.held_out.digest}".encode())
        return digest.hexdigest()
