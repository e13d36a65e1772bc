import inspect

import numpy as np
import pytest
import scipy.optimize

from miho import Budget, Problem, minimize
from miho.methods.dual_annealing import DualAnnealing
from miho.testing import DecayFit


def test_it_reaches_the_optimum(optimum: float) -> None:
    """Its local search on differences of 1e-8 stops at about 1e-8 of the loss."""
    record = minimize(DualAnnealing(), DecayFit(), Budget(evaluations=1500), seed=1)
    assert record.loss == pytest.approx(optimum, rel=1e-7)


def test_it_follows_a_valley_beside_missing_values(valley: Problem) -> None:
    record = minimize(DualAnnealing(), valley, Budget(evaluations=3000), seed=1)
    assert record.loss < 1e-8
    assert record.rejected["loss is nan"] > 0


def test_it_anneals_anew_until_the_budget_ends() -> None:
    """Five steps of 2 d visits each end early; the next start is another draw."""
    problem = DecayFit()
    method = DualAnnealing(maxiter=5, local_search=False)
    record = minimize(method, problem, Budget(evaluations=200), seed=1)
    assert record.evaluations == 200
    assert len(np.unique(problem.thetas[-200:], axis=0)) > 150


def test_settings_are_the_defaults_of_scipy() -> None:
    method = DualAnnealing()
    parameters = inspect.signature(scipy.optimize.dual_annealing).parameters
    for name in ("maxiter", "initial_temp", "restart_temp_ratio", "visit", "accept"):
        assert getattr(method, name) == parameters[name].default, name
    assert method.local_search is not parameters["no_local_search"].default


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match=r"visit is 3\.5; expected above 1, at most 3"):
        DualAnnealing(visit=3.5)
