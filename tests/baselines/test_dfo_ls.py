import importlib
import logging
import sys

import numpy as np
import pytest

from miho.quantities import Array

pytest.importorskip("dfols")

from baselines.dfo_ls import DFOLS
from miho import Budget, Oracle, minimize
from miho.optim import BudgetExhausted, Outcome
from miho.testing import DecayFit
from tests.baselines.test_least_squares import OnePoint
from tests.identification.published import misra1a


class Derivativeless(DecayFit):
    """Residuals in another unit, which raise where derivatives are asked for."""

    def __init__(self, unit: float = 1.0) -> None:
        super().__init__()
        self.unit = unit

    def residuals(self, theta: Array) -> Array:
        return super().residuals(theta) * self.unit

    def jacobian(self, theta: Array) -> Array:
        raise AssertionError("no derivatives are needed")


def path(problem: DecayFit, evaluations: int) -> Array:
    oracle = Oracle(problem, Budget(evaluations=evaluations))
    with pytest.raises(BudgetExhausted):
        DFOLS().run(oracle, np.random.default_rng(2))
    assert oracle.evaluations == problem.spent == evaluations
    return np.array(problem.thetas)


def test_it_finds_the_certified_minimum() -> None:
    record = minimize(DFOLS(rounds=3), misra1a(), seed=1)
    assert record.outcome is Outcome.CONVERGED
    assert record.loss * 14 == pytest.approx(1.2455138894e-1, rel=1e-8)
    assert record.descents is not None
    assert record.descents.started == 3


def test_derivatives_are_not_asked_for_and_units_change_nothing() -> None:
    thetas = path(Derivativeless(), 40)
    for unit in (2.0**-30, 2.0**30):
        np.testing.assert_array_equal(path(Derivativeless(unit), 40), thetas)


def test_it_takes_fewer_residuals_than_parameters() -> None:
    """There the library draws directions, from NumPy's global generator, which is left alone."""
    before = str(np.random.get_state())  # noqa: NPY002
    first, second = (path(OnePoint(), 60) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert str(np.random.get_state()) == before  # noqa: NPY002


def test_it_says_nothing(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    with caplog.at_level(logging.DEBUG):
        path(DecayFit(), 60)
    assert not caplog.records
    assert capfd.readouterr() == ("", "")


def test_what_the_library_asserts_ends_a_descent_and_nothing_else_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    message = "H must be symmetric"

    def fail(*_: object, **__: object) -> None:
        raise AssertionError(message)

    monkeypatch.setattr("baselines.dfo_ls.dfols.solve", fail)
    record = minimize(DFOLS(rounds=2), misra1a(), seed=1)
    assert record.outcome is not Outcome.FAILED
    assert record.descents is not None
    assert record.descents.started == 2
    message = "another"
    assert minimize(DFOLS(rounds=2), misra1a(), seed=1).outcome is Outcome.FAILED


def test_a_missing_library_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "baselines.dfo_ls")
    monkeypatch.setitem(sys.modules, "dfols", None)
    with pytest.raises(ImportError, match=r"missing \(dfols\); pip install 'miho\[rivals\]'"):
        importlib.import_module("baselines.dfo_ls")


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match=r"radius is 0\.6; expected above smallest, at most 0\.5"):
        DFOLS(radius=0.6)
    with pytest.raises(ValueError, match="smallest is 0"):
        DFOLS(smallest=0.0)
