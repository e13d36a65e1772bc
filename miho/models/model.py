"""What a parametric model is: named inputs and parameters, values and derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Model(ABC):
    """A pure function of input columns and a batch of parameters, in SI units and radians.

    `inputs` and `parameters` name what it reads, in order; `units` are those of the parameters.
    """

    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    units: tuple[str, ...]

    @abstractmethod
    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,).

        A new array, which the caller may overwrite; a row is the same in any batch.
        """

    @abstractmethod
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the outputs, (N, d), at one configuration (d,)."""
