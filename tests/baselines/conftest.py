import numpy as np
import pytest
from scipy.optimize import least_squares

from miho import Parameter, Problem, Space
from miho.quantities import Array
from miho.testing import DecayFit


class Valley(Problem):
    """100 (y - x^2)^2 + (1 - x)^2 with y on a log scale: 0 at (1, 1); NaN for x < -1."""

    name = "valley"
    space = Space((Parameter("x", "", -2.0, 2.0), Parameter("y", "", 1e-3, 1e1, scale="log")))

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        x, y = thetas.T
        return np.where(x < -1, np.nan, 100 * (y - x**2) ** 2 + (1 - x) ** 2)


@pytest.fixture
def valley() -> Problem:
    return Valley()


@pytest.fixture(scope="session")
def optimum() -> float:
    """The smallest loss of `DecayFit`, from its residuals and derivatives."""
    problem = DecayFit()
    solution = least_squares(
        problem.residuals, np.array([1.0, 1.0]), problem.jacobian, xtol=1e-15, ftol=1e-15
    )
    return float(problem.loss(solution.x[None])[0])
