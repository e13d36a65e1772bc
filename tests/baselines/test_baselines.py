"""Each baseline does what its source says: one step by hand, or an optimum known otherwise."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from baselines.optuna_hyperband import OptunaHyperband
from miho import Budget, Parameter, Space, minimize
from miho.methods.gbo import GBO
from miho.methods.least_squares import LeastSquares
from miho.methods.pso import PSO, PSOState
from miho.optim import LeastSquaresProblem, Outcome
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.testing import DecayFit


class Watched(DecayFit):
    """Remembers where residuals and derivatives were asked for."""

    def __init__(self) -> None:
        super().__init__()
        self.residuals_at: list[Array] = []
        self.jacobians = 0

    def residuals(self, theta: Array) -> Array:
        self.residuals_at.append(theta.copy())
        return super().residuals(theta)

    def jacobian(self, theta: Array) -> Array:
        self.jacobians += 1
        return super().jacobian(theta)


def test_gbo_steps_down_the_gradient_of_the_loss() -> None:
    """The gradient is checked against central differences of the loss itself."""
    problem = Watched()
    minimize(GBO(learning_rate=1e-3), problem, Budget(evaluations=10), seed=1)
    first, second = problem.residuals_at[-4:-2]
    loss = DecayFit().loss
    for k in range(2):
        h = 1e-6 * (np.arange(2) == k)
        slope = (loss((first + h)[None])[0] - loss((first - h)[None])[0]) / 2e-6
        assert second[k] == pytest.approx(first[k] - 1e-3 * slope, rel=1e-6)


@pytest.mark.parametrize("units", ["SI", "kN_deg", "box"])
def test_gbo_steps_in_its_units(units: str) -> None:
    """Closed form: in units of s a step is s^2 times as long, because the gradient is per unit."""
    space = Space(
        (
            Parameter("B", "1/rad", 0.0, 40.0),
            Parameter("C", "-", 0.0, 3.0),
            Parameter("D", "N", 0.0, 6000.0),
            Parameter("Sx", "rad", -0.1, 0.1),
        )
    )
    sizes = {
        "SI": [1.0, 1.0, 1.0, 1.0],
        "kN_deg": [180 / np.pi, 1.0, 1000.0, np.pi / 180],
        "box": [40.0, 3.0, 6000.0, 0.2],
    }
    target = space.initial(1)[0] * 0.9

    class Distance(LeastSquaresProblem):
        name = "distance"

        def __init__(self) -> None:
            self.space, self.at = space, list[Array]()

        def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
            return np.asarray(np.mean((thetas - target) ** 2, axis=1))

        def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
            self.at.append(theta.copy())
            return np.asarray(theta - target)

        def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
            return np.eye(4)

    problem, rate = Distance(), 1e-9
    record = minimize(GBO(rate, units=units, steps=2), problem, seed=1)
    assert record.outcome is Outcome.CONVERGED
    assert record.evaluations == 2 * (1 + 4)
    first, second = problem.at
    expected = first - rate * np.square(sizes[units]) * 2 / 4 * (first - target)
    np.testing.assert_allclose(second, expected, rtol=1e-14)  # a few roundings


def test_gbo_starts_where_sampling_says() -> None:
    problem = Watched()
    optimizer = GBO(1e-3, sampling="uniform_plus_noise", steps=1)
    minimize(optimizer, problem, seed=1)
    space = problem.space.seeded(problem.name, 1)
    start = space.decode(space.initial(1, "uniform_plus_noise"))[0]
    np.testing.assert_array_equal(problem.residuals_at[0], space.clip(start))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"units": "imperial"}, "units is 'imperial'; expected one of SI, kN_deg, box"),
        ({"sampling": "grid"}, "sampling is 'grid'"),
        ({"steps": 0}, "steps is 0; expected a whole number of at least 1"),
    ],
)
def test_bad_settings_of_gbo(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GBO(1e-3, **settings)


@pytest.mark.slow
def test_gbo_descends_to_the_optimum_with_a_fit_rate() -> None:
    problem = DecayFit()
    optimum = least_squares(problem.residuals, [1.0, 1.0], problem.jacobian)
    record = minimize(GBO(learning_rate=0.3), problem, Budget(evaluations=60_000), seed=1)
    assert record.loss == pytest.approx(np.mean(optimum.fun**2), rel=1e-6)


def pso_state(optimizer: PSO, space: Space) -> PSOState:
    return optimizer.init(space, stream("pso"))


def test_pso_moves_by_its_formula() -> None:
    space = Space((Parameter("x", "m", -10.0, 10.0), Parameter("y", "m", -10.0, 10.0)))
    optimizer = PSO(particles=3, c1=2.0, c2=1.0, inertia_start=0.9, velocity_limit=0.2)
    state = pso_state(optimizer, space)
    positions = np.array([[1.0, 2.0], [3.0, -4.0], [-8.0, 9.9]])
    state.positions, state.velocities = positions.copy(), np.full((3, 2), 0.5)
    state.best, state.best_losses = positions + 1.0, np.array([5.0, 0.5, 0.9])
    losses = np.array([4.0, 2.0, 1.0])

    own_best = np.array([[1.0, 2.0], [4.0, -3.0], [-7.0, 10.9]])  # only the first improved
    leader = own_best[1]
    rng = stream("pso")
    expected = 0.9 * 0.5 + 2.0 * rng.random((3, 2)) * (own_best - positions)
    expected += 1.0 * rng.random((3, 2)) * (leader - positions)
    expected = np.clip(expected, -4.0, 4.0)
    expected_positions = np.clip(positions + expected, -10, 10)
    optimizer.tell(state, optimizer.ask(state), losses)
    assert state.positions == pytest.approx(expected_positions)
    assert (np.abs(expected) == 4.0).any(), "the limit is met"
    stopped = positions + expected != expected_positions
    assert state.velocities == pytest.approx(np.where(stopped, 0.0, expected))
    assert state.best_losses.tolist() == [4.0, 0.5, 0.9]


def test_pso_inertia_falls_linearly_and_stays() -> None:
    optimizer = PSO(iterations=100)
    inertia = [optimizer._inertia(i) for i in (0, 50, 100, 1000)]
    assert inertia == pytest.approx([0.9, 0.65, 0.4, 0.4])


def test_pso_converges() -> None:
    problem = DecayFit()
    optimum = least_squares(problem.residuals, [1.0, 1.0], problem.jacobian)
    record = minimize(PSO(particles=30, iterations=200), problem, Budget(evaluations=30_000))
    assert record.loss == pytest.approx(np.mean(optimum.fun**2), rel=1e-9)


def test_least_squares_reaches_the_optimum_and_ends() -> None:
    problem = Watched()
    optimum = least_squares(DecayFit().residuals, [1.0, 1.0], DecayFit().jacobian)
    record = minimize(LeastSquares(screen=50, starts=3, rounds=2), problem)
    assert record.outcome is Outcome.CONVERGED
    assert record.loss == pytest.approx(np.mean(optimum.fun**2), rel=1e-9)
    looks, slopes = len(problem.residuals_at), problem.jacobians
    assert record.evaluations == 100 + looks + 2 * slopes


def test_least_squares_survives_derivatives_that_do_not_exist() -> None:
    class Ragged(DecayFit):
        def jacobian(self, theta: Array) -> Array:
            return super().jacobian(theta) * (np.nan if theta[0] > 0.8 else 1.0)

    record = minimize(LeastSquares(screen=50, starts=3, rounds=2), Ragged())
    assert record.outcome is Outcome.CONVERGED
    assert record.rejected == {"derivative is not finite": 6}


@pytest.mark.slow
def test_optuna_prunes_as_its_own_pruner_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials end at rungs 1, eta, eta^2, ...; with the pruner asleep they all go on to R."""
    R, eta = 27, 3

    def lengths() -> list[int]:
        counts: list[int] = []
        tell = OptunaHyperband._evaluate

        def counted(self, p, trial, oracle, rng):  # type: ignore[no-untyped-def]
            before = oracle.evaluations
            try:
                return tell(self, p, trial, oracle, rng)
            finally:
                counts.append(int(oracle.evaluations - before))

        with monkeypatch.context() as patch:
            patch.setattr(OptunaHyperband, "_evaluate", counted)
            minimize(OptunaHyperband(R=R, eta=eta), DecayFit(), Budget(evaluations=3000), seed=2)
        return counts[:-1]  # the budget cuts the last one

    counted_lengths = lengths()
    assert set(counted_lengths) <= {1, 3, 9, 27}
    assert 1 in counted_lengths
    assert 27 in counted_lengths
    assert counted_lengths.count(1) > counted_lengths.count(27)
    monkeypatch.setattr("optuna.Trial.should_prune", lambda self: False)
    assert set(lengths()[30:]) == {27}
