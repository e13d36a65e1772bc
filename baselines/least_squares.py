"""Multi-start nonlinear least squares: what an expert would try first."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
import scipy.optimize

from miho.optim import Optimizer, Oracle, UnusableValueError
from miho.optim.space import LARGEST_BATCH
from miho.optim.validate import positive, whole


@dataclass(frozen=True)
class LeastSquares(Optimizer):
    """Screen random configurations, then run SciPy's bounded trust-region solver from the best.

    A round screens `screen` configurations and starts the solver (trf, scaled by the Jacobian)
    from the `starts` best of them. The first round screens the common initial configurations.
    Ends after `rounds` rounds: a method that has converged should say so. Needs a least-squares
    problem.
    """

    screen: int = 500
    starts: int = 10
    rounds: int = 3
    tolerance: float = 1e-10

    def __post_init__(self) -> None:
        for field in ("screen", "starts", "rounds"):
            whole(field, getattr(self, field), 1, LARGEST_BATCH)
        positive("tolerance", self.tolerance)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Screen and solve, `rounds` times."""
        space = oracle.space
        coordinates = space.initial(self.screen)
        for _ in range(self.rounds):
            thetas = space.decode(coordinates)
            losses = oracle(thetas)
            for i in np.argsort(losses, kind="stable")[: self.starts]:
                if not np.isfinite(losses[i]):
                    break
                # A start that leads to unusable residuals or derivatives is given up.
                with contextlib.suppress(UnusableValueError, ValueError, np.linalg.LinAlgError):
                    scipy.optimize.least_squares(
                        oracle.residuals,
                        thetas[i],
                        jac=oracle.jacobian,
                        bounds=(space.low, space.high),
                        method="trf",
                        x_scale="jac",
                        ftol=self.tolerance,
                        xtol=self.tolerance,
                        gtol=self.tolerance,
                    )
            coordinates = space.sample(self.screen, rng)
