"""Call a function of parameter rows so that a row that raises affects no other row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.parallel.remote import Raised

Array = NDArray[np.float64]
Rows = Callable[[Array], Array]
"""Maps parameter rows (n, d) to values (n, ...); the value of a row does not depend on other
rows."""


@dataclass(frozen=True)
class ByRows:
    """Call a function of rows at once, and row by row if it raises."""

    function: Rows

    def __call__(self, thetas: Array) -> list[Array | Raised]:
        """The value of each row, or the exception that it raised."""
        try:
            values = np.asarray(self.function(thetas))
            if values.dtype.kind not in "fiu":
                raise TypeError(f"not real numbers: {values.dtype} of shape {values.shape}")
            if values.shape[:1] != (len(thetas),):
                raise ValueError(f"values of shape {values.shape} for {len(thetas)} rows")
            return list(values)
        except Exception as error:  # noqa: BLE001 -- any exception counts as the row's value
            if len(thetas) == 1:
                return [Raised.of(error)]
        return [value for theta in thetas for value in self(theta[None])]


def as_array(value: Any) -> Array | Raised:
    """A value in the precision of the journal."""
    return value if isinstance(value, Raised) else np.asarray(value, dtype=float)
