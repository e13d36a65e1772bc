"""Ways in which one number of a model can be written: each makes the model with that number."""

from __future__ import annotations

import ctypes
import enum
import functools
import importlib.util
import json
import math
import operator
import os
import subprocess
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from miho.data import Dataset
from miho.identification import CurveFit
from miho.models import FunctionModel
from miho.optim import Budget, Parameter, RandomSearch, Space, minimize

Model = Callable[[Any, Any], Any]
"""An output (N,) of times (N,) and the parameter `a`, of which it takes the `float`, so that no
formula is traced."""
WAYS: dict[str, Callable[[float, Path], Model]] = {}
RANDOM = {"noise_of_one_stream"}
"""Ways whose values differ from call to call, so that they cannot be compared."""
SPACE = Space((Parameter("a", "", 0.0, 4.0),))
t = np.linspace(0.1, 1, 5)
LINE = Dataset("line", {"t": t, "y": 2 * t}, {"t": "", "y": ""}, "y")


def search(model: Model, journal: Path) -> float:
    """The smallest loss of a few random configurations."""
    function = FunctionModel(model, batched=False, rowwise=False, columns=("t",))
    problem = CurveFit(function, LINE, SPACE)
    budget = Budget(evaluations=6)
    return minimize(RandomSearch(), problem, budget, journal=journal).loss


def way(make: Callable[[float, Path], Model]) -> Callable[[float, Path], Model]:
    """Note a way by its name; it makes the model of a number, and may use a folder of its own."""
    WAYS[make.__name__] = make
    return make


def imported(folder: Path, text: str) -> Any:
    """A module of this text, imported from a file, as a fresh process would."""
    path = folder / "parts.py"
    path.write_text(text)
    spec = importlib.util.spec_from_file_location("parts", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    exec(compile(text, str(path), "exec"), vars(module))
    return module


def of(gain: Callable[[float], Any]) -> Model:
    """A model whose output is what a function gives of its parameter, times the time."""

    def model(t: Any, a: Any) -> Any:
        return np.asarray(gain(float(a)), dtype=float) * t

    return model


@way
def literal(c: float, folder: Path) -> Model:
    return imported(folder, f"def model(t, a):\n    return {c} * float(a) * t\n").model


@way
def a_global(c: float, folder: Path) -> Model:
    return imported(folder, f"c = {c}\ndef model(t, a):\n    return c * float(a) * t\n").model


@way
def closure(c: float, folder: Path) -> Model:
    return of(lambda a: c * a)


@way
def a_partial(c: float, folder: Path) -> Model:
    return of(functools.partial(operator.mul, c))


@way
def imported_helper(c: float, folder: Path) -> Model:
    return of(imported(folder, f"def gain(a):\n    return {c} * a\n").gain)


@way
def class_attribute(c: float, folder: Path) -> Model:
    class Gain:
        value: ClassVar = c

    return of(lambda a: Gain.value * a)


@way
def instance(c: float, folder: Path) -> Model:
    class Gain:
        def __init__(self) -> None:
            self.value = c

    gain = Gain()
    return of(lambda a: gain.value * a)


@way
def bound_method(c: float, folder: Path) -> Model:
    class Gain:
        def __init__(self) -> None:
            self.value = c

        def of(self, a: float) -> float:
            return self.value * a

    return of(Gain().of)


@way
def slotted_instance(c: float, folder: Path) -> Model:
    class Gain:
        __slots__ = ("value",)

        def __init__(self) -> None:
            self.value = c

    gain = Gain()
    return of(lambda a: gain.value * a)


@way
def a_property(c: float, folder: Path) -> Model:
    class Gain:
        @property
        def value(self) -> float:
            return c

    gain = Gain()
    return of(lambda a: gain.value * a)


@way
def a_list(c: float, folder: Path) -> Model:
    values = [c]
    return of(lambda a: values[0] * a)


@way
def an_array(c: float, folder: Path) -> Model:
    values = np.array([c])
    return of(lambda a: values[0] * a)


@way
def a_spline(c: float, folder: Path) -> Model:
    from scipy.interpolate import CubicSpline

    table = np.linspace(-10.0, 10.0, 5)
    return of(CubicSpline(table, c * table))


@way
def an_enum(c: float, folder: Path) -> Model:
    gains = enum.Enum("gains", {"first": c})  # type: ignore[misc]
    return of(lambda a: gains.first.value * a)


@way
def cached(c: float, folder: Path) -> Model:
    return of(functools.lru_cache(lambda a: c * a))


@way
def environment_variable(c: float, folder: Path) -> Model:
    os.environ["MIHO_TEST_GAIN"] = str(c)
    return of(lambda a: float(os.environ["MIHO_TEST_GAIN"]) * a)


@way
def parameter_file(c: float, folder: Path) -> Model:
    path = folder / "gain.json"
    path.write_text(json.dumps({"c": c}))
    return of(lambda a: json.loads(path.read_text())["c"] * a)


@way
def program(c: float, folder: Path) -> Model:
    path = folder / "simulate.sh"
    path.write_text(f"echo {c}\n")
    return of(lambda a: float(subprocess.check_output(["sh", path])) * a)


@way
def compiled_by_numba(c: float, folder: Path) -> Model:
    import numba

    return of(numba.njit(lambda a: c * a))


@way
def c_callback(c: float, folder: Path) -> Model:
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
    return of(kind(lambda a: c * a))


@way
def a_generator(c: float, folder: Path) -> Model:
    def gains() -> Iterator[float]:
        while True:
            yield c

    endless = gains()
    return of(lambda a: next(endless) * a)


@way
def seeded_noise(c: float, folder: Path) -> Model:
    gains = [c]
    return of(lambda a: gains[0] * a + 1e-3 * np.random.default_rng(1).standard_normal())


@way
def noise_of_one_stream(c: float, folder: Path) -> Model:
    gains, streams = [c], [np.random.default_rng(1)]
    return of(lambda a: gains[0] * a + 1e-3 * streams[0].standard_normal())


@way
def dynamic_attribute(c: float, folder: Path) -> Model:
    values = [c]

    class Gain:
        def __getattr__(self, name: str) -> float:
            if not name.startswith("by_"):
                raise AttributeError(name)
            return float(name.removeprefix("by_")) * values[0]

    gain = Gain()
    return of(lambda a: gain.by_1 * a)


@way
def metaclass(c: float, folder: Path) -> Model:
    class Kind(type):
        @property
        def value(cls) -> float:
            return c

    class Gain(metaclass=Kind):
        pass

    return of(lambda a: Gain.value * a)


@way
def limit_from_which_it_raises(c: float, folder: Path) -> Model:
    limit = [10.0 if c == 1.0 else 0.97]

    def gain(a: float) -> float:
        if abs(a - 2) > limit[0]:
            raise ArithmeticError(math.inf)
        return a

    return of(gain)


sys.modules.setdefault("parts", types.ModuleType("parts"))
