"""Hyperband over quasi-Newton steps, from losses alone."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from miho.data import Dataset
from miho.identification import CurveFit
from miho.optim import (
    MIHOQN,
    Budget,
    Oracle,
    Outcome,
    Parameter,
    Problem,
    Space,
    minimize,
)
from miho.optim.seeds import stream

Array = NDArray[np.float64]


class Loss(Problem):
    """A loss of d parameters in a box, which remembers the fidelities of its batches."""

    def __init__(
        self,
        of: Callable[[Array], Array],
        d: int,
        low: float = -3.0,
        high: float = 5.0,
        name: str = "loss",
    ) -> None:
        self.of, self.name = of, name
        self.space = Space(tuple(Parameter(f"p{k}", "-", low, high) for k in range(d)))
        self.batches: list[tuple[int, float]] = []

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        self.batches.append((len(thetas), fidelity))
        return self.of(thetas)


class Rows(Loss):
    """A line through 2,000 noisy rows, of which a fidelity takes the first; and no residuals."""

    rows = 2000

    def __init__(self) -> None:
        super().__init__(lambda thetas: thetas[:, 0], 2, name="rows")
        rng = np.random.default_rng(5)
        self.x = rng.uniform(-1, 1, self.rows)
        self.y = 0.5 + 2 * self.x + 0.1 * rng.standard_normal(self.rows)

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        self.batches.append((len(thetas), fidelity))
        m = round(fidelity * self.rows)
        errors = thetas[:, :1] + thetas[:, 1:] * self.x[:m] - self.y[:m]
        return np.asarray(np.einsum("nm,nm->n", errors, errors) / m)


def decay(t: "s", *, a: "V", b: "1/s", c: "V") -> "V":  # type: ignore[name-defined]  # noqa: F821
    return a * np.exp(-b * t) + c


def fit(N: int = 600) -> CurveFit:
    """A decay with an offset, of which rows are told apart by their noise."""
    rng = np.random.default_rng(7)
    t = rng.uniform(0, 5, N)
    y = 2 * np.exp(-0.7 * t) + 0.3 + 0.05 * rng.standard_normal(N)
    space = Space(
        (
            Parameter("a", "V", 0.0, 100.0),
            Parameter("b", "1/s", 0.01, 100.0, scale="log"),
            Parameter("c", "V", -10.0, 10.0),
        )
    )
    return CurveFit(decay, Dataset("decay", {"t": t, "y": y}, {"t": "s", "y": "V"}, "y"), space)


def test_misra1a_agrees_with_nist() -> None:
    """Certified parameters from losses alone, to a hundredth of their standard deviations.

    Steps end where they promise 1e-9 of the loss; a parameter that is off by a standard deviation
    raises it by 1 / 12 of itself (12 degrees of freedom), so that 1e-9 leaves 1e-4 of one.
    """
    x = np.array([77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8,
                  593.1, 689.1, 760.0])  # fmt: skip
    y = np.array([10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01,
                  66.40, 75.47, 81.78])  # fmt: skip

    def mean_square(thetas: Array) -> Array:
        errors = thetas[:, :1] * -np.expm1(-thetas[:, 1:] * x) - y
        return np.asarray((errors**2).mean(axis=1))

    problem = Loss(mean_square, 2)
    problem.space = Space((Parameter("b1", "-", 10, 1000), Parameter("b2", "-", 1e-5, 1e-2)))
    record = minimize(MIHOQN(), problem, Budget(evaluations=5000))
    assert record.outcome is Outcome.CONVERGED
    assert record.theta is not None
    np.testing.assert_allclose(14 * record.loss, 1.2455138894e-01, rtol=1e-8)
    certified, deviations = [2.3894212918e02, 5.5015643181e-04], [2.7070075241, 7.2668688436e-06]
    assert (np.abs(record.theta - certified) < 0.01 * np.array(deviations)).all()


def test_a_quadratic_costs_about_what_its_coefficients_do() -> None:
    """15 losses determine a quadratic of four parameters; a narrow valley makes no difference."""
    rng = np.random.default_rng(0)
    Q = np.linalg.qr(rng.standard_normal((4, 4)))[0] * [1.0, 0.1, 0.01, 0.001] ** np.array(0.5)
    H = Q @ Q.T
    problem = Loss(lambda t: 1 + np.einsum("ni,ij,nj->n", t - 0.3, H, t - 0.3), 4)
    for seed in range(5):
        budget = Budget(evaluations=200, target=1 + 1e-6)
        record = minimize(MIHOQN(), problem, budget, seed)
        assert record.loss <= 1 + 1e-6
        assert record.evaluations <= 4 * 15


@pytest.mark.parametrize(
    ("of", "least"),
    [
        (lambda t: np.abs(t - 0.7).sum(axis=1) + 1, 1.0),
        (lambda t: np.abs(t - 0.7).max(axis=1) + 1, 1.0),
        (lambda t: np.abs(t[:, 0] - t[:, 1]) + 0.1 * (t[:, 0] + t[:, 1] - 1) ** 2 + 1, 1.0),
    ],
    ids=["sum", "maximum", "ridge"],
)
def test_kinks_are_no_end(of: Callable[[Array], Array], least: float) -> None:
    """Where a slope jumps quasi-Newton steps fail; a simplex has the last word."""
    record = minimize(MIHOQN(), Loss(of, 2), Budget(evaluations=3000))
    assert record.loss - least < 1e-4


def test_losses_may_be_negative() -> None:
    """A logarithm of a likelihood has no zero: relative gains are of its size."""
    problem = Loss(lambda t: ((t - 1) ** 2 * [1, 30]).sum(axis=1) - 40, 2)
    record = minimize(MIHOQN(), problem, Budget(evaluations=600))
    assert record.loss == pytest.approx(-40, abs=1e-6)


def test_a_better_basin_is_found_and_relied_on() -> None:
    """Two basins, of which the better one takes a half of the box.

    Five brackets that all end in the other one would be relied on, which 3 % of runs may.
    """

    def two(t: Array) -> Array:
        near, far = ((t + 1) ** 2).sum(axis=1) + 2, ((t - 3) ** 2).sum(axis=1) + 1
        return np.asarray(np.minimum(near, far))

    losses = []
    for seed in range(8):
        record = minimize(MIHOQN(), Loss(two, 2), Budget(evaluations=20_000), seed)
        assert record.outcome is Outcome.CONVERGED
        losses.append(record.loss)
        assert record.descents is not None
        assert record.descents.agreeing is not None
        assert record.descents.agreeing >= 5
        assert record.descents.screened > record.descents.started
    assert np.median(losses) == pytest.approx(1.0, abs=1e-6)
    assert np.isclose(losses, 1.0, rtol=1e-6).sum() >= 7


def test_brackets_bound_a_run_without_a_budget() -> None:
    """Every descent ends elsewhere in what looks like noise: evidence never is enough."""
    problem = Loss(lambda t: 2 + np.cos(1e6 * t).prod(axis=1), 2)
    record = minimize(MIHOQN(max_brackets=7), problem)
    assert record.outcome is Outcome.BRACKETS
    assert record.descents is not None
    assert record.descents.started <= 2 * 7


def test_first_looks_are_at_few_rows_in_one_batch() -> None:
    """Of 2,000 rows 8 first, in one batch; then three times as many for the best."""
    problem = Rows()
    oracle = Oracle(problem, Budget(), space=problem.space)
    optimizer = MIHOQN()
    state = optimizer.start(oracle, stream("levels"))
    assert state.level_rows == (8, 24, 72, 216, 648, 2000)
    assert optimizer.fidelity(state) == 8 / 2000
    assert len(optimizer.ask(state)) == 243
    optimizer.step(state, oracle)
    batch = optimizer.ask(state)
    assert len(batch) > 40, "slopes of all survivors are asked for together"
    assert optimizer.fidelity(state) == 8 / 2000


def test_the_optimum_of_all_rows_is_found_for_a_few_looks_at_them() -> None:
    """Checked against the closed form, a linear regression; to 1.001 of its error."""
    problem = Rows()
    A = np.stack([np.ones(problem.rows), problem.x], axis=1)
    least = float(np.linalg.lstsq(A, problem.y, rcond=None)[1][0]) / problem.rows
    record = minimize(MIHOQN(), problem, Budget(evaluations=40, target=1.002 * least))
    assert record.loss <= 1.002 * least
    assert record.evaluations < 20
    fidelities = {fidelity for _, fidelity in problem.batches}
    assert {8 / 2000, 24 / 2000, 1.0} <= fidelities


def test_without_rows_all_looks_are_whole() -> None:
    problem = Loss(lambda t: ((t - 1) ** 2).sum(axis=1) + 1, 3)
    minimize(MIHOQN(), problem, Budget(evaluations=300))
    assert {fidelity for _, fidelity in problem.batches} == {1.0}


def state_of(record: Any) -> bytes:
    return pickle.dumps(record.checkpoint.state)


@pytest.mark.parametrize("cuts", [(1, 2, 3, 5, 9, 13), (4, 8, 30, 31, 90)])
def test_a_cut_run_goes_on_bit_exactly_across_levels(cuts: tuple[int, ...]) -> None:
    """Cut within a batch, on any level, pickled and resumed: the same run."""
    problem, optimizer = fit(), MIHOQN()
    whole = minimize(optimizer, problem, Budget(evaluations=120), seed=2)
    cut = None
    for evaluations in (*cuts, 120):
        checkpoint = None if cut is None else pickle.loads(pickle.dumps(cut.checkpoint))
        budget = Budget(evaluations=evaluations)
        cut = minimize(optimizer, problem, budget, seed=2, checkpoint=checkpoint)
    assert cut is not None
    assert cut.trace.loss == whole.trace.loss
    assert cut.trace.evaluations == pytest.approx(whole.trace.evaluations, rel=1e-12)
    assert cut.descents == whole.descents
    np.testing.assert_array_equal(cut.checkpoint.state.batch, whole.checkpoint.state.batch)


def test_a_curve_fit_ends_by_itself_at_the_least_squares_optimum() -> None:
    """Where SciPy's solver ends that starts at the truth."""
    from scipy.optimize import least_squares

    problem = fit()
    truth = least_squares(problem.residuals, [2.0, 0.7, 0.3], x_scale="jac", xtol=1e-15, ftol=1e-15)
    for seed in range(3):
        record = minimize(MIHOQN(), problem, Budget(evaluations=5000), seed)
        assert record.outcome is Outcome.CONVERGED
        assert record.theta is not None
        assert record.loss == pytest.approx(2 * truth.cost / 600, rel=1e-8)
        # 1e-8 of the loss is 1e-4 sqrt(600) of a standard deviation, each some percent
        np.testing.assert_allclose(record.theta, truth.x, rtol=1e-3)


