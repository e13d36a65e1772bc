import inspect

import numpy as np
import pytest
import scipy.optimize

from miho import Budget, Problem, minimize
from miho.methods.differential_evolution import DifferentialEvolution
from miho.testing import DecayFit


def test_it_reaches_the_optimum(optimum: float) -> None:
    """With its polish: L-BFGS-B on differences of 1e-8 stops at about 1e-8 of the loss."""
    record = minimize(DifferentialEvolution(), DecayFit(), Budget(evaluations=3000), seed=1)
    assert record.loss == pytest.approx(optimum, rel=1e-7)


def test_it_follows_a_valley_beside_missing_values(valley: Problem) -> None:
    """SciPy's own answer would be NaN here; unusable points are large numbers to it."""
    record = minimize(DifferentialEvolution(), valley, Budget(evaluations=4000), seed=1)
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


def test_settings_are_the_defaults_of_scipy() -> None:
    method = DifferentialEvolution()
    defaults = {
        name: parameter.default
        for name, parameter in inspect.signature(
            scipy.optimize.differential_evolution
        ).parameters.items()
    }
    for name in ("strategy", "popsize", "maxiter", "tol", "atol", "recombination", "polish"):
        assert getattr(method, name) == defaults[name], name
    assert (method.mutation_low, method.mutation_high) == defaults["mutation"]


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="strategy is 'best'"):
        DifferentialEvolution(strategy="best")
    with pytest.raises(ValueError, match=r"mutation_high is 0\.2; expected a number"):
        DifferentialEvolution(mutation_high=0.2)
    with pytest.raises(ValueError, match=r"recombination is 1\.5"):
        DifferentialEvolution(recombination=1.5)
