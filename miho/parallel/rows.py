"""A function of rows of parameters, called so that a row that raises costs itself alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.parallel.remote import Raised

Array = NDArray[np.float64]
Rows = Callable[[Array], Array]
"""Values (n, ...) of parameter rows (n, d); those of a row do not depend on the others."""


@dataclass(frozen=True)
class ByRows:
    """Calls a function of rows, and row by row where it raises."""

    function: Rows

    def __call__(self, thetas: Array) -> list[Array | Raised]:
        """The value of each row, or what it raised."""
        try:
            values = np.asarray(self.function(thetas))
            if values.dtype.kind not in "fiu":
                raise TypeError(f"not real numbers: {values.dtype} of shape {values.shape}")
            if values.shape[:1] != (len(thetas),):
                raise ValueError(f"values of shape {values.shape} for {len(thetas)} rows")
            return list(values)
        except Exception as error:  # noqa: BLE001 -- whatever a model raises is its value
            if len(thetas) == 1:
                return [Raised.of(error)]
        return [value for theta in thetas for value in self(theta[None])]


def as_array(value: Any) -> Array | Raised:
    """A value in the precision in which a journal keeps it."""
    return value if isinstance(value, Raised) else np.asarray(value, dtype=float)
