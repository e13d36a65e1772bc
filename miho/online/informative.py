"""A bounded number of rows that inform the parameters most, for a fit of the present."""

from __future__ import annotations

import math

import numpy as np

from miho.quantities import Array

FADING = 60.0
"""Time in which the information of a row counts less by a factor e [s]."""


class InformativeRows:
    """The rows (n, width) with the largest information, of which old ones count less.

    Parameters
    ----------
    most : int
        Largest number of rows.
    width : int
        Length of a row.
    """

    def __init__(self, most: int, width: int) -> None:
        self._rows = np.zeros((most, width))
        self._keys = np.full(most, -math.inf)
        self._place, self._least = 0, -math.inf

    def note(self, row: Array, information: float, clock: float) -> None:
        """Keep a row in the place of the one with the least information, if it has more."""
        if information <= 0:
            return
        key = math.log(information) + clock / FADING
        if key > self._least:
            self._rows[self._place] = row
            self._keys[self._place] = key
            self._place = int(np.argmin(self._keys))
            self._least = float(self._keys[self._place])

    def clear(self) -> None:
        """Forget all rows, which describe the time before a change."""
        self._keys[:] = self._least = -math.inf

    @property
    def rows(self) -> Array:
        """The rows, in order of their last number, the time."""
        rows = self._rows[np.isfinite(self._keys)]
        return np.asarray(rows[np.argsort(rows[:, -1], kind="stable")])
