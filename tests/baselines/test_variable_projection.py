"""Variable projection: a published optimum, exact gradients, and the linear part alone."""

import numpy as np
import pytest
from scipy.optimize import nnls

from miho import Budget, CurveFit, Oracle, Parameter, Space, minimize
from miho.methods.least_squares import LeastSquares
from miho.methods.variable_projection import VariableProjection, _Reduced
from miho.optim import Outcome
from miho.optim.linear_part import solve_linear_part
from miho.testing import DecayFit
from tests.identification.published import Misra1a, line, misra1a


class SeparableMisra1a(Misra1a):
    linear = ("b1",)


def separable() -> CurveFit:
    """NIST StRD, Misra1a, with its linear parameter declared."""
    published = misra1a()
    return CurveFit(SeparableMisra1a(), published.dataset, published.space)


def test_it_reaches_a_certified_optimum() -> None:
    """NIST certifies 11 digits; both residual sums have rounding in their twelfth."""
    record = minimize(VariableProjection(screen=50, starts=3, rounds=1), separable(), seed=1)
    assert record.outcome is Outcome.CONVERGED
    assert record.theta == pytest.approx([2.3894212918e2, 5.5015643181e-4], rel=1e-8)
    assert record.loss * 14 == pytest.approx(1.2455138894e-1, rel=1e-10)


def test_its_starts_are_those_of_least_squares() -> None:
    records = [
        minimize(method(screen=60, starts=2, rounds=2), DecayFit(), seed=3)
        for method in (LeastSquares, VariableProjection)
    ]
    assert records[0].loss == pytest.approx(records[1].loss, rel=1e-9)
    first = [record.trace.theta[0].tolist() for record in records]
    assert first[0] == first[1]


def reduced_loss(problem: DecayFit, b: float) -> float:
    """By the formula: the best amplitude is a projection, cut at the box."""
    decay = np.exp(-b * problem.t)
    a = np.clip(decay @ problem.y / (decay @ decay), problem.space.low[0], problem.space.high[0])
    return float(np.sum((a * decay - problem.y) ** 2))


class Narrow(DecayFit):
    """The best amplitude, about 2, is outside the box."""

    space = Space((Parameter("a", "V", -5.0, 1.5), DecayFit.space.parameters[1]))


@pytest.mark.parametrize("problem", [DecayFit(), Narrow()])
@pytest.mark.parametrize("b", [0.3, 1.0, 4.0])
def test_residuals_and_gradient_are_those_of_the_reduced_problem(
    problem: DecayFit, b: float
) -> None:
    """Kaufman's derivatives are not the residuals', but give the exact gradient of their squares.

    Differences of a step of 1e-6 leave 1e-9 of the loss.
    """
    reduced = _Reduced(Oracle(problem, Budget()), [0], [1], np.array([0.1, 9.0]))
    residuals = reduced.residuals(np.array([b]))
    jacobian = reduced.jacobian(np.array([b]))
    assert residuals @ residuals == pytest.approx(reduced_loss(problem, b), rel=1e-12)
    slope = (reduced_loss(problem, b + 1e-6) - reduced_loss(problem, b - 1e-6)) / 2e-6
    assert 2 * jacobian[:, 0] @ residuals == pytest.approx(slope, rel=1e-6, abs=1e-8)


def test_derivatives_are_those_of_the_place_asked_for() -> None:
    reduced = _Reduced(Oracle(DecayFit(), Budget()), [0], [1], np.array([0.1, 9.0]))
    reduced.residuals(np.array([1.0]))
    derivatives = reduced.jacobian(np.array([1.0]))
    reduced.residuals(np.array([3.0]))
    assert reduced.jacobian(np.array([1.0])) == pytest.approx(derivatives, rel=1e-9, abs=1e-12)


def test_a_linear_problem_is_one_solve() -> None:
    x = np.linspace(0, 3, 30)
    y = 2 - 0.5 * x + 0.1 * np.cos(9 * x)
    record = minimize(VariableProjection(), line(y, x), Budget(evaluations=10))
    assert record.outcome is Outcome.CONVERGED
    assert record.evaluations == 5  # at the start, two steps, the solution, and the refined one
    assert record.theta == pytest.approx(np.polyfit(x, y, 1)[::-1], rel=1e-12)


def test_without_linear_parameters_it_is_least_squares() -> None:
    projected = minimize(VariableProjection(rounds=1), misra1a()).trace
    unprojected = minimize(LeastSquares(rounds=1), misra1a()).trace
    assert (projected.evaluations, projected.loss) == (unprojected.evaluations, unprojected.loss)


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="screen is 0"):
        VariableProjection(screen=0)


def test_bounds_hold_as_in_nonnegative_least_squares() -> None:
    """Lawson and Hanson's algorithm, which is another than the one in use."""
    rng = np.random.default_rng(4)
    space = Space(tuple(Parameter(f"c{k}", "-", 0, 1e3) for k in range(6)))
    for _ in range(20):
        basis = rng.standard_normal((40, 6)) * 10.0 ** rng.integers(-3, 3, 6)
        data = rng.standard_normal(40)
        part = solve_linear_part(
            lambda c, A=basis, y=data: A @ c - y, rng.uniform(0, 1e3, 6), range(6), space
        )
        expected = nnls(basis, data)[0]
        if (expected > 1e3).any():
            continue
        assert part is not None
        assert part.theta == pytest.approx(expected, rel=1e-8, abs=1e-8)
        assert part.basis.shape == (40, np.count_nonzero(expected))


def test_a_column_of_zeros_does_not_matter() -> None:
    x = np.linspace(0, 1, 9)
    space = Space((Parameter("a", "-", -1, 1), Parameter("b", "-", 1, 2)))
    part = solve_linear_part(
        lambda c: c[0] * x + 0 * c[1] - 0.5 * x, np.array([1.0, 2.0]), [0, 1], space
    )
    assert part is not None
    assert part.theta[0] == pytest.approx(0.5, rel=1e-12)
    assert 1 <= part.theta[1] <= 2


def test_residuals_that_are_not_finite_have_no_linear_part() -> None:
    space = DecayFit.space
    assert solve_linear_part(lambda c: c * np.nan, space.low, [0], space) is None


def test_a_linear_part_of_any_size_is_solved() -> None:
    """The squares of a column of 1e160 are no numbers; the best factor is 3e-160."""
    x = np.linspace(0.5, 1, 9)
    space = Space((Parameter("a", "-", 0, 1e-140),))
    part = solve_linear_part(lambda c: c[0] * 1e160 * x - 3 * x, np.array([0.0]), [0], space)
    assert part is not None
    assert part.theta[0] == pytest.approx(3e-160, rel=1e-12)
