"""SciPy's global methods: differential evolution and dual annealing."""

import inspect

import numpy as np
import pytest
import scipy.optimize

from miho import Budget, Optimizer, Problem, minimize
from miho.methods import DifferentialEvolution, DualAnnealing
from miho.testing import DecayFit


@pytest.mark.parametrize(
    ("method", "evaluations"), [(DifferentialEvolution(), 3000), (DualAnnealing(), 1500)]
)
def test_it_reaches_the_optimum(optimum: float, method: Optimizer, evaluations: int) -> None:
    """Polish and local search by differences of 1e-8 stop at about 1e-8 of the loss."""
    record = minimize(method, DecayFit(), Budget(evaluations=evaluations), seed=1)
    assert record.loss == pytest.approx(optimum, rel=1e-7)


@pytest.mark.parametrize(
    ("method", "evaluations"), [(DifferentialEvolution(), 4000), (DualAnnealing(), 3000)]
)
def test_it_follows_a_valley_beside_missing_values(
    valley: Problem, method: Optimizer, evaluations: int
) -> None:
    """SciPy's own answer would be NaN here; unusable points are large numbers to it."""
    record = minimize(method, valley, Budget(evaluations=evaluations), seed=1)
    assert record.loss < 1e-8
    assert record.rejected["loss is nan"] > 0


def test_generation_zero_is_the_common_initial_configurations() -> None:
    problem = DecayFit()
    minimize(DifferentialEvolution(popsize=10), problem, Budget(evaluations=50), seed=5)
    space = problem.space.seeded(problem.name, 5)
    assert np.array_equal(problem.thetas[-50:-30], space.decode(space.initial(20)))


def test_a_converged_population_is_replaced_until_the_budget_ends() -> None:
    problem = DecayFit()
    record = minimize(DifferentialEvolution(), problem, Budget(evaluations=5000), seed=1)
    assert record.evaluations == 5000
    late = np.array(problem.thetas[-3000:])
    assert np.ptp(late[:, 0]) > 5  # a fresh population fills the box of width 10


def test_it_anneals_anew_until_the_budget_ends() -> None:
    """Five steps of 2 d visits each end early; the next start is another draw."""
    problem = DecayFit()
    method = DualAnnealing(maxiter=5, local_search=False)
    record = minimize(method, problem, Budget(evaluations=200), seed=1)
    assert record.evaluations == 200
    assert len(np.unique(problem.thetas[-200:], axis=0)) > 150


def test_settings_are_the_defaults_of_scipy() -> None:
    evolution, annealing = DifferentialEvolution(), DualAnnealing()
    for method, function, names in (
        (evolution, scipy.optimize.differential_evolution,
         ("strategy", "popsize", "maxiter", "tol", "atol", "recombination", "polish")),
        (annealing, scipy.optimize.dual_annealing,
         ("maxiter", "initial_temp", "restart_temp_ratio", "visit", "accept")),
    ):  # fmt: skip
        parameters = inspect.signature(function).parameters
        for name in names:
            assert getattr(method, name) == parameters[name].default, name
    assert annealing.local_search is not parameters["no_local_search"].default
    mutation = inspect.signature(scipy.optimize.differential_evolution).parameters["mutation"]
    assert (evolution.mutation_low, evolution.mutation_high) == mutation.default


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="strategy is 'best'"):
        DifferentialEvolution(strategy="best")
    with pytest.raises(ValueError, match=r"mutation_high is 0\.2; expected a number"):
        DifferentialEvolution(mutation_high=0.2)
    with pytest.raises(ValueError, match=r"recombination is 1\.5"):
        DifferentialEvolution(recombination=1.5)
    with pytest.raises(ValueError, match=r"polish is 'no'; expected True or False"):
        DifferentialEvolution(polish="no")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"visit is 3\.5; expected above 1, at most 3"):
        DualAnnealing(visit=3.5)