def test_exact_data_end_by_themselves() -> None:
    """A loss that losses do not resolve is as good as zero, and all that come to it agree."""
    exact = fit()
    t = exact.dataset["t"]
    columns = {"t": t, "y": 2 * np.exp(-0.7 * t) + 0.3}
    data = Dataset("exact", columns, {"t": "s", "y": "V"}, "y")
    problem = CurveFit(decay, data, exact.space)
    record = minimize(MIHOQN(), problem, Budget(evaluations=5000))
    assert record.outcome is Outcome.CONVERGED
    assert record.loss <= problem.resolution
    assert record.theta is not None
    np.testing.assert_allclose(record.theta, [2, 0.7, 0.3], rtol=1e-6)


def test_half_a_box_that_has_no_loss_is_left() -> None:
    def half(t: Array) -> Array:
        with np.errstate(invalid="ignore"):
            return np.asarray(((t - 0.01) ** 2).sum(axis=1) + 1 + 0 * np.log(t[:, 0]))

    record = minimize(MIHOQN(), Loss(half, 3), Budget(evaluations=1500))
    assert record.loss == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"eta": 1}, "eta"),
        ({"rows_per_parameter": 0.0}, "rows_per_parameter"),
        ({"steps_per_rung": 0}, "steps_per_rung"),
        ({"max_step": -1.0}, "max_step"),
        ({"min_candidates": 300}, "max_candidates is 243; expected at least min_candidates, 300"),
    ],
)
def test_settings_are_checked(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(MIHOQN(), **settings)
