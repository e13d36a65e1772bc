"""Calls of a plain function, with all rows of parameters in one batch or with one row each."""

from __future__ import annotations

import contextlib
import dis
import math
import time
from collections.abc import Callable, Sequence
from types import CellType, CodeType, FunctionType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.parallel.worth import is_expensive
from miho.quantities import Array

COMPARED, CONFIGURATIONS = 1000, 3
"""Numbers of data rows and of parameter rows in the test for an elementwise function."""
MOST_LONG = 2
"""Largest number of long trial calls without a result."""
TRIED = 10
"""Largest number of parameter rows for which both ways are compared."""
ROUNDING = 1e-12
"""Tolerance of rounding errors, relative to the largest value of the row."""
REMEDY = (
    "calls with one row of parameters work; set batched to false, or use NumPy functions that "
    "broadcast"
)

Columns = Sequence[Array]


class Calls(NamedTuple):
    """Results of trial calls of a function; None if unknown.

    `batched` and `rowwise` are properties of the function. A function that is `expensive` gets
    no further trial calls.
    """

    batched: bool | None = None
    rowwise: bool | None = None
    expensive: bool = False


UNTRIED = Calls()


class FunctionCalls:
    """Values of `function(columns, parameters)`, which returns numbers or raises ValueError.

    Columns are (N,). In a batch, each parameter is (n, 1) and the result (n, N), or (n, 1) if it
    is the same for all rows of data. In a call with one row, parameters are numbers, and the
    result is (N,) or a number.

    If `batched` is None, `tried` decides. If both are None, the first parameter rows that arrive
    together are evaluated one by one and, if a call is cheap, once more as a batch. The batch is
    kept if both ways agree up to rounding; otherwise it is not tried again. A single row that
    arrives earlier is evaluated with numbers, or as (1, 1) if the function rejects numbers. The
    duration of a call therefore changes results by rounding errors at most.

    `place` is the prefix of messages.
    """

    def __init__(
        self,
        function: Callable[[Columns, Any], NDArray[Any]],
        batched: bool | None,
        tried: bool | None,
        place: str,
    ) -> None:
        self.function, self.place = function, place
        self.automatic, self.batched = batched is None, tried if batched is None else batched
        self.takes_numbers = False

    def values(self, thetas: Array, columns: Columns) -> Array:
        """Return the outputs (n, N) of parameter rows (n, d) as a new array."""
        if not len(thetas):
            return np.empty((0, columns[0].size))
        if self.batched is None:
            return self._first(thetas, columns)
        if not self.batched:
            return self._each(thetas, columns)
        try:
            return self._together(thetas, columns)
        except ValueError as error:
            alone = self._each_or_none(thetas, columns)
            if alone is None:
                raise
            if self.automatic:  # the first rows agreed by chance
                self.batched = False
                return alone
            raise ValueError(f"{error}; {REMEDY}") from error

    def _first(self, thetas: Array, columns: Columns) -> Array:
        """Return the values before the way of calling is known, and decide it."""
        if len(thetas) == 1:
            started = time.perf_counter()
            try:
                return self._alone(thetas[0], columns)[None]
            except ValueError:
                if not self.takes_numbers and not is_expensive(time.perf_counter() - started):
                    with contextlib.suppress(ValueError):
                        return self._together(thetas, columns)
                raise
        seconds, failure = [], None
        alone = np.full((min(len(thetas), TRIED), columns[0].size), np.nan)
        worked = np.zeros(len(alone), dtype=bool)
        for k, theta in enumerate(thetas[:TRIED]):
            started = time.perf_counter()
            try:
                alone[k], worked[k] = self._alone(theta, columns), True
                seconds.append(time.perf_counter() - started)
            except ValueError as error:
                failure = error
        # The fastest call counts, because the first one may load or compile something.
        if not seconds or not is_expensive(min(seconds)):
            with contextlib.suppress(ValueError):
                together = self._together(thetas, columns)
                if alike(alone[worked], together[: len(alone)][worked]):
                    self.batched = True
                    return together
            if failure is None:
                self.batched = False
        if failure is not None:
            raise failure
        return np.vstack([alone, *(self._alone(theta, columns) for theta in thetas[TRIED:])])

    def _together(self, thetas: Array, columns: Columns) -> Array:
        values = self.function(columns, thetas.T[:, :, None].copy())
        n, rows = len(thetas), columns[0].size
        if values.shape not in ((n, rows), (n, 1)):
            raise ValueError(
                f"{self.place}: expected shape ({n}, {rows}) for columns ({rows},) and parameters "
                f"({n}, 1), got {values.shape}"
            )
        return np.broadcast_to(values, (n, rows)).astype(float)

    def _each(self, thetas: Array, columns: Columns) -> Array:
        return np.array([self._alone(theta, columns) for theta in thetas])

    def _each_or_none(self, thetas: Array, columns: Columns) -> Array | None:
        """Return the values of calls with one row each, None if a call fails."""
        try:
            return self._each(thetas, columns)
        except ValueError:
            return None

    def _alone(self, theta: Array, columns: Columns) -> Array:
        values = self.function(columns, theta.tolist())
        rows = columns[0].size
        if values.shape not in ((rows,), ()):
            raise ValueError(
                f"{self.place}: expected shape ({rows},) for columns ({rows},), got {values.shape}"
            )
        self.takes_numbers = True
        return values.astype(float) if values.shape else np.full(rows, float(values))


