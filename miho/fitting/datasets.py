"""Datasets of one model: in its signs, as arguments of a call, and as arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from miho.fitting.arguments import Stated, by_name, inputs_of, named, numbers_in, signed_model
from miho.models.model import Model
from miho.optim import Parameter, Space
from miho.quantities import Array

if TYPE_CHECKING:
    import pandas as pd

OTHERWISE = "or a data frame as x, with the name of a column as y and as by"
"""What datasets of different lengths are given as."""
EXTREME = 5
"""Number of datasets at either end of a measure of sizes and signs that are checked."""


def check_bounds(space: object) -> None:
    """Raise ValueError unless bounds are given by name."""
    if not isinstance(space, Mapping | Space | None):
        kind = type(space).__name__
        raise ValueError(f"bounds are of type {kind}; give them by name, as in {{'a': (0, 10)}}")


class Groups:
    """Datasets that are groups of a data frame with one value in each column of `by`.

    They are in order of appearance. Raises ValueError for missing columns, and for a frame without
    rows.
    """

    def __init__(self, frame: Any, y: Any, by: str | Sequence[str]) -> None:
        names = [y, by] if isinstance(by, str) or not isinstance(by, Sequence) else [y, *by]
        named = len(names) > 1 and hasattr(frame, "groupby")
        if not named or not all(isinstance(name, str) and name in frame for name in names):
            raise ValueError(
                f"by is {_shown(by)} and y is {_shown(y)}; expected the names of columns of a data "
                "frame x"
            )
        by = by if isinstance(by, str) else [*by]
        codes = frame.groupby(by, sort=False, dropna=False).ngroup().to_numpy()
        if not codes.size:
            raise ValueError("x: the data frame has no rows; expected at least one")
        _, codes = np.unique(codes, return_inverse=True)  # all groups have rows
        self.order = np.argsort(codes, kind="stable")
        self.ends = np.concatenate([[0], np.cumsum(np.bincount(codes))])
        self.frame, self.y = frame, y
        self.index: pd.Index[Any] = frame.iloc[self.order[self.ends[:-1]]].set_index(by).index

    def part(self, k: int) -> tuple[Any, Any]:
        """Input columns and output of a dataset, as arguments of `miho.fit`."""
        return self.frame.iloc[self.order[self.ends[k] : self.ends[k + 1]]], self.y

    def of(self, model: Model) -> Datasets:
        """All datasets as arrays."""
        X = np.array([column[self.order] for column in inputs_of(model, self.frame).values()])
        y = numbers_in(self.y, self.frame[self.y])[self.order]
        return Datasets.checked(X, y, self.ends, self.index)


def _with_masks(values: Any) -> Any:
    """A list of masked arrays as one array; NumPy would drop the masks."""
    masked = isinstance(values, Sequence) and any(
        isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value) for value in values
    )
    return np.ma.array(values) if masked else values


def _shown(value: object) -> str:
    """A name, or the type of anything else."""
    return repr(value) if isinstance(value, str | list | int) else f"a {type(value).__name__}"


class Rows:
    """Datasets that are rows of y (M, N), over columns (N,) or (M, N) in x.

    Raises ValueError for any other shape of y.
    """

    def __init__(self, x: Any, y: Any) -> None:
        if isinstance(y, Mapping):
            raise ValueError(f"y is a {type(y).__name__}; expected an array, {OTHERWISE}")
        if isinstance(y, str):
            raise ValueError(f"y is {y!r}; expected by= as well, the column that names the dataset")
        try:
            np.shape(y)
        except ValueError:  # of lists with different lengths
            raise ValueError(
                f"y: expected an array of numbers (datasets, rows), {OTHERWISE}"
            ) from None
        self.y = numbers_in("y", _with_masks(y), 2)
        if self.y.ndim != 2 or not self.y.size:
            raise ValueError(
                f"y has the shape {self.y.shape}; expected (datasets, rows), {OTHERWISE}"
            )
        self.index = None
        self.by_name = by_name(x)
        names = [*x] if self.by_name else range(len(x) if isinstance(x, tuple) else 1)
        columns = [x[name] for name in x] if self.by_name else x if isinstance(x, tuple) else (x,)
        self.columns = dict(
            zip(names, [numbers_in("x", _with_masks(each), 2) for each in columns], strict=True)
        )
        for column in self.columns.values():
            if column.shape[-1:] != self.y.shape[1:]:
                raise ValueError(
                    f"x has {column.shape[-1] if column.ndim else 0} rows and y has "
                    f"{self.y.shape[1]}; give y as (datasets, rows)"
                )
            if column.ndim == 2 and len(column) != len(self.y):
                raise ValueError(
                    f"x has {len(column)} datasets and y {len(self.y)}; expected the same number"
                )

    def part(self, k: int) -> tuple[Any, Any]:
        """Input columns and output of a dataset, as arguments of `miho.fit`."""
        own = {name: c[k] if c.ndim == 2 else c for name, c in self.columns.items()}
        return own if self.by_name else tuple(own.values()), self.y[k]

    def of(self, model: Model) -> Datasets:
        """All datasets as arrays."""
        names = [*inputs_of(model, self.part(0)[0])] if self.by_name else [*self.columns]
        columns = [self.columns[name] for name in names]
        M, N = self.y.shape
        ends = np.arange(M + 1) * N
        if all(column.ndim == 1 for column in columns):
            return Datasets.checked(np.array(columns), self.y.ravel(), ends)
        X = np.array([np.broadcast_to(column, (M, N)).ravel() for column in columns])
        return Datasets.checked(X, self.y.ravel(), ends)


@dataclass(frozen=True)
class Datasets:
    """Columns X (p, n) and outputs y (n,) of M concatenated datasets; shared columns are X (p, N).

    Dataset k has the rows from ends[k] to ends[k + 1]. If `shared`, all datasets have the same X.
    `index` has their names, by default numbers from 0.
    """

    X: Array
    y: Array
    ends: NDArray[np.int64]
    shared: bool
    index: Any = None

    @classmethod
    def checked(cls, X: Array, y: Array, ends: NDArray[np.int64], index: Any = None) -> Datasets:
        """Datasets from arrays; columns that are equal in all of them are shared.

        Raises ValueError for values that are not finite.
        """
        lengths = np.diff(ends)
        if X.shape[1] == y.size and (lengths == lengths[0]).all():
            apart = X.reshape(len(X), len(lengths), -1)
            if (apart == apart[:, :1]).all():
                X = apart[:, 0]
        shared = X.shape[1] == lengths[0]
        for values in (y, *X):
            bad = ~np.isfinite(values)
            if bad.any():
                at = np.flatnonzero(bad)[0]
                k = np.searchsorted(ends, at, side="right") - 1
                raise ValueError(
                    f"dataset {k if index is None else index[k]}: a number is missing or infinite "
                    f"in row {at - ends[k] + 1}; remove this row, or the dataset"
                )
        X, y = np.ascontiguousarray(X, dtype=float), np.ascontiguousarray(y, dtype=float)
        return cls(X, y, np.ascontiguousarray(ends, dtype=np.int64), bool(shared), index)

    def __len__(self) -> int:
        return len(self.ends) - 1

    def in_signs_of(
        self,
        model: Model,
        convention: str,
        ranges: Mapping[str, Sequence[float] | None] | None,
        stated: Stated,
    ) -> Datasets:
        """These datasets in the signs of a model; arguments as of `in_signs_of`.

        Raises ValueError for impossible columns of a dataset.
        """
        signed = signed_model(model)
        if signed is None:
            return self
        largest = largest_values(stated)
        for k in self._extreme:
            rows = slice(self.ends[k], self.ends[k + 1])
            X = self.X if self.shared else self.X[:, rows]
            own = dict(zip(model.inputs, X, strict=True))
            try:
                signed.check_data(own, self.y[rows], convention, ranges, largest)
            except ValueError as error:
                name = k if self.index is None else self.index[k]
                raise ValueError(f"dataset {name}: {error}") from None
        columns = dict(zip(model.inputs, self.X, strict=True))
        columns, y = signed.converted(columns, self.y, convention)
        return replace(self, X=np.array([*columns.values()]), y=y)

    @property
    def _extreme(self) -> NDArray[np.intp]:
        """Datasets with the largest and smallest columns and correlations of input and output.

        Columns whose sizes and signs are possible in all of them are possible in the others.
        """
        starts, n = self.ends[:-1], self.rows

        def centred(column: Array) -> Array:
            return column - np.repeat(np.add.reduceat(column, starts) / n, n)

        X = np.tile(self.X, len(self)) if self.shared else self.X
        measures = [np.maximum.reduceat(np.abs(column), starts) for column in (*X, self.y)]
        measures = [np.where(size > 0, size, size.max()) for size in measures]
        y = centred(self.y)
        for x in map(centred, X):
            size = np.sqrt(np.add.reduceat(x * x, starts) * np.add.reduceat(y * y, starts))
            product = np.add.reduceat(x * y, starts)
            measures.append(np.sqrt(n) * product / np.where(size > 0, size, np.inf))
        order = np.argsort(measures, axis=1, kind="stable")
        return np.unique([order[:, :EXTREME], order[:, -EXTREME:]])

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """Number of rows of each dataset, (M,)."""
        return np.diff(self.ends)

    def output(self, k: int) -> Array:
        """Output (N,) of a dataset."""
        return self.y[self.ends[k] : self.ends[k + 1]]


def in_signs_of(
    model: Model,
    inputs: dict[str, Array],
    output: Array,
    convention: str,
    ranges: Mapping[str, Sequence[float] | None] | None,
    stated: Stated,
) -> tuple[dict[str, Array], Array]:
    """Input and output columns (N,) in the signs of the model.

    `stated` is known about parameters. Raises ValueError for impossible columns, and for a
    convention or ranges of a model without signs.
    """
    signed = signed_model(model)
    if signed is not None:
        signed.check_data(inputs, output, convention, ranges, largest_values(stated))
        return signed.converted(inputs, output, convention)
    if convention != "iso-w" or ranges:
        raise ValueError("convention and ranges: expected for the data of a tire only; remove them")
    return inputs, output


def largest_values(stated: Stated) -> dict[str, float]:
    """The largest value of each parameter that bounds, starts and fixed values allow.

    It is infinite if they do not say; later ones take precedence.
    """
    largest: dict[str, float] = {}
    for values in stated:
        largest |= {name: _largest(value) for name, value in named(values).items()}
    return largest


def _largest(value: Any) -> float:
    """The largest value by bounds, a `Parameter`, a mapping of its settings, or numbers."""
    settings = vars(value) if isinstance(value, Parameter) else value
    if isinstance(settings, Mapping):
        fixed = settings.get("fixed")
        value = settings.get("high") if fixed is None else fixed
    try:
        return float(np.max(value))
    except (TypeError, ValueError):  # an expression, or bounds that are refused later
        return math.inf
