"""What a parametric model is: named inputs and parameters, values and derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Model(ABC):
    """A pure function of input columns and a batch of parameters, in SI units and radians.

    `inputs` and `parameters` map the names of what it reads to their units, in order; `output` is
    the unit of what it gives. `linear` names parameters in which the output is jointly linear when
    all others are held; methods that know how solve for them directly. `name` is what its problems
    are called, the class in small letters if empty; `source` is the file of a model that does not
    belong to this package, so that a change of it is noticed; an `ordered` model needs every row
    of the data in order, as one with a memory does.
    """

    inputs: Mapping[str, str]
    parameters: Mapping[str, str]
    output: str
    linear: tuple[str, ...] = ()
    name: str = ""
    source: Path | None = None
    ordered: bool = False

    @abstractmethod
    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,).

        A new array, which the caller may overwrite; a row is the same in any batch.
        """

    @abstractmethod
    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        """Derivatives of the outputs, (N, d), at one configuration (d,)."""


def central_differences(model: Model, theta: Array, *inputs: Array) -> Array:
    """Derivatives (N, d) of a model without its own, from 2 d rows of one batch.

    The step is the cube root of the machine epsilon times the parameter (times 1 for a parameter
    of 0), which leaves a relative error near 1e-10 in smooth models of well-scaled parameters.
    """
    step = np.cbrt(np.finfo(float).eps) * np.where(theta == 0, 1.0, np.abs(theta))
    rows = np.vstack([theta + np.diag(step), theta - np.diag(step)])
    step = np.diag(rows[: theta.size] - rows[theta.size :])
    high, low = np.split(model.predict(rows, *inputs), 2)
    return np.asarray((high - low).T / step)
