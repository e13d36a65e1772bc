"""Multi-start nonlinear least squares: what an expert would try first."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from miho.optim import Optimizer, Oracle, UnusableValueError
from miho.optim.space import LARGEST_BATCH
from miho.optim.validate import positive, whole

Array = NDArray[np.float64]


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
        low, high = oracle.space.low, oracle.space.high

        def solve(theta: Array) -> None:
            descend(oracle.residuals, oracle.jacobian, theta, (low, high), self.tolerance)

        multi_start(oracle, rng, self.screen, self.starts, self.rounds, solve)


def multi_start(
    oracle: Oracle,
    rng: np.random.Generator,
    screen: int,
    starts: int,
    rounds: int,
    solve: Callable[[Array], None],
) -> None:
    """Call `solve` on the `starts` best (d,) of `screen` configurations, `rounds` times."""
    space = oracle.space
    coordinates = space.initial(screen)
    for _ in range(rounds):
        thetas = space.decode(coordinates)
        losses = oracle(thetas)
        for i in np.argsort(losses, kind="stable")[:starts]:
            if not np.isfinite(losses[i]):
                break
            # A start that leads to unusable residuals or derivatives is given up.
            with contextlib.suppress(UnusableValueError, ValueError, np.linalg.LinAlgError):
                solve(thetas[i])
        coordinates = space.sample(screen, rng)


def descend(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    start: Array,
    bounds: tuple[Array, Array],
    tolerance: float,
) -> None:
    """SciPy's bounded trust-region solver (trf, scaled by the Jacobian) from one start."""
    scipy.optimize.least_squares(
        residuals,
        start,
        jac=jacobian,
        bounds=bounds,
        method="trf",
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=None,  # it is absolute, and no unit of the residuals is known here
    )
