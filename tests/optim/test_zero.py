"""Systems of equations, whose data are 0: a loss of zero to rounding is certain to be the best."""

# mypy: disable-error-code="no-untyped-def"
import numpy as np
import pytest

import miho
from miho.optim import MIHOGN, Budget, Outcome, Parameter, Space, minimize, zero
from miho.optim.evidence import EPSILON, is_rounding
from miho.optim.zero import is_zero

SEEDS = range(5)
BY_AGREEMENT = 7
"""So many brackets at least are evidence by their ends alone (`miho.optim.evidence`)."""


def equations(i, *values):
    """The value of equation i, for each of the numbers i."""
    return sum(np.where(i == k, value, 0.0) for k, value in enumerate(values))


def rosenbrock(i, a, b):
    return equations(i, 10 * (b - a**2), 1 - a)


def powell_singular(i, a, b, c, d):
    """Both equations that are squares have no derivatives at the solution, which is 0."""
    squares = (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2
    return equations(i, a + 10 * b, 5**0.5 * (c - d), *squares)


def freudenstein_roth(i, a, b):
    """The other optimum has the sum of squares 48.98."""
    return equations(i, -13 + a + ((5 - b) * b - 2) * b, -29 + a + ((b + 1) * b - 14) * b)


SYSTEMS = {
    "rosenbrock": (rosenbrock, 2, dict.fromkeys("ab", (-10, 10))),
    "powell_singular": (powell_singular, 4, dict.fromkeys("abcd", (-10, 10))),
    "freudenstein_roth": (freudenstein_roth, 2, dict.fromkeys("ab", (-20, 20))),
}


def solved(name: str, seed: int) -> miho.Fit:
    function, rows, bounds = SYSTEMS[name]
    return miho.fit(function, np.arange(rows), np.zeros(rows), bounds, seed=seed)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_that_is_solved_is_certain_and_the_search_stops(name: str, seed: int) -> None:
    fit = solved(name, seed)
    assert fit.error < 1e-12
    assert fit._conclusion.certain
    assert "zero to rounding" in fit.optimum
    assert "in doubt" not in str(fit)
    assert fit.descents.settled
    assert fit.descents.finished < BY_AGREEMENT


def test_without_the_rule_the_search_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = solved("powell_singular", 0).problem
    run = minimize(MIHOGN(max_brackets=20), problem)
    assert run.outcome is Outcome.CONVERGED
    monkeypatch.setattr(zero, "is_zero", lambda *_: False)
    longer = minimize(MIHOGN(max_brackets=20), problem)
    assert longer.evaluations > 1.5 * run.evaluations


@pytest.mark.parametrize("offset", [1e-3, 1e-6, 1e-9])
def test_a_loss_that_is_small_but_not_zero_is_not_certain(offset: float) -> None:
    """A third equation that no parameters solve."""

    def unsolvable(i, a, b):
        return rosenbrock(i, a, b) + np.where(i == 2, offset, 0.0) + 0 * a

    fit = miho.fit(unsolvable, np.arange(3), np.zeros(3), dict.fromkeys("ab", (-10, 10)))
    assert fit.error == pytest.approx(offset / 3**0.5, rel=1e-3)
    assert not fit._conclusion.certain
    assert "zero" not in fit.optimum
    assert fit.descents.finished >= BY_AGREEMENT


def test_exact_data_are_certain_and_noise_of_1e_9_is_not() -> None:
    t = np.linspace(0, 3, 40)
    bounds = {"a": (0, 5), "b": (0, 10)}

    def decay(t, a, b):
        return a * np.exp(-b * t)

    exact = miho.fit(decay, t, decay(t, 2, 1.5), bounds)
    assert exact._conclusion.certain
    assert exact.descents.finished < BY_AGREEMENT
    noise = 1e-9 * np.random.default_rng(0).standard_normal(t.size)
    assert "zero to rounding" not in miho.fit(decay, t, decay(t, 2, 1.5) + noise, bounds).optimum


def test_an_offset_that_hides_the_data_is_no_measure_of_rounding() -> None:
    """Doubles near 1e9 are 1e-7 apart; without the decay the error is 3e-6."""
    t = np.linspace(0, 3, 40)

    def decay(t, c, a, b):
        return c + a * np.exp(-b * t)

    y = decay(t, 1e9, 1e-5, 1.5)
    problem = miho.fit(decay, t, y, start={"c": float(y.mean()), "a": 0.0, "b": 1.0}).problem
    flat = float(np.var(y))
    assert flat < problem.rounding, "or this tests nothing"
    assert not is_rounding(flat, problem.rounding, problem.resolution)
    assert is_rounding(0.0, problem.rounding, problem.resolution)
    without = miho.fit(decay, t, y - 1e9, start={"c": 0.0, "a": 0.0, "b": 1.0}).problem
    assert is_rounding(without.rounding, without.rounding, without.resolution)
    assert not is_rounding(flat, without.rounding, without.resolution)


def test_what_counts_as_zero_is_what_rounded_parameters_change() -> None:
    """Ten roundings of the larger bound of each coordinate, times the derivatives."""
    space = Space((Parameter("a", "-", -1.0, 4.0), Parameter("b", "-", 0.0, 3.0)))
    x, r = np.array([0.5, 0.5]), np.array([1.0, -1.0, 1.0])
    limit = 10 * EPSILON * 4
    only_a = np.tile([1.0, 0.0], (3, 1))
    assert is_zero(0.99 * limit * r, only_a, x, space)
    assert not is_zero(1.01 * limit * r, only_a, x, space)
    assert is_zero(1.74 * limit * r, np.ones((3, 2)), x, space), "7 / 4 times as large"
    assert is_zero(0 * r, 0 * only_a, x, space)
    assert not is_zero(1e-100 * r, 0 * only_a, x, space)
    assert not is_zero(1e-100 * r, np.full((3, 2), np.nan), x, space)
    assert not is_zero(0.99 * limit * r, only_a, np.array([1e-11, 0.5]), space), "none cancel"
    large_in_one_row = only_a * np.array([[1.0], [1e20], [1.0]])
    assert not is_zero(1.01 * limit * r, large_in_one_row, x, space), "one of three"
    logarithmic = Space((Parameter("a", "-", np.exp(-4), 1.0, scale="log"), space.parameters[1]))
    assert is_zero(0.99 * limit * r, only_a, np.array([-2.0, 0.5]), logarithmic)
    assert not is_zero(1.01 * limit * r, only_a, np.array([-2.0, 0.5]), logarithmic)


def beale(i, a, b):
    return equations(i, 1.5 - a * (1 - b), 2.25 - a * (1 - b**2), 2.625 - a * (1 - b**3))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("width", [1e3, 1e5, 1e7])
def test_large_derivatives_where_nothing_is_solved_are_no_excuse(width: float, seed: int) -> None:
    """Beale's function has stationary points at a = 0 of any b, with b^3 as derivative."""
    bounds = dict.fromkeys("ab", (-width, width))
    fit = miho.fit(beale, np.arange(3), np.zeros(3), bounds, seed=seed)
    assert ("zero to rounding" in fit.optimum) == (fit.error < 1e-6)


def test_a_run_that_is_cut_off_anywhere_and_goes_on_is_the_same() -> None:
    """Also where the budget ends before the look that shows a zero."""
    problem = solved("powell_singular", 0).problem
    whole = minimize(MIHOGN(), problem)
    # The look is among the last evaluations before the polish.
    for evaluations in range(1, int(whole.evaluations) + 1, 3):
        part = minimize(MIHOGN(), problem, Budget(evaluations=evaluations))
        rest = minimize(MIHOGN(), problem, checkpoint=part.checkpoint)
        assert (rest.evaluations, rest.loss) == (whole.evaluations, whole.loss)
        assert rest.descents == whole.descents
