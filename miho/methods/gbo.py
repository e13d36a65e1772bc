"""Gradient-based optimisation as in the paper's comparison: plain gradient descent."""

from __future__ import annotations

import contextlib
import itertools
from dataclasses import dataclass

import numpy as np

from miho.optim import Optimizer, Oracle, Space, UnusableValueError
from miho.optim.space import SAMPLINGS
from miho.quantities import Array
from miho.validate import one_of, positive, whole

UNITS = ("SI", "kN_deg", "box")
SIZES = {"N": 1e3, "rad": np.pi / 180, "1/rad": 180 / np.pi}
"""SI units in a kN, a degree and a 1/degree, by the SI unit of the parameter."""


@dataclass(frozen=True)
class GBO(Optimizer):
    """Gradient descent with a constant rate, from the first common configuration.

    theta <- theta - learning_rate * gradient of the loss. All parameters have the same rate, as in
    the paper (Sec. V-A.3: 5e-12 and 1e-10); steps are projected onto the box. The gradient is
    2/N J^T r with the problem's Jacobian, which the oracle charges. The method requires a
    least-squares problem. It is not recommended: parameters with different scales need different
    rates.

    Parameters
    ----------
    learning_rate : float
        The rate, for a loss in the squared SI unit of the residuals, N^2 for a tire. Multiply a
        rate for a loss in kN^2 by 1e-6.
    units : {"SI", "kN_deg", "box"}
        Units of the parameters for the step. They determine its length, because the
        gradient is per unit: SI; kN, degrees and 1/degrees instead of N, rad and 1/rad; or
        multiples of each parameter's range. A unit of s SI units makes a step s^2 times as long.
    sampling : {"normal", "uniform_plus_noise", "uniform"}
        Distribution of the start, see `miho.optim.Space.sample`.
    steps : int or None
        Number of steps; None to continue until the budget ends.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    learning_rate: float
    units: str = "SI"
    sampling: str = "normal"
    steps: int | None = None

    def __post_init__(self) -> None:
        positive("learning_rate", self.learning_rate)
        one_of("units", self.units, UNITS)
        one_of("sampling", self.sampling, SAMPLINGS)
        whole("steps", self.steps, 1, none=True)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Descend; the run ends if the gradient is not finite."""
        space = oracle.space
        theta = space.clip(space.decode(space.initial(1, self.sampling)))[0]
        rates = self.learning_rate * self._unit_sizes(space) ** 2
        with contextlib.suppress(UnusableValueError):
            for _ in itertools.count() if self.steps is None else range(self.steps):
                residuals = oracle.residuals(theta)
                gradient = 2 / residuals.size * (oracle.jacobian(theta).T @ residuals)
                if not np.isfinite(gradient).all():
                    return
                theta = space.clip(theta - rates * gradient)

    def _unit_sizes(self, space: Space) -> Array:
        """The size (d,) of each parameter's unit for steps, in its SI unit."""
        if self.units == "box":
            return space.high - space.low
        if self.units == "kN_deg":
            return np.array([SIZES.get(parameter.unit, 1.0) for parameter in space.parameters])
        return np.ones(len(space))
