"""What a parametric model is: named inputs and parameters, values and derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Model(ABC):
    """A pure function of input columns and a batch of parameters, in SI units and radians.

    `inputs` and `parameters` map the names of what it reads to their units, in order; `output` is
    the unit of what it gives.
    """

    inputs: Mapping[str, str]
    parameters: Mapping[str, str]
    output: str

    @abstractmethod
    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,).

        A new array, which the caller may overwrite; a row is the same in any batch.
        """

    @abstractmethod
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the outputs, (N, d), at one configuration (d,)."""
