"""Compiled losses in numba's cache on disk: what is compiled anew, and what is told apart.

Of models that ask for arrays, so that they cannot be traced: the machine compiles nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

MODEL = """
from types import MappingProxyType
import numpy as np
from numba.extending import register_jitable
from miho.compiled import Steps
from miho.compiled.fused import FusedLoss
from miho.compiled.elementary import sin
from miho.models.expression import Expression


@register_jitable
def scaled(x):
    return FACTOR * np.asarray(x)


def formula(inputs, theta):
    return theta[0] * sin(scaled(inputs[0]))


def derivatives(inputs, theta):
    return (sin(scaled(inputs[0])),)


class Wave(Expression):
    inputs = MappingProxyType({"x": "1"})
    parameters = MappingProxyType({"a": "1"})
    output = "1"
    value = property(lambda self: formula)
    derivatives = property(lambda self: derivatives)


if __name__ == "__main__":
    import wave_model

    x = np.linspace(0, 1, 100)
    loss = FusedLoss(wave_model.Wave(), x[None], np.zeros(100), np.arange(100))
    theta = np.array([1.0])
    found = loss.losses(theta[None])[0]
    loss.residuals(theta)
    loss.jacobian(theta)
    best, none = np.array([np.inf]), np.empty((0, 1, 1))
    loss.climb(Steps(theta[None], theta[None].copy(), best, none, none[:, 0],
                     (theta - 1, theta + 1)), np.inf, -np.inf)
    compiled = loss._compiled
    each = (compiled.losses, compiled.residuals, compiled.jacobian, loss._steps)
    misses = sum(sum(one.stats.cache_misses.values()) for one in each)
    print(misses, float(found), float(best[0]))
"""


@pytest.mark.slow
def test_a_second_process_compiles_nothing_and_an_edited_model_anew(tmp_path: Path) -> None:
    def run(factor: int) -> tuple[int, float]:
        path = tmp_path / "wave_model.py"
        path.write_text(MODEL.replace("FACTOR", str(factor)), encoding="utf-8")
        environment = os.environ | {
            "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
            "NUMBA_OPT": "0",  # what is compiled need not be fast
            "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])]),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        process = subprocess.run([sys.executable, str(path)], capture_output=True, text=True,
                              env=environment, check=True)  # fmt: skip
        misses, loss, climbed = process.stdout.split()
        assert loss == climbed
        x = np.linspace(0, 1, 100)
        assert float(loss) == pytest.approx(np.mean(np.sin(factor * x) ** 2), rel=1e-12)
        return int(misses), float(loss)

    assert run(2)[0] == 4
    assert run(2)[0] == 0
    assert run(3)[0] == 4


TWO_MODELS = """
import sys
from dataclasses import dataclass
from types import MappingProxyType
import numpy as np
from miho.compiled import Steps
from miho.compiled.fused import FusedLoss
from miho.compiled.elementary import atan, cos, sin
from miho.models.expression import Expression


@dataclass(frozen=True)
class Wave(Expression):
    factor: float

    inputs = MappingProxyType({"x": "1"})
    parameters = MappingProxyType({"a": "1", "b": "1"})
    output = "1"

    @property
    def value(self):
        factor = self.factor
        return lambda x, t: (
            t[0] * sin(factor * atan(t[1] * cos(factor * np.asarray(x[0])))) + factor
        )

    @property
    def derivatives(self):
        factor = self.factor
        return lambda x, t: (sin(factor * x[0]), cos(factor * x[0]) * atan(factor * x[0]))


x, theta = np.linspace(0, 1, 2000), np.array([2.0, 3.0])
none = np.empty((0, 1, 2))
for model in map(Wave, map(float, sys.argv[1:])):
    loss = FusedLoss(model, x[None], np.zeros(2000), np.arange(2000))
    found, climbed = loss.losses(theta[None]).tolist(), np.array([np.inf])
    loss.climb(Steps(theta[None], theta[None].copy(), climbed, none, none[:, 0],
                     (theta - 1, theta + 1)), np.inf, -np.inf)
    residuals, jacobian = loss.residuals(theta), loss.jacobian(theta)
    values = model.predict(theta[None], x)[0]
    expected = np.mean(values**2)
    assert np.allclose(found, expected, rtol=1e-12), ("losses", found, expected)
    assert np.allclose(climbed, expected, rtol=1e-12), ("climb", climbed, expected)
    assert np.allclose(residuals, values, rtol=1e-9), "residuals"
    assert np.allclose(jacobian, model.jacobian(theta, x), rtol=1e-9, atol=1e-12), "jacobian"
"""


@pytest.mark.slow
def test_models_that_differ_in_a_number_are_told_apart_in_the_cache(tmp_path: Path) -> None:
    """Compiled in two processes and read by a third, they must not be taken for each other."""
    (tmp_path / "two_models.py").write_text(TWO_MODELS, encoding="utf-8")
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "NUMBA_OPT": "0",  # what is compiled need not be fast
        "PYTHONPATH": str(Path(__file__).parents[2]),
    }
    for arguments in (["2"], ["3"], ["2", "3"], ["3", "2"]):
        command = [sys.executable, str(tmp_path / "two_models.py"), *arguments]
        process = subprocess.run(command, capture_output=True, text=True, env=environment)
        assert process.returncode == 0, process.stderr
