"""The oracle: residuals and derivatives, and what they cost."""

import math
from contextlib import nullcontext

import numpy as np
import pytest
from numpy.typing import NDArray

from miho import Budget, LeastSquaresProblem, Oracle, Parameter, Problem, Space
from miho.optim import BudgetExhausted, UnusableValueError
from miho.optim.meter import RunInterrupted

Array = NDArray[np.float64]
SPACE = Space((Parameter("x", "m", -10.0, 10.0),))


class Line(LeastSquaresProblem):
    """Residuals of y = x t at t = 1, 2."""

    name = "line"
    space = SPACE
    jacobian_cost = 3

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return 2.5 * thetas[:, 0] ** 2

    def residuals(self, theta: Array) -> Array:
        return theta[0] * np.array([1.0, 2.0])

    def jacobian(self, theta: Array) -> Array:
        return np.array([[1.0], [2.0]])


def test_residuals_and_jacobians_are_paid_for() -> None:
    oracle = Oracle(Line(), Budget(evaluations=6))
    oracle.residuals(np.array([2.0]))
    assert oracle.evaluations == 1
    assert oracle.best == 10.0
    oracle.jacobian(np.array([2.0]))
    assert oracle.evaluations == 4
    with pytest.raises(BudgetExhausted):
        oracle.jacobian(np.array([2.0]))
    assert oracle.evaluations == 4


def test_derivatives_that_an_interrupt_cuts_short_are_not_paid_for() -> None:
    class Interrupted(Line):
        def jacobian(self, theta: Array) -> Array:
            raise RunInterrupted

    oracle = Oracle(Interrupted(), Budget(evaluations=6))
    with pytest.raises(RunInterrupted):
        oracle.jacobian(np.array([2.0]))
    assert oracle.evaluations == 0


class Broken(Line):
    """Residuals and derivatives that cannot be used."""

    def residuals(self, theta: Array) -> Array:
        raise ArithmeticError("no residuals")

    def jacobian(self, theta: Array) -> Array:
        return np.array([[np.nan], [1.0]])


def test_unusable_residuals_and_derivatives_are_counted() -> None:
    oracle = Oracle(Broken(), Budget())
    with pytest.raises(UnusableValueError, match="no residuals"):
        oracle.residuals(np.array([2.0]))
    with pytest.raises(UnusableValueError, match="not finite"):
        oracle.jacobian(np.array([2.0]))
    assert oracle.evaluations == 4
    assert oracle.meter.rejected == {
        "ArithmeticError: no residuals; first at x = 2": 1,
        "derivative is not finite": 1,
    }


class Partly(Line):
    """Counts configurations, and raises where x is above 1."""

    count = 0

    def residuals(self, theta: Array) -> Array:
        self.count += 1
        if theta[0] > 1:
            raise ZeroDivisionError("above 1")
        return super().residuals(theta)


class InBatches(Partly):
    """Raises in any batch that holds such a row."""

    def residual_rows(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return np.stack([self.residuals(theta) for theta in thetas])


@pytest.mark.parametrize(("bad", "budget"), [((), 7), ((2, 3), 7), ((0,), 20), (range(9), 9)])
def test_residuals_of_several_are_those_of_each_and_counted_alike(
    bad: tuple[int, ...], budget: int
) -> None:
    thetas = np.linspace(-1, 0.9, 9)[:, None]
    thetas[list(bad), 0] = 2.0
    problem, limit = InBatches(), Budget(evaluations=budget)
    together, alone = Oracle(problem, limit), Oracle(problem, limit)
    rows: list[Array] = []
    with pytest.raises(BudgetExhausted) if budget < 9 else nullcontext():
        while len(rows) < len(thetas):
            rows += list(together.residual_rows(thetas[len(rows) :]))
    assert len(rows) == min(budget, 9)
    for theta, row in zip(thetas, rows, strict=False):
        try:
            expected = alone.residuals(theta)
        except UnusableValueError:
            assert np.isnan(row).all()
        else:
            assert np.array_equal(row, expected)
    assert together.meter.evaluations == alone.meter.evaluations == len(rows)
    assert together.meter.rejected == alone.meter.rejected
    assert together.trace.loss == alone.trace.loss
    assert together.trace.evaluations == alone.trace.evaluations


def test_no_configuration_is_evaluated_twice_where_there_are_no_batches() -> None:
    problem, thetas = Partly(), np.array([[0.5], [2.0], [0.1]])
    oracle = Oracle(problem, Budget())
    rows: list[Array] = []
    while len(rows) < len(thetas):
        rows += list(oracle.residual_rows(thetas[len(rows) :]))
    assert problem.count == oracle.meter.evaluations == 3
    assert oracle.meter.rejected == {"ZeroDivisionError: above 1; first at x = 2": 1}


class OfOtherShape(Line):
    """Residuals (2, 2) where x is above 1."""

    def residuals(self, theta: Array) -> Array:
        return np.ones((2, 2)) if theta[0] > 1 else super().residuals(theta)


def test_residuals_of_another_shape_are_unusable_as_if_the_problem_raised() -> None:
    oracle = Oracle(OfOtherShape(), Budget())
    assert np.isnan(oracle.residual_rows(np.array([[2.0]]))).all()
    assert oracle.meter.evaluations == sum(oracle.meter.rejected.values()) == 1
    assert oracle.best == math.inf


class LossOnly(Problem):
    """Gives no residuals."""

    name = "loss only"
    space = SPACE

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return np.asarray(np.abs(thetas[:, 0]))


def test_a_problem_without_residuals_says_so() -> None:
    with pytest.raises(TypeError, match=r"has no residuals; .* \(optimizer=miho_qn\)"):
        Oracle(LossOnly(), Budget()).residuals(np.array([1.0]))
