"""The settings of PSO with constriction are those of its source."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from miho import Budget, minimize
from miho.methods.pso import PSO
from miho.testing import DecayFit

CONF = Path(__file__).parents[2] / "conf" / "optimizer" / "pso_constriction.yaml"


def constriction() -> PSO:
    settings = yaml.safe_load(CONF.read_text(encoding="utf-8"))
    return PSO(**{key: value for key, value in settings.items() if key not in ("name", "_target_")})


def test_constriction_is_that_of_clerc_and_kennedy() -> None:
    """chi = 2 / |2 - phi - sqrt(phi^2 - 4 phi)| with phi = 2.05 + 2.05."""
    optimizer, phi = constriction(), 4.1
    chi = 2 / abs(2 - phi - np.sqrt(phi**2 - 4 * phi))
    assert chi == pytest.approx(0.7298, abs=5e-5)
    assert [optimizer._inertia(i) for i in (0, 500, 10**6)] == pytest.approx([chi] * 3, rel=1e-14)
    assert (optimizer.c1, optimizer.c2) == pytest.approx((2.05 * chi,) * 2, rel=1e-14)


def test_constriction_converges() -> None:
    record = minimize(constriction(), DecayFit(), Budget(evaluations=10_000), seed=1)
    longer = minimize(PSO(particles=30, iterations=200), DecayFit(), Budget(evaluations=30_000))
    assert record.loss == pytest.approx(longer.loss, rel=1e-9)
