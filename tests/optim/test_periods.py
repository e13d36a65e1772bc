"""Searches for a period: draws and scans that are uniform in the number of periods."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import miho
from experiments.check.families import FAMILIES, drawn
from miho import MIHOGN, Budget, CurveFit, minimize
from miho.compiled.gauss_newton_candidates import Minima
from miho.optim import BudgetExhausted, Outcome, Space
from miho.optim.challenges import _solution, solve_linear, spectrum
from miho.optim.credibility import prepare_challenge
from miho.optim.oracle import Oracle
from miho.optim.periods import Period, periods_of
from miho.quantities import Array
from miho.vehicle.models import PacejkaCurvature

X = np.linspace(0, 60, 120)
BOX = [(-5.0, 5.0), (0.0, 5.0), (1.0, 100.0), (0.0, 2 * np.pi)]


def wave(x: Any, c: Any, a: Any, T: Any, p: Any) -> Any:
    return c + a * np.cos(2 * np.pi * x / T - p)


def pair(x: Any, c: Any, a: Any, b: Any, f: Any) -> Any:
    return c + a * np.sin(2 * np.pi * f * x) + b * np.cos(2 * np.pi * f * x)


def peak(x: Any, c: Any, a: Any, m: Any, w: Any) -> Any:
    return c + a * np.exp(-(((x - m) / w) ** 2))


def problem_of(formula: Any, true: list[float], x: Array = X, noise: float = 1.0) -> CurveFit:
    box = [*BOX[:1], (-5.0, 5.0), (-5.0, 5.0), (0.02, 1.0)] if formula is pair else BOX
    return drawn(formula, [x], true, noise, box, np.random.default_rng(7))


def by_numbers(x: Any, c: Any, a: Any, T: Any, p: Any) -> Any:
    """The same, which needs numbers."""
    return np.array([c + a * np.cos(2 * np.pi * v / float(T) - p) for v in x])


def periods(problem: CurveFit) -> dict[int, Period]:
    nonlinear = [k for k, n in enumerate(problem.space.names) if n not in problem.linear]
    return periods_of(Oracle(problem, Budget()), problem.space, np.array(nonlinear))


def test_a_period_is_counted_over_its_range() -> None:
    found = periods(problem_of(wave, [1, 1, 5, 1]))
    assert list(found) == [2]
    period = found[2]
    assert period.passed[-1] == pytest.approx(60 / 1 - 60 / 100)
    T = 1 + 99 * period.at(np.linspace(0, 1, 31))
    # A step of GRID is a fifth of the smallest T; over it, 1 / T is not linear.
    assert np.diff(60 / T) == pytest.approx(-59.4 / 30, rel=0.2)
    assert list(period.phases) == [3]
    best = np.array([[0.5, 0.2, 0.1, 0.25]])
    turned = np.concatenate([period.turned(best, turn) for turn in period.turns])
    assert turned[:, 3] == pytest.approx([0.25, 0.25 + 1 / 3, 0.25 + 2 / 3])
    assert (turned[:, :3] == best[:, :3]).all()


def test_a_frequency_needs_no_phase_and_a_peak_has_no_period() -> None:
    period = periods(problem_of(pair, [1, 1, 1, 0.3]))[3]
    assert period.turns == (0.0,)
    assert period.at(np.array([0.5])) == pytest.approx([0.5])
    assert periods(problem_of(peak, [1, 1, 20, 3])) == {}


@pytest.mark.parametrize("name", FAMILIES)
def test_families_with_a_period_have_one(name: str) -> None:
    problem, _ = FAMILIES[name].problem(np.random.default_rng(1))
    with_period = FAMILIES[name].kind in ("periods", "many minima", "wide periods")
    assert bool(periods(problem)) == with_period


FREE = dict(zip(("c", "a", "T", "p"), BOX, strict=True))
Y = wave(X, 1, 1, 20, 1) + 0.1 * np.random.default_rng(3).standard_normal(X.size)


@pytest.mark.parametrize(
    ("model", "space", "settings", "expected"),
    [
        (wave, FREE, {}, ["T"]),
        (wave, {**FREE, "T": (19, 21)}, {}, []),
        (wave, {n: b for n, b in FREE.items() if n != "T"}, {"fixed": {"T": 20.0}}, []),
        (by_numbers, FREE, {}, []),
        (wave, {**{n: b for n, b in FREE.items() if n != "T"}, "f": (0.01, 1)},
         {"tied": {"T": "1 / f"}}, ["f"]),
    ],
    ids=["free", "less than a period", "fixed", "no formula", "tied"],
)  # fmt: skip
def test_periods_of_a_fit(model: Any, space: Any, settings: Any, expected: list[str]) -> None:
    fit = miho.fit(model, X, Y, space, budget=Budget(evaluations=50), **settings)
    assert [fit.problem.space.names[k] for k in periods(fit.problem)] == expected


@pytest.mark.parametrize("fixed", [{}, {"T": 20.0}])
def test_a_part_of_a_joint_fit_has_a_period(fixed: dict[str, float]) -> None:
    bounds = {name: ends for name, ends in {**FREE, "b": (0.0, 9.0)}.items() if name not in fixed}
    parts = {"wave": (wave, X, Y), "line": (lambda x, b: b * x, X, 3 * X + Y)}
    for constraints in ((), "c < b"):
        budget = Budget(evaluations=50)
        fit = miho.fit_joint(parts, bounds, fixed=fixed, budget=budget, constraints=constraints)
        assert bool(periods(fit.problem)) == (not fixed)


def test_the_sine_of_the_magic_formula_is_no_period() -> None:
    alpha = np.linspace(-0.3, 0.3, 60)
    force = PacejkaCurvature().predict(np.array([[10, 1.5, 1, -0.5, 0, 0]]), alpha)[0]
    wide = {"B": (1, 1e3), "C": (0.1, 20), "D": (0.1, 3), "E": (-9, 1)}
    fit = miho.fit(PacejkaCurvature(), alpha, force, wide, fixed={"Sx": 0, "Sy": 0})
    assert not periods(fit.problem)


@pytest.mark.parametrize("formula", [wave, pair])
def test_a_spectrum_finds_the_period_that_a_search_has_missed(formula: Any) -> None:
    true = [1.0, 1.5, 1.7, 2.0] if formula is wave else [1.0, 1.2, -0.9, 1 / 1.7]
    problem = problem_of(formula, true)
    oracle = Oracle(problem, Budget())
    state = MIHOGN().start(oracle, np.random.default_rng(0))
    state.periods.update(periods(problem))
    wrong = np.array([0.6, 0.1, 0.4, 0.8])
    state.minima = Minima(wrong[None], np.array([2.0]), np.full((1, 4), 9.0), np.array([True]))
    state.spent_before = 1000.0
    starts = spectrum(state, oracle)
    assert starts is not None
    (position, period), turns = next(iter(state.periods.items())), 3 if formula is wave else 1
    linear = len(problem.linear)
    assert oracle.evaluations == int(period.passed[-1]) * turns * (linear + 1)
    found = state.space.decode(state.box.origin + state.box.width * starts)[:, position]
    n = 60 * (found if formula is pair else 1 / found)
    assert n[0] == pytest.approx(60 / 1.7, abs=1), "within a period of the right number"

    # A scan that the budget ends continues where it ended.
    oracle.budget, evaluations = Budget(), oracle.evaluations
    short = Oracle(problem, Budget(evaluations=50))
    with pytest.raises(BudgetExhausted):
        spectrum(state, short)
    rest = Oracle(problem, Budget())
    again = spectrum(state, rest)
    assert again is not None
    assert again.tolist() == starts.tolist()
    assert short.evaluations + rest.evaluations == evaluations
    assert (state.scan.solved, state.scan.residuals) == ([], [])


def test_a_spectrum_needs_no_linear_parameter() -> None:
    y = np.cos(2 * X + 1)
    box = {"w": (0.1, 6), "p": (0, 6.3)}
    fit = miho.fit(lambda x, w, p: np.cos(w * x + p), X, y, box, budget=Budget(evaluations=20))
    oracle = Oracle(fit.problem, Budget())
    state = MIHOGN().start(oracle, np.random.default_rng(0))
    state.periods.update(periods(fit.problem))
    wrong = np.array([[0.7, 0.1]])
    state.minima = Minima(wrong, np.array([1.0]), np.full((1, 2), 9.0), np.array([True]))
    state.spent_before = 1000.0
    starts = spectrum(state, oracle)
    assert starts is not None
    assert 0.1 + 5.9 * starts[0, 0] == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("size", [1.0, 1e200, 1e308, np.inf, np.nan])
@pytest.mark.parametrize("linear", [0, 1])
def test_residuals_of_any_size_have_a_loss(size: float, linear: int) -> None:
    residuals = list(np.array([[1.0, -1.0], [-1.0, 1.0]]) * size)[: linear + 1]
    loss, _ = _solution(residuals, np.full(linear, 0.25), np.ones(linear))
    assert loss >= 0
    if size == 1:
        assert loss == pytest.approx(1 - linear)


def test_a_scan_solves_for_a_parameter_on_the_log_scale() -> None:
    linear = problem_of(wave, [1.0, 1.5, 1.7, 2.0], noise=0.1)
    c, a, *others = linear.space.parameters
    space = Space((c, replace(a, low=1e-3, scale="log"), *others))
    problem = CurveFit(linear.model, linear.dataset, space, compiled=True)
    assert "a" in problem.linear
    oracle = Oracle(problem, Budget())
    state = MIHOGN().start(oracle, np.random.default_rng(0))
    truth = space.encode(np.array([[0.0, 0.1, 1.7, 2.0]]))
    x = (truth - state.box.origin) / state.box.width
    losses = solve_linear(x, state, oracle)
    solution = space.decode(state.box.origin + state.box.width * x)
    assert solution[0, :2] == pytest.approx([1.0, 1.5], abs=0.05)  # 4 standard errors
    assert losses == pytest.approx(problem.loss(solution))


def best_of_periodogram(x: Array, y: Array) -> float:
    """Least mean square over sines with 0.6 to 60 periods in the rows."""
    losses = []
    for n in np.arange(0.6, 60, 1 / 16):
        angle = 2 * np.pi * n * x / 60
        columns = np.stack([np.ones_like(x), np.sin(angle), np.cos(angle)], axis=1)
        rest = y - columns @ np.linalg.lstsq(columns, y)[0]
        losses.append(np.mean(rest**2))
    return float(min(losses))


@pytest.mark.parametrize("instance", range(8))
def test_a_claim_on_a_wide_range_of_periods_is_right(instance: int) -> None:
    rng = np.random.default_rng(instance)
    x = np.sort(rng.uniform(0, 60, int(rng.integers(40, 70))))
    problem = problem_of(wave, [1.0, 1.2, rng.uniform(1.2, 3), rng.uniform(0, 6)], x)
    record = minimize(MIHOGN(), problem, Budget(evaluations=20_000))
    right = record.loss <= 1.002 * best_of_periodogram(x, problem.dataset.columns["y"])
    assert right or record.outcome is not Outcome.CONVERGED


def test_a_period_is_scanned_even_if_one_minimum_only_was_found() -> None:
    problem = problem_of(wave, [1.0, 1.5, 1.7, 2.0])
    oracle = Oracle(problem, Budget())
    state = MIHOGN().start(oracle, np.random.default_rng(0))
    state.periods.update(periods(problem))
    wrong = np.array([[0.6, 0.1, 0.4, 0.8]])
    state.minima = Minima(wrong, np.array([2.0]), np.full((1, 4), 9.0), np.array([True]))
    state.spent_before, state.tested = 1000.0, 2.0
    state.challenged, state.passed = True, 1
    prepare_challenge(state, oracle)
    assert state.near is not None
