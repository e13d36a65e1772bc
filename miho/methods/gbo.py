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
"""SI units in a kN, a degree and a 1/degree, by the unit that a parameter has in SI."""


@dataclass(frozen=True)
class GBO(Optimizer):
    """theta <- theta - learning_rate * gradient of the loss, from the first common configuration.

    One rate for all parameters, as the paper has it (Sec. V-A.3: 5e-12 and 1e-10); steps are
    projected onto the box. The gradient is 2/N J^T r with the problem's own Jacobian, which the
    oracle charges. Needs a least-squares problem; runs until the budget ends, or for `steps`. Not a
    method to prefer: parameters of unequal scale need unequal rates.

    Parameters
    ----------
    learning_rate : float
        The rate, for a loss in the squared SI unit of the residuals, N^2 for a tire. A rate that is
        meant for a loss in kN^2 is given 1e-6 times as large.
    units : {"SI", "kN_deg", "box"}
        Units of the parameters in which the step is made, on which its length depends, because the
        gradient is per unit: SI; kN, degrees and 1/degrees where SI has N, rad and 1/rad; or
        multiples of each parameter's range. A unit of s SI units makes a step s^2 times as long.
    sampling : {"normal", "uniform_plus_noise", "uniform"}
        Distribution of the start, as in `miho.optim.Space.sample`.
    steps : int or None
        Steps after which the method ends by itself; None for no limit.

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
        if self.steps is not None:
            whole("steps", self.steps, 1)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Descend; where there is no finite gradient, there is no way on, and the run ends."""
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
        """The size (d,) of the unit in which each parameter is moved, in its SI unit."""
        if self.units == "box":
            return space.high - space.low
        if self.units == "kN_deg":
            return np.array([SIZES.get(parameter.unit, 1.0) for parameter in space.parameters])
        return np.ones(len(space))
