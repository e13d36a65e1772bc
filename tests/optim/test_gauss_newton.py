"""Steps of Levenberg and Marquardt, compiled and from outside."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, minimize_scalar

from miho.core import machine
from miho.data import Dataset
from miho.identification import CurveFit
from miho.optim import (
    MIHOGN,
    Budget,
    BudgetExhausted,
    LeastSquaresProblem,
    Oracle,
    Outcome,
    Parameter,
    RunInterrupted,
    RunRecord,
    Space,
    Trace,
    minimize,
)
from miho.vehicle.models import TorqueCubic
from tests.optim.decays import Outside, fit

Array = NDArray[np.float64]

SUMS = 1e-9
"""Losses of compiled and NumPy's residuals differ by some 1e-15, which a few steps of a narrow
valley make more of: ten thousand roundings of 1e-16 are 1e-12, and three digits are to spare."""


def same_steps(trace: Trace, reference: Trace) -> None:
    """Improvements at the same evaluations, of the same loss at the same place, to rounding."""
    assert trace.evaluations == reference.evaluations
    np.testing.assert_allclose(trace.loss, reference.loss, rtol=SUMS)
    expected = np.array(reference.theta)
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(np.array(trace.theta) / scale, expected / scale, rtol=0, atol=1e-6)


def finished(problem: LeastSquaresProblem, method: MIHOGN, seed: int) -> RunRecord:
    record = minimize(method, problem, seed=seed)
    assert record.outcome in (Outcome.CONVERGED, Outcome.BRACKETS), record.error
    return record


@pytest.mark.parametrize("linear", [(), ("a", "c")], ids=["stepping", "projecting"])
def test_compiled_steps_are_those_from_outside(linear: tuple[str, ...]) -> None:
    """To rounding, as long as rounding decides nothing: the first brackets of a run."""
    problem = fit(linear=linear)
    for seed in range(4):
        short = MIHOGN(
            max_brackets=4, final_tolerance=1e-8
        )  # the last digits are those of rounding
        for method in (short, replace(short, max_secants=0, projection_period=1)):
            compiled = finished(problem, method, seed)
            outside = finished(Outside(problem), method, seed)
            same_steps(compiled.trace, outside.trace)
            # Rounding decides whether one more step is tried after the last improvement.
            assert compiled.evaluations == pytest.approx(outside.evaluations, abs=1)
            assert compiled.descents is not None
            assert outside.descents is not None
            assert compiled.descents.ends == pytest.approx(outside.descents.ends, rel=SUMS)


@pytest.mark.parametrize("says_rows", [True, False])
@pytest.mark.parametrize("budget", [1, 2, 3, 5, 8, 13, 21, 34])
def test_a_budget_is_kept_to_the_row(says_rows: bool, budget: int) -> None:
    """What the oracle counts is what the problem was asked, in rows; a Jacobian costs d of them."""
    problem = Outside(fit(1000), says_rows)
    oracle = Oracle(problem, Budget(evaluations=budget))
    with pytest.raises(BudgetExhausted):
        MIHOGN().run(oracle, np.random.default_rng(1))
    rows = problem.residual_rows + 3 * problem.jacobian_rows
    assert oracle.evaluations == rows / 1000
    assert oracle.evaluations <= budget
    assert oracle.evaluations > budget - 4, "the next Jacobian could be paid"


@pytest.mark.parametrize("budget", range(1, 30))
def test_compiled_steps_keep_the_budget_and_record_what_is_so(budget: int) -> None:
    """Recorded losses are those of the whole data, each improvement less than the one before."""
    problem = fit(1000)
    record = minimize(MIHOGN(), problem, Budget(evaluations=budget))
    assert budget - 4 < record.evaluations <= budget or record.outcome is Outcome.CONVERGED
    if len(record.trace):
        losses = problem.loss(np.array(record.trace.theta))
        np.testing.assert_allclose(record.trace.loss, losses, rtol=1e-12)
        assert (np.diff(record.trace.loss) < 0).all()
        assert (np.diff(record.trace.evaluations) > 0).all()
        assert record.trace.evaluations[-1] <= record.evaluations
        assert record.outside == 0


def test_steps_stay_in_the_box() -> None:
    """The optimum, a = 2 and c = 0.3, is outside of this one, and so are solutions for them."""
    space = Space(
        (
            Parameter("a", "V", 0.0, 1.5),
            Parameter("b", "1/s", 0.01, 100.0, scale="log"),
            Parameter("c", "V", 0.6, 10.0),
        )
    )
    problem = Outside(fit(space=space))
    record = minimize(MIHOGN(max_brackets=10), problem)
    thetas = np.array([theta for theta, _ in problem.requests])
    assert space.contains(thetas).all()
    assert record.theta is not None
    assert record.theta[2] == 0.6


def test_the_optimum_is_scipys_with_and_without_secants_and_projection() -> None:
    """Steps end where they promise 1e-8 of the loss: it is that near to the least one.

    The least one is that of the best b, of 100,000 on a fine grid, refined by a parabola.
    """
    problem = fit()
    t, y = problem.inputs[0], problem.dataset["y"]

    def projected(b: float) -> float:
        basis = np.column_stack([np.exp(-b * t), np.ones_like(t)])
        residuals = basis @ np.linalg.lstsq(basis, y)[0] - y
        return float(residuals @ residuals) / t.size

    least = minimize_scalar(projected, (0.5, 0.7, 1.0), tol=1e-10).fun
    for settings in ({}, {"max_secants": 0}, {"projection_period": 0}, {"projection_period": 1}):
        record = minimize(MIHOGN(**settings), problem)
        assert record.outcome is Outcome.CONVERGED
        assert -1e-13 < record.loss / least - 1 < 1e-8, settings


def test_a_linear_problem_is_solved_in_the_evaluations_of_its_solutions() -> None:
    """Of d = 4: a look and a Jacobian's 4 on a ninth of the rows, then on all, and a last look.

    The solution in the box is SciPy's (bvls), where the normal equations of p3 = 0 are not.
    """
    rng = np.random.default_rng(8)
    speed = rng.uniform(50, 700, 900)
    torque = 300 + 0.5 * speed - 1e-3 * speed**2 + 5e-7 * speed**3 + rng.standard_normal(900)
    model = TorqueCubic()
    box = [(-1000, 1000), (-1000, 1000), (-1000, 1000), (1e-3, 1)]
    for low, high in ((-1000.0, 1000.0), (1e-6, 1.0)):
        box[3] = (low, high)
        space = Space(
            tuple(
                Parameter(name, unit, *between)
                for (name, unit), between in zip(model.parameters.items(), box, strict=True)
            )
        )
        name = next(iter(model.inputs))
        units = {name: model.inputs[name], "y": model.output}
        problem = CurveFit(model, Dataset("cubic", {name: speed, "y": torque}, units, "y"), space)
        A = problem.jacobian(np.zeros(4) + space.low)
        norms = np.linalg.norm(A, axis=0)
        sides = space.low * norms, space.high * norms
        scipys = lsq_linear(A / norms, torque, sides, method="bvls", tol=1e-15).x / norms
        for variant in (problem, Outside(problem)):
            record = minimize(MIHOGN(), variant)
            assert record.outcome is Outcome.CONVERGED
            assert record.evaluations == pytest.approx(5 / 9 + 5 + 1, abs=1e-9)
            expected = float(np.mean((A @ scipys - torque) ** 2))
            assert record.loss == pytest.approx(expected, rel=1e-10)


class Broken(Outside):
    """Without a value, or square, where b is large, of the residuals or of their derivatives."""

    def __init__(self, how: str, derivatives: bool) -> None:
        super().__init__(fit())
        self.how, self.derivatives = how, derivatives

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        residuals = super().residuals(theta, fidelity)
        return residuals if self.derivatives else self.broken(theta, residuals)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        jacobian = super().jacobian(theta, fidelity)
        return self.broken(theta, jacobian) if self.derivatives else jacobian

    def broken(self, theta: Array, values: Array) -> Array:
        if theta[1] < 0.9:
            return values
        if self.how == "raises":
            raise ArithmeticError("too fast")
        values = values.copy()
        values[0] = float(self.how)
        return values


@pytest.mark.parametrize("how", ["nan", "inf", "1e200", "raises"])
@pytest.mark.parametrize("derivatives", [False, True])
def test_values_that_cannot_be_used_end_no_search(how: str, derivatives: bool) -> None:
    problem = Broken(how, derivatives)
    record = minimize(MIHOGN(), problem, Budget(evaluations=2000))
    assert record.outcome is Outcome.CONVERGED, record.error
    assert record.rejected or (derivatives and how == "1e200"), "whose squares alone are none"
    assert record.loss == pytest.approx(minimize(MIHOGN(), fit()).loss, rel=1e-7)


def test_a_target_stops_compiled_steps_at_their_evaluation() -> None:
    problem = fit()
    free = minimize(MIHOGN(), problem)
    for k in range(len(free.trace)):
        budget = Budget(target=free.trace.loss[k])
        record = minimize(MIHOGN(), problem, budget)
        assert record.outcome is Outcome.BUDGET
        assert record.trace.evaluations == free.trace.evaluations[: k + 1]


class Stopping(Outside):
    """Has the run interrupted in its `last` look or Jacobian."""

    def __init__(self, last: int) -> None:
        super().__init__(fit())
        self.oracle: Oracle | None = None
        self.last, self.count = last, 0

    def stop(self) -> None:
        self.count += 1
        if self.oracle is not None and self.count == self.last:
            self.oracle.interrupted = True

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        self.stop()
        return super().residuals(theta, fidelity)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        self.stop()
        return super().jacobian(theta, fidelity)


@pytest.mark.parametrize("last", range(1, 60))
def test_a_run_interrupted_in_an_evaluation_goes_on_behind_it(last: int) -> None:
    """What was evaluated is not evaluated again: the run is the one never interrupted."""
    method = MIHOGN(max_brackets=4)
    whole = Oracle(Stopping(0), Budget())
    method.run(whole, np.random.default_rng(1))

    problem = Stopping(last)
    problem.oracle = cut = Oracle(problem, Budget())
    with pytest.raises(RunInterrupted):
        method.run(cut, np.random.default_rng(1))
    state, meter = pickle.loads(pickle.dumps((cut.state, cut.meter)))
    resumed = Oracle(Stopping(0), Budget(), meter=meter)
    method.resume(resumed, state)
    assert resumed.trace.loss == whole.trace.loss
    assert resumed.trace.evaluations == whole.trace.evaluations
    assert resumed.evaluations == whole.evaluations


@pytest.mark.skipif(machine() is None, reason="the machine was not built")
def test_compiled_steps_end_in_time_and_when_interrupted() -> None:
    """Between two blocks of some 20 ms, whatever is left of the search."""
    problem = fit(200_000)
    hurried = minimize(MIHOGN(challenges=200, tolerance=1e-300), problem,
                       Budget(seconds=0.05))  # fmt: skip
    assert hurried.outcome is Outcome.BUDGET
    seen: list[float] = []

    def interrupt(oracle: Oracle) -> None:
        seen.append(oracle.evaluations)
        oracle.interrupted = True

    oracle = Oracle(problem, Budget(), observer=interrupt)
    with pytest.raises(RunInterrupted):
        MIHOGN().run(oracle, np.random.default_rng(1))
    assert [oracle.evaluations] == seen
