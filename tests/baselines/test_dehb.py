import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dehb")

from baselines.dehb import DEHB
from miho import Budget, Oracle, minimize
from miho.optim import BudgetExhausted
from miho.optim.seeds import stream
from miho.testing import DecayFit


class Fidelities(DecayFit):
    """Remembers the share of the data each evaluation was given."""

    def __init__(self) -> None:
        super().__init__()
        self.fidelities: list[float] = []

    def loss(self, thetas: np.ndarray, fidelity: float = 1.0) -> np.ndarray:
        self.fidelities += [fidelity] * len(thetas)
        return super().loss(thetas, fidelity)


def watched(method: DEHB, evaluations: int) -> Fidelities:
    problem = Fidelities()
    oracle = Oracle(problem, Budget(evaluations=evaluations))
    with pytest.raises(BudgetExhausted):
        method.run(oracle, stream("dehb"))
    return problem


def test_it_comes_close_to_the_optimum(optimum: float) -> None:
    record = minimize(DEHB(), DecayFit(), Budget(evaluations=150), seed=1)
    assert optimum < record.loss < 1.2 * optimum


def test_rungs_are_those_of_hyperband() -> None:
    """R = 9, eta = 3: brackets of 9, 3, 1 from 1/9 of the data; 3, 1 from 1/3; then 3 on all."""
    fidelities = np.array(watched(DEHB(R=9, eta=3), 10).fidelities) * 9
    first = [9] + [1] * 9 + [3] * 3 + [9] + [3] * 3 + [9] + [9] * 3
    assert np.round(fidelities[: len(first)], 9).tolist() == first


def test_it_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    watched(DEHB(), 3)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_a_missing_library_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "baselines.dehb")
    monkeypatch.setitem(sys.modules, "dehb", None)
    with pytest.raises(ImportError, match=r"missing \(dehb\); pip install 'miho\[rivals\]'"):
        importlib.import_module("baselines.dehb")


def test_unusable_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="strategy is 'best1'"):
        DEHB(strategy="best1")
    with pytest.raises(ValueError, match="R is 2"):
        DEHB(R=2, eta=3)
