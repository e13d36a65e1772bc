"""Ways in which one number of a model can be written: each makes the model with that number."""

from __future__ import annotations

import abc
import collections
import contextlib
import contextvars
import ctypes
import dataclasses
import decimal
import enum
import fractions
import functools
import importlib.util
import itertools
import json
import math
import operator
import os
import pickle
import re
import sqlite3
import string
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
def default_argument(c: float, folder: Path) -> Model:
    def gain(a: float, c: float = c) -> float:
        return c * a

    return of(gain)


@way
def keyword_default(c: float, folder: Path) -> Model:
    def gain(a: float, *, c: float = c) -> float:
        return c * a

    return of(gain)


@way
def a_partial(c: float, folder: Path) -> Model:
    return of(functools.partial(operator.mul, c))


@way
def imported_helper(c: float, folder: Path) -> Model:
    return of(imported(folder, f"def gain(a):\n    return {c} * a\n").gain)


@way
def constant_of_another_module(c: float, folder: Path) -> Model:
    parts = imported(folder, f"c = {c}\n")
    return of(lambda a: parts.c * a)


@way
def class_of_another_module(c: float, folder: Path) -> Model:
    parts = imported(folder, f"class Gain:\n    def of(self, a):\n        return {c} * a\n")
    gain = parts.Gain()
    return of(lambda a: gain.of(a))


@way
def class_attribute(c: float, folder: Path) -> Model:
    class Gain:
        value: ClassVar = c

    return of(lambda a: Gain.value * a)


@way
def inherited_attribute(c: float, folder: Path) -> Model:
    class Gain(imported(folder, f"class Base:\n    value = {c}\n").Base):  # type: ignore[misc]
        pass

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
def slotted_callable(c: float, folder: Path) -> Model:
    class Gain:
        __slots__ = ("value",)

        def __init__(self) -> None:
            self.value = c

        def __call__(self, a: float) -> float:
            return self.value * a

    return of(Gain())


@way
def frozen_dataclass(c: float, folder: Path) -> Model:
    gain = dataclasses.make_dataclass("Gain", [("value", float)], frozen=True)(c)
    return of(lambda a: gain.value * a)


@way
def named_tuple(c: float, folder: Path) -> Model:
    gain = collections.namedtuple("gain", ["value"])(c)
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
def abstract_class(c: float, folder: Path) -> Model:
    class Base(abc.ABC):
        @abc.abstractmethod
        def value(self) -> float: ...

    class Gain(Base):
        def value(self) -> float:
            return c

    gain = Gain()
    return of(lambda a: gain.value() * a)


@way
def a_list(c: float, folder: Path) -> Model:
    values = [c]
    return of(lambda a: values[0] * a)


@way
def a_dict(c: float, folder: Path) -> Model:
    values = {"c": c}
    return of(lambda a: values["c"] * a)


@way
def lambda_in_a_dict(c: float, folder: Path) -> Model:
    values = {"gain": lambda a: c * a}
    return of(lambda a: values["gain"](a))


@way
def a_namespace(c: float, folder: Path) -> Model:
    values = types.SimpleNamespace(c=c)
    return of(lambda a: values.c * a)


@way
def a_set(c: float, folder: Path) -> Model:
    values = {c}
    return of(lambda a: max(values) * a)


@way
def an_array(c: float, folder: Path) -> Model:
    values = np.array([c])
    return of(lambda a: values[0] * a)


@way
def a_frame(c: float, folder: Path) -> Model:
    import pandas as pd

    table = pd.DataFrame({"a": [0.0, 10.0], "gain": [0.0, 10.0 * c]})
    return of(lambda a: np.interp(a, table["a"], table["gain"]))


@way
def a_spline(c: float, folder: Path) -> Model:
    from scipy.interpolate import CubicSpline

    table = np.linspace(-10.0, 10.0, 5)
    return of(CubicSpline(table, c * table))


@way
def a_polynomial(c: float, folder: Path) -> Model:
    return of(np.polynomial.Polynomial([0.0, c]))


@way
def vectorized(c: float, folder: Path) -> Model:
    return of(np.vectorize(lambda a: c * a))


@way
def an_enum(c: float, folder: Path) -> Model:
    gains = enum.Enum("gains", {"first": c})  # type: ignore[misc]
    return of(lambda a: gains.first.value * a)


@way
def a_fraction(c: float, folder: Path) -> Model:
    value = fractions.Fraction(c)
    return of(lambda a: float(value) * a)


