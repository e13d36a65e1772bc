"""What a machine that has never run the method compiles, and how that ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit
from numba.core import event
from numba.extending import register_jitable
from numpy.typing import NDArray

from miho import CurveFit, Dataset, Parameter, Space
from miho.core import machine
from miho.optim import MIHO, MIHOGN, Budget, Optimizer, minimize
from miho.testing import DecayFit

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[2]

FIRST_RUN = """
from numba.core import event
from miho.compiled import gauss_newton_loop
from miho.optim import MIHOGN, Budget, minimize
from decays import fit

gauss_newton_loop.machine = lambda: None
method = MIHOGN(brackets=3)
with event.install_recorder("numba:compile") as compiled:
    given = minimize(method, fit(linear=("a", "c")), Budget(evaluations=500))
STEPS = "miho.compiled.gauss_newton"
names = set()
for _, one in compiled.buffer:
    function = one.data["dispatcher"]
    if function.py_func.__module__.startswith(STEPS) and function.stats.cache_path:
        names.add(function.py_func.__qualname__.split(".")[0])
from miho.compiled.gauss_newton_loop import run_bracket
assert given.error is None, given.error
print(*sorted(names), len(run_bracket.compiled.signatures))
"""


@pytest.mark.slow
def test_a_compiled_problem_compiles_its_own_steps_once(tmp_path: Path) -> None:
    """Where the library has no machine; and not those from outside, which take as long again."""
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path),
        "NUMBA_OPT": "0",  # what is compiled need not be fast
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(Path(__file__).parent)]),
    }
    command = [sys.executable, "-c", FIRST_RUN]
    process = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert process.returncode == 0, process.stderr
    assert process.stdout.split() == ["run_bracket", "1"]


def decay(t: Any, *, a: Any, b: Any) -> Any:
    return a * np.exp(-b * t)


def tone(t: Any, *, a: Any, w: Any, c: Any) -> Any:
    return a * np.sin(w * t) + c


@pytest.mark.skipif(machine() is None, reason="the machine was not built")
@pytest.mark.parametrize("method", [MIHOGN(), MIHO(R=9, eta=3)])
def test_a_second_formula_compiles_nothing(method: Optimizer) -> None:
    """It runs on the machine, and the compiled steps are given its address."""
    t = np.linspace(0, 3, 400)
    units = {"t": "s", "y": "V"}
    first, second = (
        CurveFit(function, Dataset("d", {"t": t, "y": function(t, **values)}, units, "y"),
                 Space(tuple(Parameter(*each, 0.1, 5) for each in parameters)), compiled=True)
        for function, values, parameters in (
            (decay, {"a": 2.0, "b": 1.5}, (("a", "V"), ("b", "1/s"))),
            (tone, {"a": 2.0, "w": 3.0, "c": 1.0}, (("a", "V"), ("w", "1/s"), ("c", "V"))),
        )
    )  # fmt: skip
    budget = Budget(evaluations=400)
    minimize(method, first, budget)
    with event.install_recorder("numba:compile") as compiled:
        run = minimize(method, second, budget)
    assert run.error is None
    assert run.loss < 1.0
    assert not compiled.buffer


@pytest.mark.slow
def test_two_workers_compile_the_steps_once(tmp_path: Path) -> None:
    """Where the library has no machine, which needs them not at all."""
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "NUMBA_DEBUG_CACHE": "1",  # tells of what is read and written
        "NUMBA_OPT": "0",
    }
    command = [sys.executable, "-m", "experiments.identify", "-m", "model=torque_cubic",
               "dataset=torque_15", "seed=range(4)", "sweep.processes=2",
               f"root={tmp_path / 'runs'}"]  # fmt: skip
    process = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert process.returncode == 0, process.stderr
    saved = [line for line in process.stdout.splitlines() if "data saved to" in line]
    of_steps = sum("gauss_newton_loop.run_bracket." in line for line in saved)
    assert of_steps == (machine() is None), saved
    assert len(saved) == len(set(saved))


ALL_COMPILED = """
from numba.core import event
from experiments.app.build import build_optimizer, build_problem
from experiments.app.compose import composed
from experiments.app.schema import register
from miho.optim import Budget, minimize
from miho.optim.minimize import warm_up

register()
for name in ("brake_static", "single_track", "brake_play", "tire_lf"):
    cfg = composed([f"problem={name}", "optimizer=miho_gn"])
    method, problem = build_optimizer(cfg), build_problem(cfg)
    warm_up(method, problem)
    with event.install_recorder("numba:compile") as compiled:
        runs = [minimize(method, problem, Budget(evaluations=150), seed) for seed in range(6)]
    assert all(run.error is None for run in runs)
    for _, one in compiled.buffer:
        print(name, one.data["dispatcher"])
"""


@pytest.mark.slow
def test_nothing_is_compiled_while_the_clock_runs(tmp_path: Path) -> None:
    """Models of expressions and of arrays, with and without linear parameters, a simulation."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_OPT": "0"}
    command = [sys.executable, "-c", ALL_COMPILED]
    process = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert process.returncode == 0, process.stderr
    assert process.stdout == ""


@register_jitable
def first_part(x: float) -> float:
    return x + 1.0


@register_jitable
def second_part(x: float) -> float:
    return first_part(x) * 2.0


class Compiling(DecayFit):
    """Whose loss is compiled in three parts, the first of which the user interrupts."""

    name = "compiling"

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        @njit
        def whole(x: float) -> float:
            return second_part(first_part(x))

        whole(1.0)
        return super().loss(thetas, fidelity)


class Interrupting(event.Listener):  # type: ignore[misc]
    """Sends Ctrl-C when the first compilation begins."""

    def __init__(self) -> None:
        self.begun = 0

    def on_start(self, event: object) -> None:
        self.begun += 1
        if self.begun == 1:
            signal.raise_signal(signal.SIGINT)

    def on_end(self, event: object) -> None:
        pass


def test_ctrl_c_ends_a_warm_up_before_the_next_function() -> None:
    listener = Interrupting()
    with event.install_listener("numba:compile", listener), pytest.raises(KeyboardInterrupt):
        minimize(MIHOGN(), Compiling(), Budget(evaluations=10))
    assert listener.begun == 1
