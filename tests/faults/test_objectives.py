"""R8: objectives without usable values."""

from pathlib import Path

import numpy as np
import pytest

from experiments.faults.objectives import FAULTS, complaint, objectives, optimizers
from miho.optim import Optimizer, Oracle, RandomSearch


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("method", ["random", "miho", "pso_100", "cma_es"])
def test_quick_methods_withstand(method: str, fault: str) -> None:
    assert complaint(optimizers()[0][method], fault) == ""


@pytest.mark.slow
def test_it_is_met(tmp_path: Path) -> None:
    row = objectives(tmp_path)
    assert row.met, row.measured


class Fragile(Optimizer):
    """Takes the first losses for numbers."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        while True:
            losses = oracle(oracle.space.decode(oracle.space.sample(10, rng)))
            if np.isinf(losses).any():
                raise ArithmeticError("inf")


class Generous(Optimizer):
    """Asks the problem behind the oracle's back."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        oracle._problem.loss(oracle.space.decode(oracle.space.sample(10, rng)))
        RandomSearch().run(oracle, rng)


def test_faults_of_methods_are_found() -> None:
    assert "failed: ArithmeticError: inf" in complaint(Fragile(), "NaN half-space")
    assert complaint(Generous(), "huge") == "counted 200 evaluations of 210"
