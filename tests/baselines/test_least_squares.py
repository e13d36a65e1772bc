"""Levenberg-Marquardt in a box, and parameters that the data do not see."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from miho import Budget, LeastSquaresProblem, Optimizer, Oracle, Parameter, Space, minimize
from miho.methods.descent import METHODS, descend
from miho.methods.least_squares import LeastSquares
from miho.methods.local_search import LBFGSB, NelderMead
from miho.methods.variable_projection import VariableProjection
from miho.optim import BudgetExhausted, Clock, Outcome, RandomSearch
from miho.optim.problem import mean_square
from miho.quantities import Array
from miho.testing import DecayFit
from tests.baselines.test_variable_projection import Narrow, separable
from tests.identification.published import misra1a


class Blind(LeastSquaresProblem):
    """`DecayFit` with a parameter of no effect before and one after, where c > 2."""

    name = "blind"
    space = Space(
        (
            Parameter("none", "-", 0.0, 1.0),
            *DecayFit.space.parameters,
            Parameter("c", "-", 0.0, 4.0),
        )
    )

    def __init__(self) -> None:
        self.inner = DecayFit()
        self.looks = 0

    def residuals(self, theta: Array) -> Array:
        self.looks += 1
        return self.inner.residuals(theta[1:3]) + max(0.0, theta[3] - 2.0)

    def jacobian(self, theta: Array) -> Array:
        offset = np.full((17, 1), float(theta[3] > 2.0))
        return np.hstack([np.zeros((17, 1)), self.inner.jacobian(theta[1:3]), offset])

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return np.array([mean_square(self.residuals(theta)) for theta in thetas])


class OnePoint(DecayFit):
    """Fewer residuals than parameters: y = a exp(-b t) through one point."""

    name = "one point"

    def __init__(self) -> None:
        super().__init__()
        self.t, self.y = self.t[3:4], self.y[3:4]


def test_solvers_agree_on_one_optimum() -> None:
    """Four ways to one certified minimum: losses to 1e-8, and so parameters to its root, 1e-4."""
    records = [
        minimize(method, separable(), Budget(evaluations=100_000), seed=1)
        for method in (
            LeastSquares(screen=50, starts=3, rounds=1),
            LeastSquares(screen=50, starts=3, rounds=1, method="lm"),
            VariableProjection(screen=50, starts=3, rounds=1, method="lm"),
            LBFGSB(screen=50, starts=3, rounds=1, tolerance=1e-14),
        )
    ]
    for record in records:
        assert record.outcome is Outcome.CONVERGED
        assert record.loss * 14 == pytest.approx(1.2455138894e-1, rel=1e-8)
        assert record.theta == pytest.approx([2.3894212918e2, 5.5015643181e-4], rel=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_a_solution_on_a_bound_is_found(method: str) -> None:
    """The best amplitude is outside; the bound's own optimum is that of the reduced problem.

    Towards a bound the transformation's slope vanishes: what is missing is 1e-6 of the loss.
    """
    b = np.linspace(0.5, 1.5, 200_001)
    problem = Narrow()
    decay = np.exp(-b[:, None] * problem.t)
    best = np.min(np.mean((1.5 * decay - problem.y) ** 2, axis=1))
    record = minimize(LeastSquares(screen=50, starts=3, rounds=1, method=method), problem)
    assert record.loss == pytest.approx(best, rel=1e-6)
    assert problem.space.contains(np.array(problem.thetas)).all()


def test_levenberg_marquardt_takes_fewer_residuals_than_parameters() -> None:
    record = minimize(LeastSquares(screen=20, starts=2, rounds=1, method="lm"), OnePoint())
    assert record.outcome is Outcome.CONVERGED
    assert record.loss < 1e-20


@pytest.mark.parametrize("method", METHODS)
def test_parameters_without_effect_do_not_hold_a_descent_up(method: str) -> None:
    problem = Blind()
    start = np.array([0.3, 1.0, 1.0, 1.0])
    descend(problem.residuals, problem.jacobian, start, problem.space, 1e-10, method)
    free = DecayFit()
    descend(free.residuals, free.jacobian, start[1:3], free.space, 1e-10, "trf")
    assert min(problem.inner.losses) == pytest.approx(min(free.losses), rel=1e-9)
    assert problem.looks <= 20
    thetas = np.array(problem.inner.thetas)
    assert problem.space.contains(np.insert(thetas, [0, 2], 0.5, axis=1)).all()


def test_a_parameter_that_matters_later_is_moved_then() -> None:
    class Later(Blind):
        """c shifts the residuals by c - 2 wherever the amplitude is above 1.5."""

        def residuals(self, theta: Array) -> Array:
            self.looks += 1
            shift = theta[3] - 2.0 if theta[1] > 1.5 else -0.5
            return self.inner.residuals(theta[1:3]) + shift

        def jacobian(self, theta: Array) -> Array:
            jacobian = super().jacobian(theta)
            jacobian[:, 3] = float(theta[1] > 1.5)
            return jacobian

    problem = Later()
    losses: list[float] = []

    def residuals(theta: Array) -> Array:
        values = problem.residuals(theta)
        losses.append(float(mean_square(values)))
        return values

    start = np.array([0.3, 1.0, 1.0, 1.5])
    descend(residuals, problem.jacobian, start, problem.space, 1e-10, "trf")
    free = least_squares(
        lambda q: problem.inner.residuals(q[:2]) + q[2],
        [1.0, 1.0, 0.0],
        lambda q: np.hstack([problem.inner.jacobian(q[:2]), np.ones((17, 1))]),
        xtol=1e-12,
    )
    assert min(losses) == pytest.approx(np.mean(free.fun**2), rel=1e-8)


def test_settings_are_checked() -> None:
    for method in (LeastSquares, VariableProjection):
        with pytest.raises(ValueError, match="method is 'dogbox'; expected one of trf, lm"):
            method(method="dogbox")
        with pytest.raises(ValueError, match="tolerance is 1e-17; expected a number of at least"):
            method(tolerance=1e-17)
        with pytest.raises(ValueError, match="rounds is 0"):
            method(rounds=0)


def test_without_rounds_it_goes_on_until_the_budget_ends() -> None:
    method = LeastSquares(screen=20, starts=1, rounds=None)
    record = minimize(method, misra1a(), Budget(evaluations=2000))
    assert record.outcome is Outcome.BUDGET
    assert record.evaluations > 1900


def test_a_run_says_where_its_descents_ended() -> None:
    method = LeastSquares(screen=50, starts=4, rounds=2)
    whole = minimize(method, misra1a()).descents
    assert whole is not None
    assert (whole.started, whole.finished, whole.converged, whole.stayed) == (8, 8, 8, 0)
    assert whole.ends == pytest.approx([1.2455138894e-1 / 14] * 8, rel=1e-6)
    cut = minimize(method, misra1a(), Budget(evaluations=70)).descents
    assert cut is not None
    assert cut.started == cut.finished + 1
    assert minimize(RandomSearch(), misra1a(), Budget(evaluations=70)).descents is None


@pytest.mark.parametrize("method", [LeastSquares(), NelderMead(), LBFGSB(), VariableProjection()])
def test_a_small_budget_is_not_spent_on_screening(method: Optimizer) -> None:
    descents = minimize(method, misra1a(), Budget(evaluations=200)).descents
    assert descents is not None
    assert descents.started >= 1
    if isinstance(method, LeastSquares | VariableProjection):
        assert descents.finished >= 1


def test_screening_takes_a_fifth_of_the_seconds() -> None:
    """A model of 0.2 s an evaluation and 10 s: ten configurations are screened, not 500."""
    seconds = [0.0]

    class Slow(DecayFit):
        def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
            seconds[0] += 0.2 * len(thetas)
            return super().loss(thetas, fidelity)

        def residuals(self, theta: Array) -> Array:
            seconds[0] += 0.2
            return super().residuals(theta)

    oracle = Oracle(
        Slow(), Budget(seconds=10.0), clock=Clock(lambda: seconds[0], lambda: seconds[0])
    )
    with pytest.raises(BudgetExhausted):
        LeastSquares().run(oracle, np.random.default_rng(0))
    assert oracle.meter.starts.descents[0].finished
    thetas = oracle.space.decode(oracle.space.initial(11))
    screened = oracle.meter.starts.descents[0].start
    assert screened == DecayFit().loss(thetas).min(), "of the first screened, the best"


def test_screening_is_whole_within_an_ample_budget() -> None:
    """The same numbers in one batch and, with a limit in seconds, in several."""
    traces = [
        minimize(LeastSquares(rounds=1), misra1a(), budget, seed=3).trace.loss
        for budget in (Budget(), Budget(evaluations=40_000, seconds=1e6))
    ]
    assert traces[0] == traces[1]
