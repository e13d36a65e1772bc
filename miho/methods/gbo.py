"""Gradient-based optimisation as in the paper's comparison: plain gradient descent."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from miho.optim import Optimizer, Oracle, UnusableValueError
from miho.validate import positive


@dataclass(frozen=True)
class GBO(Optimizer):
    """theta <- theta - learning_rate * gradient of the loss, from the first common configuration.

    One rate for all parameters, in SI units, as the paper has it (Sec. V-A.3: 5e-12 and 1e-10 on
    a loss in N^2); steps are projected onto the box. The gradient is 2/N J^T r with the problem's
    own Jacobian, which the oracle charges. Needs a least-squares problem; runs until the budget
    ends. Not a method to prefer: parameters of unequal scale need unequal rates.
    """

    learning_rate: float

    def __post_init__(self) -> None:
        positive("learning_rate", self.learning_rate)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Descend; where there is no finite gradient, there is no way on, and the run ends."""
        space = oracle.space
        theta = space.decode(space.initial(1))[0]
        with contextlib.suppress(UnusableValueError):
            while True:
                residuals = oracle.residuals(theta)
                gradient = 2 / residuals.size * (oracle.jacobian(theta).T @ residuals)
                if not np.isfinite(gradient).all():
                    return
                theta = space.clip(theta - self.learning_rate * gradient)