def alike(first: Array, second: Array) -> bool:
    """Return whether rows (n, N) agree to ROUNDING, with NaN and infinity in the same places."""
    if np.array_equal(first, second):
        return True
    size = np.abs(np.where(np.isfinite(first), first, 0.0)).max(axis=1, initial=0.0)
    close = np.isclose(first, second, rtol=0.0, atol=ROUNDING * size[:, None], equal_nan=True)
    return bool(close.all())


def tried_rowwise(
    predict: Callable[..., Array], thetas: Array, columns: Columns
) -> tuple[bool | None, bool]:
    """Return whether outputs are elementwise, and whether each call takes long.

    The function is called with some shuffled rows of the columns (N,), and the outputs are
    compared with the outputs of these rows in a call with all rows, at parameter rows (n, d). The
    first two calls suffice if the function is not elementwise or if both take long. The first
    result is None if both take long, if the function fails at all parameters, and if there are too
    few rows.
    """
    rows, seconds, long, compared = inner_rows(columns, COMPARED), math.inf, 0, 0
    part = [column[rows] for column in columns]
    for theta in thetas:
        if compared == CONFIGURATIONS or (long == MOST_LONG and not compared):
            break
        started = time.perf_counter()
        among_all = _or_none(predict, theta, columns)
        took = time.perf_counter() - started
        long += is_expensive(took)
        seconds = min(took, seconds)  # the first call may load or compile something
        if among_all is None or not rows.size or not np.isfinite(among_all[:, rows]).any():
            continue  # nothing to compare
        started = time.perf_counter()
        alone = _or_none(predict, theta, part)
        if is_expensive(min(took, time.perf_counter() - started)):
            return None, True
        if alone is None or not alike(among_all[:, rows], alone):
            return False, is_expensive(seconds)
        compared += 1
    return compared > 0 or None, is_expensive(seconds)


def _or_none(predict: Callable[..., Array], theta: Array, columns: Columns) -> Array | None:
    try:
        return predict(theta[None], *columns)
    except ValueError:
        return None


def inner_rows(columns: Columns, most: int) -> NDArray[np.intp]:
    """Return up to `most` shuffled rows of the columns (N,), at most half of all, without ends.

    The first and last row and the rows with the smallest or largest value of a column are left
    out: a function that treats them specially gives other outputs for the remaining rows. A column
    with more than half of its rows at an end does not count. The result is empty if fewer than two
    rows remain.
    """
    inner = np.ones(columns[0].size, dtype=bool)
    inner[[0, -1]] = False
    for column in columns:
        end = (column == column.min()) | (column == column.max())
        if end.mean() <= 1 / 2:
            inner &= ~end
    rows = np.random.default_rng(0).permutation(np.flatnonzero(inner))
    rows = rows[: min(most, inner.size // 2)]
    return rows if rows.size >= 2 else rows[:0]


def may_catch(function: Any, callers: tuple[FunctionType, ...] = ()) -> bool:
    """Return whether a function, or one of its module that it uses, may catch errors.

    Such a function may hide that it does not support arrays. `callers` are functions that use it.
    """
    function = getattr(function, "__func__", function)
    if not isinstance(function, FunctionType) or function in callers:
        return False
    codes, names = [function.__code__], set[str]()
    for code in codes:
        if code.co_exceptiontable and any(
            instruction.opname == "PUSH_EXC_INFO" for instruction in dis.get_instructions(code)
        ):
            return True
        names.update(code.co_names)
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    used = [function.__globals__.get(name) for name in names]
    used += [cell.cell_contents for cell in function.__closure__ or () if cell != CellType()]
    module = function.__module__
    return any(
        may_catch(value, (*callers, function))
        for value in used
        if isinstance(value, FunctionType) and value.__module__ == module
    )