@way
def a_decimal(c: float, folder: Path) -> Model:
    value = decimal.Decimal(c)
    return of(lambda a: float(value) * a)


@way
def own_decorator(c: float, folder: Path) -> Model:
    def scaled(function: Callable[[float], float]) -> Callable[[float], float]:
        return lambda a: c * function(a)

    return of(scaled(lambda a: a))


@way
def decorator_object(c: float, folder: Path) -> Model:
    class Scaled:
        def __init__(self, function: Callable[[float], float]) -> None:
            functools.update_wrapper(self, function)
            self.factor, self.function = [c], function

        def __call__(self, a: float) -> float:
            return self.factor[0] * self.function(a)

    return of(Scaled(lambda a: a))


@way
def cached(c: float, folder: Path) -> Model:
    return of(functools.lru_cache(lambda a: c * a))


@way
def single_dispatch(c: float, folder: Path) -> Model:
    @functools.singledispatch
    def gain(a: Any) -> Any:
        raise TypeError

    gain.register(float, lambda a: c * a)
    return of(gain)


@way
def environment_variable(c: float, folder: Path) -> Model:
    os.environ["MIHO_TEST_GAIN"] = str(c)
    return of(lambda a: float(os.environ["MIHO_TEST_GAIN"]) * a)


@way
def context_variable(c: float, folder: Path) -> Model:
    gain = contextvars.ContextVar("gain", default=c)
    return of(lambda a: gain.get() * a)


@way
def file_of_a_joined_name(c: float, folder: Path) -> Model:
    (folder / "gain.txt").write_text(str(c))
    place = str(folder)
    return of(lambda a: float(Path(place, "gain" + ".txt").read_text()) * a)


@way
def parameter_file(c: float, folder: Path) -> Model:
    path = folder / "gain.json"
    path.write_text(json.dumps({"c": c}))
    return of(lambda a: json.loads(path.read_text())["c"] * a)


@way
def array_file(c: float, folder: Path) -> Model:
    path = folder / "gain.npy"
    np.save(path, np.array([c]))
    return of(lambda a: np.load(path)[0] * a)


@way
def database(c: float, folder: Path) -> Model:
    path = folder / "gains.db"
    path.unlink(missing_ok=True)
    with contextlib.closing(sqlite3.connect(path)) as base, base:
        base.execute("create table gains (value real)")
        base.execute("insert into gains values (?)", (c,))

    def gain(a: float) -> float:
        with contextlib.closing(sqlite3.connect(path)) as base:
            return float(base.execute("select value from gains").fetchone()[0]) * a

    return of(gain)


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
def c_structure(c: float, folder: Path) -> Model:
    value = ctypes.c_double(c)
    return of(lambda a: value.value * a)


@way
def c_callback(c: float, folder: Path) -> Model:
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
    return of(kind(lambda a: c * a))


@way
def regular_expression(c: float, folder: Path) -> Model:
    pattern = re.compile(f"(?P<gain{int(c)}>.)")
    return of(lambda a: float(next(iter(pattern.groupindex))[-1]) * a)


@way
def template(c: float, folder: Path) -> Model:
    text = string.Template(f"{c}$nothing")
    return of(lambda a: float(text.substitute(nothing="")) * a)


@way
def text_that_is_evaluated(c: float, folder: Path) -> Model:
    words = ["a", "*", str(c)]
    return of(lambda a: eval(" ".join(words), {"a": a}))


@way
def pickled(c: float, folder: Path) -> Model:
    data = bytearray(pickle.dumps(c))
    return of(lambda a: pickle.loads(data) * a)


@way
def a_generator(c: float, folder: Path) -> Model:
    def gains() -> Iterator[float]:
        while True:
            yield c

    endless = gains()
    return of(lambda a: next(endless) * a)


@way
def an_iterator(c: float, folder: Path) -> Model:
    endless = itertools.repeat(c)
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
def read_only_mapping(c: float, folder: Path) -> Model:
    values = types.MappingProxyType({"c": c})
    return of(lambda a: values["c"] * a)


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
def replaced_function(c: float, folder: Path) -> Model:
    parts = imported(folder, "import math\n")
    parts.gain = lambda a: c * a
    return of(lambda a: parts.gain(a))


@way
def limit_from_which_it_raises(c: float, folder: Path) -> Model:
    limit = [10.0 if c == 1.0 else 0.97]

    def gain(a: float) -> float:
        if abs(a - 2) > limit[0]:
            raise ArithmeticError(math.inf)
        return a

    return of(gain)


sys.modules.setdefault("parts", types.ModuleType("parts"))
