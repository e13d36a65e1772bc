"""L-BFGS-B and Nelder-Mead: exact gradients, known optima, losses of any size."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from miho import Budget, Optimizer, Oracle, Parameter, Problem, Space, minimize
from miho.methods.local_search import LBFGSB, NelderMead, _analytic, _differenced, _ScaledLoss
from miho.methods.unit_box import UnitBox
from miho.optim import Outcome
from miho.quantities import Array
from miho.testing import DecayFit


class Rosenbrock(Problem):
    """Minimum 0 at (1, 1, 1), in a box off centre; one parameter on a log scale."""

    name = "rosenbrock"
    space = Space(
        (
            Parameter("x", "-", -2.0, 3.0),
            Parameter("y", "-", -1.5, 4.0),
            Parameter("z", "-", 0.01, 10.0, scale="log"),
        )
    )

    def __init__(self, size: float = 1.0, wall: float = np.inf) -> None:
        self.size, self.wall = size, wall

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        head, tail = thetas[:, :-1], thetas[:, 1:]
        losses = self.size * (100 * (tail - head**2) ** 2 + (1 - head) ** 2).sum(axis=1)
        return np.where(thetas[:, 2] > self.wall, np.nan, losses)


class Scaled(DecayFit):
    """Residuals in another unit."""

    name = "scaled"

    def __init__(self, unit: float) -> None:
        super().__init__()
        self._unit = unit

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return super().loss(thetas, fidelity) * self._unit**2

    def residuals(self, theta: Array) -> Array:
        return super().residuals(theta) * self._unit

    def jacobian(self, theta: Array) -> Array:
        return super().jacobian(theta) * self._unit


def test_the_unit_box_is_the_space() -> None:
    space = Rosenbrock.space
    box = UnitBox(space)
    assert box.theta(np.zeros(3)) == pytest.approx(space.low, rel=1e-15)
    assert box.theta(np.ones(3)) == pytest.approx(space.high, rel=1e-15)
    x = np.random.default_rng(1).random((50, 3))
    assert box.x(box.theta(x)) == pytest.approx(x, abs=1e-14)
    h = 1e-6 * np.eye(3)
    slope = [(box.theta(x[0] + h[k]) - box.theta(x[0] - h[k]))[k] / 2e-6 for k in range(3)]
    assert box.slope(box.theta(x[0])) == pytest.approx(slope, rel=1e-8)


def test_gradients_are_those_of_the_loss() -> None:
    """Analytic against central differences (1e-7), and forward differences against it (1e-5)."""
    problem = DecayFit()
    oracle, box = Oracle(problem, Budget()), UnitBox(problem.space)
    x = np.array([0.6, 0.4])
    loss, gradient = _analytic(oracle, box)(x)
    assert loss == pytest.approx(problem.loss(box.theta(x)[None])[0], rel=1e-15)
    h = 1e-5 * np.eye(2)
    ahead, behind = problem.loss(box.theta(x + h)), problem.loss(box.theta(x - h))
    assert gradient == pytest.approx((ahead - behind) / 2e-5, rel=1e-7)
    spent = oracle.evaluations
    assert spent == 1 + 2
    assert _differenced(oracle, box)(x)[1] == pytest.approx(gradient, rel=1e-5)
    assert oracle.evaluations == spent + 3
    edge = np.array([1.0, 0.4])
    inward = _differenced(oracle, box)(edge)[1]
    assert inward == pytest.approx(_analytic(oracle, box)(edge)[1], rel=1e-5)


def test_a_descent_is_large_where_it_starts_and_finite_everywhere() -> None:
    losses = iter([4.0, 2.0, np.inf, 8.0])
    scaled = _ScaledLoss(lambda x: (next(losses), np.ones(2)))
    pairs = [scaled(np.zeros(2)) for _ in range(4)]
    assert [value for value, _ in pairs] == pytest.approx([1e12, 0.5e12, 2e12, 2e12])
    assert [gradient[0] for _, gradient in pairs] == pytest.approx([2.5e11, 2.5e11, 0.0, 2.5e11])
    with pytest.raises(ValueError, match="cannot start"):
        _ScaledLoss(lambda x: (np.inf, np.ones(2)))(np.zeros(2))


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize(
    "method",
    [LBFGSB(screen=50, starts=3, rounds=1), NelderMead(screen=50, starts=2, rounds=1)],
)
def test_the_unit_of_the_residuals_does_not_matter(method: Optimizer, unit: float) -> None:
    """L-BFGS-B stops at gains of 1e-10, a simplex at 1e-8 of the range: both are far below 1e-8."""
    optimum = least_squares(DecayFit().residuals, [1.0, 1.0], DecayFit().jacobian, xtol=1e-12)
    record = minimize(method, Scaled(unit), seed=1)
    assert record.outcome is Outcome.CONVERGED
    assert record.loss == pytest.approx(np.mean(optimum.fun**2) * unit**2, rel=1e-8)


@pytest.mark.parametrize("wall", [np.inf, 1.2])
@pytest.mark.parametrize(
    ("method", "error"),
    [
        (LBFGSB(screen=50, starts=5, rounds=2), 1e-6),
        (NelderMead(screen=50, starts=5, rounds=2), 1e-12),
    ],
)
def test_rosenbrock_without_residuals_and_beside_a_wall(
    method: Optimizer, error: float, wall: float
) -> None:
    """Forward differences of 1e-8 leave 1e-6 of a loss that is 1 and more off the valley."""
    record = minimize(method, Rosenbrock(wall=wall), Budget(evaluations=30_000), seed=2)
    assert record.loss < error
    assert record.theta == pytest.approx(np.ones(3), abs=10 * np.sqrt(error))
    assert (record.rejected != {}) == np.isfinite(wall)


def test_the_first_simplex_lies_in_the_box() -> None:
    class Recorded(DecayFit):
        space = Space((Parameter("a", "V", 1.99, 2.01), Parameter("b", "1/s", 1.0, 3.0)))

    problem = Recorded()
    minimize(NelderMead(screen=1, starts=1, rounds=1, edge=0.5), problem)
    simplex = np.array(problem.thetas)[-50:]
    first = np.array(problem.thetas[1:4])  # after one of screening
    assert problem.space.contains(simplex).all()
    width = problem.space.high - problem.space.low
    assert np.abs(first[1:] - first[0]) == pytest.approx(np.diag(0.5 * width), abs=1e-12)


def test_settings_are_checked() -> None:
    for setting, message in (
        ({"memory": 0}, "memory is 0"),
        ({"tolerance": 0.0}, "tolerance is 0.0"),
        ({"rounds": 0}, "rounds is 0"),
    ):
        with pytest.raises(ValueError, match=message):
            LBFGSB(**setting)
    with pytest.raises(ValueError, match=r"edge is 0.7; expected at most half of the range"):
        NelderMead(edge=0.7)
