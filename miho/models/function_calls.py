"""How a plain function is called: with all rows of parameters side by side, or with each alone."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.parallel.worth import is_dear
from miho.quantities import Array

COMPARED, CONFIGURATIONS = 1000, 3
"""Rows of data that are evaluated alone and among all, and for how many rows of parameters."""
MOST_LONG = 2
"""So many calls that take long are made in vain at most."""
TRIED = 10
"""Rows of parameters at most for which both ways are compared."""
ROUNDING = 1e-12
"""Values differ by rounding if by less than this share of the largest in their row."""
REMEDY = (
    "with one row of parameters at a time it works; set batched to false, or write it with NumPy "
    "functions that broadcast"
)

Columns = Sequence[Array]


class Calls(NamedTuple):
    """What trial calls have shown of a function: whether it is `batched`, whether `rowwise`, and
    whether it is so `dear` that it is not called in vain; None is not known."""

    batched: bool | None = None
    rowwise: bool | None = None
    dear: bool = False


UNTRIED = Calls()


class FunctionCalls:
    """The values of `function(columns, parameters)`, which gives numbers or raises ValueError.

    Columns are (N,). Side by side, parameters are (n, 1) each and the result (n, N), or (n, 1) if
    it is the same for all rows of data; alone, they are numbers, and the result (N,) or a number.
    With `batched` None it is as `tried`. Where that is not known either, rows of parameters that
    come together are evaluated alone, and if a call is cheap, once side by side too: that stays if
    it gives the same to rounding, else it is not tried again. A row that comes alone before that is
    evaluated so, or as (1, 1) where the function takes no numbers. So how long a call takes moves
    results by rounding at most. `place` stands before messages.
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
        """Outputs (n, N) of parameter rows (n, d), a new array."""
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
            if self.automatic:  # the rows that decided were alike by chance
                self.batched = False
                return alone
            raise ValueError(f"{error}; {REMEDY}") from error

    def _first(self, thetas: Array, columns: Columns) -> Array:
        """The values, while it is not known how the function takes them."""
        if len(thetas) == 1:
            started = time.perf_counter()
            try:
                return self._alone(thetas[0], columns)[None]
            except ValueError:
                if not self.takes_numbers and not is_dear(time.perf_counter() - started):
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
        # The fastest call counts, since a first one may load or compile what the function needs.
        if not seconds or not is_dear(min(seconds)):
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
                f"{self.place}: gives shape {values.shape} for columns ({rows},) and parameters "
                f"({n}, 1); expected ({n}, {rows})"
            )
        return np.broadcast_to(values, (n, rows)).astype(float)

    def _each(self, thetas: Array, columns: Columns) -> Array:
        return np.array([self._alone(theta, columns) for theta in thetas])

    def _each_or_none(self, thetas: Array, columns: Columns) -> Array | None:
        """The values of each row alone, None where the function fails on one."""
        try:
            return self._each(thetas, columns)
        except ValueError:
            return None

    def _alone(self, theta: Array, columns: Columns) -> Array:
        values = self.function(columns, theta.tolist())
        rows = columns[0].size
        if values.shape not in ((rows,), ()):
            raise ValueError(
                f"{self.place}: gives shape {values.shape} for columns ({rows},); "
                f"expected ({rows},)"
            )
        self.takes_numbers = True
        return values.astype(float) if values.shape else np.full(rows, float(values))


def alike(first: Array, second: Array) -> bool:
    """Whether rows (n, N) are the same to ROUNDING, with NaN and infinity in the same places."""
    if np.array_equal(first, second):
        return True
    size = np.abs(np.where(np.isfinite(first), first, 0.0)).max(axis=1, initial=0.0)
    close = np.isclose(first, second, rtol=0.0, atol=ROUNDING * size[:, None], equal_nan=True)
    return bool(close.all())


def tried_rowwise(
    predict: Callable[..., Array], thetas: Array, columns: Columns
) -> tuple[bool | None, bool]:
    """Whether outputs are element by element, and whether each call takes long.

    Some rows of the columns (N,) alone, mixed, are compared with what they give among all, at
    parameter rows (n, d). A function that is not element by element ends that with its first two
    calls. So does a dear one, for which they both take long: None then, as for one that fails at
    all parameters, and for too few rows.
    """
    rows, seconds, long, compared = inner_rows(columns, COMPARED), math.inf, 0, 0
    part = [column[rows] for column in columns]
    for theta in thetas:
        if compared == CONFIGURATIONS or (long == MOST_LONG and not compared):
            break
        started = time.perf_counter()
        among_all = _or_none(predict, theta, columns)
        took = time.perf_counter() - started
        long += is_dear(took)
        seconds = min(took, seconds)  # a first call may load or compile something
        if among_all is None or not rows.size or not np.isfinite(among_all[:, rows]).any():
            continue  # which says nothing, here
        started = time.perf_counter()
        alone = _or_none(predict, theta, part)
        if is_dear(min(took, time.perf_counter() - started)):
            return None, True
        if alone is None or not alike(among_all[:, rows], alone):
            return False, is_dear(seconds)
        compared += 1
    return compared > 0 or None, is_dear(seconds)


def _or_none(predict: Callable[..., Array], theta: Array, columns: Columns) -> Array | None:
    try:
        return predict(theta[None], *columns)
    except ValueError:
        return None


def inner_rows(columns: Columns, most: int) -> NDArray[np.intp]:
    """Up to `most` rows of the columns (N,), half of all at most, mixed and without any end.

    What a function makes of the first or last row, or of the least or largest value of a column,
    it makes of others among these; a column in which most rows are at an end has none. Empty where
    fewer than two rows are left.
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
