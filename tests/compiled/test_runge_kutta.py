"""Trajectories by numba, as without the machine: in its cache on disk, and in batches."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from miho.models import Trajectory, taped_equations

LAGS = """
import sys
import numpy as np
from miho.models import Trajectory, taped_equations

taped_equations.machine = lambda: None
t = np.linspace(0.0, 1.0, 11)
for rate in sys.argv[1:]:
    model = Trajectory(lambda x, *, k, c=float(rate): -c * k * x, {"x": 1.0}, ["x"], name="lag")
    last = model.predict(np.array([[0.5]]), t)[0, -1]
    slope = model.jacobian(np.array([0.5]), t)[-1, 0]
    compiled = model._compiled
    each = compiled.solve, compiled.derive
    misses = sum(sum(one.stats.cache_misses.values()) for one in each)
    print(misses, float(last), float(slope))
"""


@pytest.mark.slow
def test_models_of_two_processes_are_told_apart_by_a_third(tmp_path: Path) -> None:
    """They differ in a constant alone: exp(-c k) and -c exp(-c k) at t = 1, by steps of a tenth."""

    def run(*rates: float) -> list[list[float]]:
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_OPT": "0"}
        command = [sys.executable, "-c", LAGS, *map(str, rates)]
        process = subprocess.run(
            command, capture_output=True, text=True, env=environment, check=True
        )
        return [[float(word) for word in line.split()] for line in process.stdout.splitlines()]

    assert run(1.0)[0][0] == 2
    assert run(2.0)[0][0] == 2
    for rate, (misses, last, slope) in zip((1.0, 2.0), run(1.0, 2.0), strict=True):
        assert misses == 0
        assert last == pytest.approx(np.exp(-rate / 2), rel=1e-5)
        assert slope == pytest.approx(-rate * np.exp(-rate / 2), rel=1e-4)


@pytest.mark.slow
def test_a_batch_of_any_size_gives_each_row_as_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """One, some and all lanes, and a second block; NaN in one lane stays there."""
    monkeypatch.setattr(taped_equations, "machine", lambda: None)
    model = Trajectory(
        lambda x, u, *, k, c: u * np.sin(k * x) - c * x, {"x": "identified"}, ["x"], name="lane"
    )
    t = np.linspace(0, 1, 6)
    columns = t, np.cos(t)
    thetas = np.random.default_rng(0).uniform(0.5, 1.5, (33, 3))
    thetas[7, 0] = np.nan
    alone = np.vstack([model.predict(theta[None], *columns) for theta in thetas])
    for n in (1, 5, 16, 17, 33):
        np.testing.assert_array_equal(model.predict(thetas[:n], *columns), alone[:n])
    assert np.isnan(alone[7, 1:]).all()
    assert np.isfinite(np.delete(alone, 7, axis=0)).all()
