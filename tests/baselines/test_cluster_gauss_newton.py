"""The cluster Gauss-Newton method: its linear models, its steps, and what it finds."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from miho import Budget, LeastSquaresProblem, Oracle, Parameter, Space, minimize
from miho.methods.cluster_gauss_newton import ClusterGaussNewton, cluster_steps, within
from miho.methods.unit_box import UnitBox
from miho.optim import Outcome
from miho.optim.problem import mean_square
from miho.quantities import Array
from miho.testing import DecayFit
from tests.identification.published import misra1a


class FlipFlop(LeastSquaresProblem):
    """Absorption and clearance of a drug, of which data cannot tell which is the faster.

    The example of the authors' R package, CGNM, with its nine observations (its vignette).
    """

    name = "flip-flop"
    space = Space(tuple(Parameter(n, "-", 0.01, 100.0, scale="log") for n in ("ka", "V", "CL")))
    t = np.array([0.1, 0.2, 0.4, 0.6, 1, 2, 3, 6, 12])
    observed = np.array([4.91, 8.65, 12.4, 18.7, 24.3, 24.5, 18.4, 4.66, 0.238])

    def __init__(self) -> None:
        self.thetas: list[Array] = []
        self.losses: list[float] = []

    def residuals(self, theta: Array) -> Array:
        ka, V, CL = theta
        amount = ka * 1000 / (V * (ka - CL / V))
        with np.errstate(divide="ignore", invalid="ignore"):
            C = amount * (np.exp(-CL / V * self.t) - np.exp(-ka * self.t))
            residuals = np.log10(C) - np.log10(self.observed)
        self.thetas.append(theta.copy())
        self.losses.append(float(mean_square(residuals)))
        return np.asarray(residuals)

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return np.array([mean_square(self.residuals(theta)) for theta in thetas])

    def jacobian(self, theta: Array) -> Array:
        raise AssertionError("no derivatives are needed")


def test_it_finds_both_solutions_of_its_authors_example() -> None:
    """One has the absorption rate where the other has the elimination rate, CL / V."""
    problem = FlipFlop()
    record = minimize(ClusterGaussNewton(), problem, seed=1)
    assert record.outcome is Outcome.CONVERGED
    local = least_squares(lambda z: problem.residuals(np.exp(z)), np.log([1.0, 15.0, 7.0]))
    optimum = float(np.mean(local.fun**2))
    assert record.loss == pytest.approx(optimum, rel=1e-6)
    losses = np.array(problem.losses)
    ka, V, CL = np.array(problem.thetas)[losses < optimum * (1 + 1e-6)].T
    rates = np.stack([ka, CL / V])
    faster, slower = np.max(rates, axis=0), np.min(rates, axis=0)
    assert faster / slower == pytest.approx(faster[0] / slower[0], rel=0.01)
    assert set(np.sign(ka - CL / V)) == {-1.0, 1.0}


def test_it_finds_a_certified_minimum() -> None:
    record = minimize(ClusterGaussNewton(), misra1a(), Budget(evaluations=7000), seed=1)
    assert record.loss * 14 == pytest.approx(1.2455138894e-1, rel=1e-8)


@pytest.mark.parametrize("rows", [4, 30])
@pytest.mark.parametrize("damping", [1e-12, 3.0])
def test_steps_on_linear_residuals_are_tikhonovs(rows: int, damping: float) -> None:
    """Whatever the weights: (A^T A + lambda I) s = -A^T r, with residuals few and many."""
    rng = np.random.default_rng(1)
    A, b, X = rng.normal(size=(rows, 3)), rng.normal(size=rows), rng.random((12, 3))
    Y = X @ A.T - b
    moving = np.array([0, 5, 11])
    steps = cluster_steps(X, Y, np.full(12, damping), 2.0, moving)
    for i, step in zip(moving, steps, strict=True):
        expected = np.linalg.solve(A.T @ A + damping * np.eye(3), -A.T @ Y[i])
        np.testing.assert_allclose(step, expected, rtol=1e-7)


@pytest.mark.parametrize("rows", [4, 30])
def test_models_are_weighted_by_distance(rows: int) -> None:
    """Against the publication's formula, point by point."""
    rng = np.random.default_rng(2)
    X, gamma, damping = rng.random((9, 2)), 1.5, np.linspace(0.1, 2, 9)
    frequencies, phases = rng.normal(size=(2, rows)) * 3, rng.random(rows)
    Y = np.sin(X @ frequencies + phases)
    steps = cluster_steps(X, Y, damping, gamma, np.arange(9))
    for i in range(9):
        others = [j for j in range(9) if j != i]
        dX, dY = X[others] - X[i], Y[others] - Y[i]
        weight = (1 / np.sum(dX**2, axis=1)) ** gamma
        A = np.linalg.lstsq(weight[:, None] * dX, weight[:, None] * dY)[0].T
        expected = np.linalg.solve(A.T @ A + damping[i] * np.eye(2), -A.T @ Y[i])
        np.testing.assert_allclose(steps[i], expected, rtol=1e-8)


