"""The interface of all methods that track parameters: settings, and a run that takes rows."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from miho.data.dataset import Dataset
from miho.identification.curve_fit import CurveFit
from miho.online.outputs import TIME
from miho.online.state import TrackerState
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.report import Report

Problems = CurveFit | Sequence[CurveFit]
"""A problem, or one for each output; problems share parameters and inputs by name."""

Rows = Dataset | Mapping[str, Any]
"""Columns by name: numbers for one row, array_like for several."""


def numbers_of(name: str, column: Any) -> Array:
    """Return the numbers (n,) of a column of rows: one number, or one for each row.

    A masked value is NaN. Raises ValueError if the column is not of numbers.
    """
    try:
        if isinstance(column, np.ma.MaskedArray):
            column = np.where(np.ma.getmaskarray(column), np.nan, np.ma.getdata(column))
        return np.atleast_1d(np.asarray(column, dtype=float))
    except (TypeError, ValueError, OverflowError):
        raise ValueError(
            f"rows: column {name!r} is {column!r:.60}; expected numbers; times are in seconds"
        ) from None


def rows_of(rows: Rows, names: Sequence[str], first: float, period: float) -> Array:
    """Rows (n, k + 1) of the columns with these names and of the time.

    Without a column of the time, the rows follow one another by `period` [s] from `first` on.
    Raises ValueError if a column is missing or not of numbers, or columns differ in length.
    """
    columns: Mapping[str, Any] = rows.columns if isinstance(rows, Dataset) else rows
    try:
        numbers = [columns[name] for name in names]
    except KeyError as error:
        raise ValueError(
            f"rows: no column {error.args[0]!r}; expected {', '.join(names)}, and NaN "
            "for a missing value"
        ) from None
    except (TypeError, IndexError):
        kind = type(rows).__name__
        raise ValueError(f"rows is a {kind}; expected a Dataset, or columns by name") from None
    single = [*numbers, columns.get(TIME, first)]
    if all(isinstance(number, float | int) for number in single):
        with contextlib.suppress(OverflowError):
            return np.array([single], dtype=float)
    values = [numbers_of(*pair) for pair in zip(names, numbers, strict=True)]
    count = values[0].size
    values.append(numbers_of(TIME, columns.get(TIME, first + period * np.arange(count))))
    for name, column in zip([*names, TIME], values, strict=True):
        if column.shape != (count,):
            raise ValueError(
                f"rows: column {name!r} has the shape {column.shape}; expected ({count},)"
            )
    return np.column_stack(values)


class Running(ABC):
    """Abstract base class of a run of a method: it takes rows and returns its state."""

    @abstractmethod
    def update(self, rows: Rows) -> TrackerState:
        """Take one or several rows, and return the state after the last of them.

        Parameters
        ----------
        rows : Dataset or mapping of str
            Columns by name: numbers for one row, arrays for several; NaN or masked for a missing
            value.

        Returns
        -------
        TrackerState
            Its alarm is the last one that these rows raised.
        """


class OnlineMethod(ABC):
    """Abstract base class of a method that tracks parameters: a frozen dataclass of settings.

    One instance starts any number of runs.
    """

    @abstractmethod
    def start(
        self,
        problem: Problems,
        prior: Report | Mapping[str, tuple[float, float]] | None = None,
        changes: Mapping[str, float] | None = None,
        input_noise: Mapping[str, float] | None = None,
        period: float = 0.02,
    ) -> Running:
        """Return a run that has seen no row.

        Parameters
        ----------
        problem : CurveFit or sequence of CurveFit
            The model of each output, its bounds, and the standard deviation of its errors.
        prior : Report or mapping of str to (value, standard deviation), optional
            Knowledge from before; by default the middle of the bounds and a share of their width.
        changes : mapping of str to float, optional
            Parameters that may jump, and the share of their value by which they may; by default
            each free parameter by 0.35.
        input_noise : mapping of str to float, optional
            Standard deviation of the noise of input columns, in their units.
        period : float, optional
            Time between two rows [s], for rows without a column "time".

        Returns
        -------
        Running
            The run.
        """
