"""What a wrapped library does must not depend on the unit of the loss."""

from importlib import import_module
from importlib.util import find_spec

import numpy as np
import pytest

from baselines.cma_es import CMAES
from baselines.optuna_samplers import OptunaCMAES, OptunaTPE
from miho import Budget, minimize
from miho.methods.descent import METHODS as METHODS_OF_DESCENT
from miho.methods.differential_evolution import DifferentialEvolution
from miho.methods.dual_annealing import DualAnnealing
from miho.methods.least_squares import LeastSquares
from miho.methods.local_search import LBFGSB, NelderMead
from miho.methods.unit_box import UNUSABLE, LossScale
from miho.methods.variable_projection import VariableProjection
from miho.optim import Optimizer
from miho.quantities import Array
from miho.testing import DecayFit

METHODS = [
    (CMAES(), 1200), (DifferentialEvolution(), 1500), (DualAnnealing(), 1000),
    (LBFGSB(screen=20, starts=2), 300), (NelderMead(screen=20, starts=2), 300),
    (OptunaCMAES(tolerance=0.5), 140), (OptunaTPE(), 25),
]  # fmt: skip
"""With evaluations enough to meet what could be absolute: ends of descents, restarts."""


class Rescaled(DecayFit):
    """`DecayFit` in units that make its loss 4^k times as large: exact in floating point."""

    def __init__(self, k: int) -> None:
        self.unit = 2.0**k
        super().__init__(lambda thetas, losses: losses * self.unit**2)

    def residuals(self, theta: Array) -> Array:
        return super().residuals(theta) * self.unit

    def jacobian(self, theta: Array) -> Array:
        return super().jacobian(theta) * self.unit


def visited(optimizer: Optimizer, problem: DecayFit, evaluations: int) -> Array:
    """Every configuration that the run evaluated."""
    record = minimize(optimizer, problem, Budget(evaluations=evaluations), seed=1)
    assert record.error is None
    return np.array(problem.thetas)


@pytest.mark.parametrize(
    ("optimizer", "evaluations"), METHODS, ids=[type(method).__name__ for method, _ in METHODS]
)
def test_the_unit_of_the_loss_is_without_effect(optimizer: Optimizer, evaluations: int) -> None:
    expected = visited(optimizer, DecayFit(), evaluations)
    for k in (-17, 17):  # 4^17 is 1.7e10
        assert np.array_equal(visited(optimizer, Rescaled(k), evaluations), expected), k


@pytest.mark.parametrize("kind", [LeastSquares, VariableProjection])
@pytest.mark.parametrize("method", METHODS_OF_DESCENT)
def test_nor_is_it_to_least_squares(
    kind: type[LeastSquares] | type[VariableProjection], method: str
) -> None:
    """SciPy's trust region solver scales by roots of the Jacobian, which round: 9e-16 was met."""
    optimizer = kind(screen=20, starts=2, method=method)
    expected = visited(optimizer, DecayFit(), 500)
    for k in (-17, 17):
        assert visited(optimizer, Rescaled(k), 500) == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("module", "name"), [("ngopt", "NGOpt"), ("dehb", "DEHB")])
def test_nor_is_it_to_rivals_that_are_optional(module: str, name: str) -> None:
    if not find_spec({"ngopt": "nevergrad", "dehb": "dehb"}[module]):
        pytest.skip("needs the rivals extra")
    optimizer: Optimizer = getattr(import_module(f"baselines.{module}"), name)()
    expected = visited(optimizer, DecayFit(), 100)
    for k in (-17, 17):
        assert np.array_equal(visited(optimizer, Rescaled(k), 100), expected)


def test_the_first_loss_that_measures_anything_is_the_level() -> None:
    scale = LossScale(100.0)
    assert scale(np.array([np.inf, 0.0])).tolist() == [UNUSABLE, 0.0]
    assert scale(np.array([np.inf, -4.0, 8.0])).tolist() == [UNUSABLE, -100.0, 200.0]
    assert scale(np.array([1.0, 1e99, 1e308])).tolist() == [25.0, UNUSABLE, UNUSABLE]
    smallest = LossScale(1e12)
    assert smallest(np.array([5e-324, 1e308]))[1] == UNUSABLE
