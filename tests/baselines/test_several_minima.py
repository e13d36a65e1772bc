"""Searches over the whole box find the lowest of many minima."""

import numpy as np
import pytest

from miho import Budget, LeastSquaresProblem, Optimizer, Parameter, Space, minimize
from miho.methods.cluster_gauss_newton import ClusterGaussNewton
from miho.methods.hickernell_yuan import HickernellYuan
from miho.methods.least_squares import LeastSquares
from miho.methods.scatter_search import ScatterSearch
from miho.methods.tiktak import TikTak
from miho.optim.problem import mean_square
from miho.quantities import Array


class Oscillation(LeastSquaresProblem):
    """a sin(w t) on exact data: its loss has a minimum about every 2 pi / 3 of w, and 0 at 17.3."""

    name = "oscillation"
    space = Space((Parameter("a", "-", 0.2, 5.0), Parameter("w", "rad/s", 1.0, 40.0)))
    t = np.linspace(0.0, 3.0, 50)

    def residuals(self, theta: Array) -> Array:
        return np.asarray(theta[0] * np.sin(theta[1] * self.t) - 1.5 * np.sin(17.3 * self.t))

    def jacobian(self, theta: Array) -> Array:
        a, w = theta
        return np.stack([np.sin(w * self.t), a * self.t * np.cos(w * self.t)], axis=1)

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return np.array([mean_square(self.residuals(theta)) for theta in thetas])


@pytest.mark.parametrize(
    "method",
    [
        TikTak(),
        HickernellYuan(),
        ScatterSearch(),
        LeastSquares(screen=50, starts=5, rounds=None),
        ClusterGaussNewton(rounds=None),
    ],
    ids=lambda method: type(method).__name__,
)
@pytest.mark.parametrize("seed", [1, 2])
def test_the_lowest_minimum_is_found(method: Optimizer, seed: int) -> None:
    problem = Oscillation()
    local = minimize(LeastSquares(screen=1, starts=1, rounds=1), problem, seed=seed)
    assert local.loss > 0.1, "one descent from the common start ends elsewhere"
    record = minimize(method, problem, Budget(evaluations=20_000, target=1e-16), seed=seed)
    assert record.theta == pytest.approx([1.5, 17.3], rel=1e-6)