@pytest.mark.parametrize("unit", [1e-150, 1e150])
def test_the_unit_of_the_residuals_changes_no_step(unit: float) -> None:
    rng = np.random.default_rng(3)
    X, Y, damping = rng.random((8, 2)), rng.normal(size=(8, 20)), rng.random(8)
    steps = cluster_steps(X, Y, damping, 2.0, np.arange(8))
    scaled = cluster_steps(X, Y * unit, damping * unit * unit, 2.0, np.arange(8))
    np.testing.assert_allclose(scaled, steps, rtol=1e-9)


def test_points_on_one_another_have_no_weight() -> None:
    X = np.array([[0.1, 0.2], [0.1, 0.2], [0.5, 0.3], [0.2, 0.8]])
    Y = np.hstack([X, X.sum(axis=1, keepdims=True)])
    steps = cluster_steps(X, Y, np.full(4, 1e-12), 2.0, np.arange(4))
    np.testing.assert_allclose(steps, -X, atol=1e-9)
    collapsed = cluster_steps(X[[0, 0]], Y[[0, 0]], np.zeros(2), 2.0, np.arange(2))
    assert collapsed.tolist() == [[0.0, 0.0], [0.0, 0.0]]


def test_steps_across_a_bound_go_half_way_to_it() -> None:
    x, step = np.array([0.2, 0.2, 0.9, 1.0, 0.0]), np.array([-0.1, -0.3, 5.0, 1.0, 0.4])
    np.testing.assert_allclose(within(x, step), [-0.1, -0.1, 0.05, 0.0, 0.4])


def test_damping_follows_success_and_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tenth of it after a step that helped, ten times after one that did not, until all rest."""
    dampings: list[Array] = []
    goal = UnitBox(DecayFit.space).x(np.array([2.0, 1.5]))

    def steps(X: Array, Y: Array, damping: Array, gamma: float, moving: Array) -> Array:
        dampings.append(damping.copy())
        helps = (np.arange(len(moving)) == 0) & (len(dampings) == 1)
        return np.where(helps[:, None], goal - X[moving], np.nan)

    monkeypatch.setattr("miho.methods.cluster_gauss_newton.cluster_steps", steps)
    problem = DecayFit()
    oracle = Oracle(problem, Budget())
    ClusterGaussNewton(N=4, iterations=25, damping=2.0).run(oracle, np.random.default_rng(1))
    assert len(dampings) == 12, "the one that was helped rests two iterations after the others"
    first = 2.0 * 17 * np.median(problem.losses[:4])
    for k, damping in enumerate(dampings):
        np.testing.assert_allclose(damping[0], first * 10.0 ** (k - 2 * (k > 0)))
        np.testing.assert_allclose(damping[1:], first * 10.0 ** min(k, 10))


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="N is 1"):
        ClusterGaussNewton(N=1)
    with pytest.raises(ValueError, match="damping is 0"):
        ClusterGaussNewton(damping=0.0)
