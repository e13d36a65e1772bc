import importlib
import sys
import threading

import numpy as np
import pytest

pytest.importorskip("nevergrad")

import nevergrad

from baselines.ngopt import NGOpt
from miho import Budget, minimize
from miho.testing import DecayFit


def test_it_reaches_the_optimum(optimum: float) -> None:
    """Plans of 100 evaluations in two dimensions are Cobyla's, which stops at steps of 1e-6."""
    record = minimize(NGOpt(), DecayFit(), Budget(evaluations=100), seed=1)
    assert optimum < record.loss < 1.001 * optimum


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """What the library is told to plan for, plan after plan.

    The last plan, of 1, meets the end of the budget.
    """
    budgets = []
    method = nevergrad.optimizers.NGOpt

    def watched(parametrization: object, budget: int) -> object:
        budgets.append(budget)
        return method(parametrization=parametrization, budget=budget)

    monkeypatch.setattr(nevergrad.optimizers, "NGOpt", watched)
    return budgets


def test_it_plans_for_what_it_is_told_and_then_for_what_is_left(plans: list[int]) -> None:
    minimize(NGOpt(plan=30), DecayFit(), Budget(evaluations=70), seed=1)
    assert plans == [30, 30, 10, 1]


def test_it_plans_for_the_whole_run_unless_told(plans: list[int]) -> None:
    minimize(NGOpt(), DecayFit(), Budget(evaluations=70), seed=1)
    assert plans == [70, 1]


def test_seconds_alone_say_nothing_to_plan_for() -> None:
    budget = Budget(target=1e-9, seconds=0.5)
    record = minimize(NGOpt(plan=5), DecayFit(), budget, seed=1)
    assert record.evaluations > 5
    record = minimize(NGOpt(), DecayFit(), budget, seed=1)
    assert record.error is not None
    assert "plan is None, but the run has no limit of evaluations" in record.error
    with pytest.raises(ValueError, match="plan is 0"):
        NGOpt(plan=0)


@pytest.mark.slow
def test_a_model_of_the_loss_can_be_asked() -> None:
    """Plans of 300 evaluations fit quadratic models, whose predictions NumPy 2.4 gives as arrays.

    It draws from NumPy's global generator, which is put back: the same again, and no trace left.
    """
    before = str(np.random.get_state())  # noqa: NPY002
    records = [minimize(NGOpt(), DecayFit(), Budget(evaluations=60), seed=1) for _ in range(2)]
    records += [minimize(NGOpt(plan=300), DecayFit(), Budget(seconds=2.0), seed=1)]
    assert records[0].trace.loss == records[1].trace.loss
    assert records[2].error is None
    assert str(np.random.get_state()) == before  # noqa: NPY002


def test_a_missing_library_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "baselines.ngopt")
    monkeypatch.setitem(sys.modules, "nevergrad", None)
    with pytest.raises(ImportError, match=r"missing \(nevergrad\); pip install 'miho\[rivals\]'"):
        importlib.import_module("baselines.ngopt")


def test_no_threads_stay_behind() -> None:
    before = threading.active_count()
    minimize(NGOpt(), DecayFit(), Budget(evaluations=40), seed=1)
    assert threading.active_count() <= before + 1
