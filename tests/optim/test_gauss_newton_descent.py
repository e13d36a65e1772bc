"""A descent from a start by the machine ends where SciPy's does, and stays in the box."""

import _thread
import operator
import signal
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy

from miho.compiled.phases import bracket_of
from miho.core import machine
from miho.data import Dataset
from miho.identification import CurveFit
from miho.models import FunctionModel
from miho.optim import Parameter, Space, gauss_newton_descent
from miho.optim.gauss_newton_descent import LOOKS, descended

pytestmark = pytest.mark.skipif(machine() is None, reason="there is no machine")

t = np.linspace(0, 3, 700)
y = 2 * np.exp(-1.5 * t) + 0.3 + 0.05 * np.random.default_rng(1).standard_normal(t.size)
START = np.array([0.5, 0.4, -1.0])


def decay(t, *, a, b, c):  # type: ignore[no-untyped-def]
    return a * np.exp(-b * t) + c


def problem(high: float = 20.0) -> CurveFit:
    data = Dataset("decay", {"t": t, "y": y}, {"t": "", "y": ""}, "y")
    box = [("a", 0.0, 1e6), ("b", 0.05, high), ("c", -1e6, 1e6)]
    space = Space(tuple(Parameter(name, "", low=low, high=up) for name, low, up in box))
    return CurveFit(FunctionModel(decay), data, space)


def test_it_ends_where_scipy_does() -> None:
    fit = problem()
    rows = fit.machine_rows
    assert rows is not None
    end = descended(rows, fit.space, START)
    expected = scipy.optimize.least_squares(fit.residuals, START, fit.jacobian, xtol=1e-15).x
    np.testing.assert_allclose(end, expected, rtol=1e-7)  # the box is 1e6 wide, so 1e-10 of that


def test_it_stays_at_a_bound() -> None:
    fit = problem(high=1.2)
    assert fit.machine_rows is not None
    end = descended(fit.machine_rows, fit.space, START)
    assert end[1] == 1.2
    assert fit.loss(end[None])[0] < fit.loss(START[None])[0]


def test_it_stays_at_a_start_without_finite_residuals() -> None:
    fit = problem(high=1e6)
    assert fit.machine_rows is not None
    start = np.array([np.nan, 1.0, 0.0])
    assert descended(fit.machine_rows, fit.space, start) is start


def test_it_ends_with_more_parameters_than_looks_between_two_pauses() -> None:
    names = [f"a{k}" for k in range(LOOKS + 1)]
    terms = " + ".join(f"{name} * t" for name in names)
    scope: dict[str, Callable[..., object]] = {}
    exec(f"def total(t, *, {', '.join(names)}): return {terms}", scope)
    data = Dataset("total", {"t": t, "y": t}, {"t": "", "y": ""}, "y")
    space = Space(tuple(Parameter(name, "", low=-1.0, high=1.0) for name in names))
    fit = CurveFit(FunctionModel(scope["total"]), data, space)
    assert fit.machine_rows is not None
    end = descended(fit.machine_rows, space, np.zeros(len(names)))
    np.testing.assert_allclose(end.sum(), 1.0)


def dependent(d: int) -> CurveFit:
    """The sum of d parameters, of which the data determine one combination: steps take long."""
    names = [f"a{k}" for k in range(d)]
    terms = " + ".join(f"{name} * {name}" for name in names)
    source = f"def model(t, *, {', '.join(names)}):\n    return t * ({terms})\n"
    made: dict[str, Callable[..., Any]] = {}
    exec(source, made)
    x = np.linspace(0.5, 1.5, 2 * d)
    data = Dataset("sum", {"t": x, "y": 3 * x}, {"t": "", "y": ""}, "y")
    return CurveFit(
        FunctionModel(made["model"]), data, Space(tuple(Parameter(n, "", 0, 1) for n in names))
    )


def test_ctrl_c_undoes_a_step_and_the_next_call_repeats_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C arrives in every second call; a handler that does not raise lets the descent go on."""
    fit = dependent(200)
    rows, start = fit.machine_rows, np.linspace(0.2, 0.8, 200)
    assert rows is not None
    usual = descended(rows, fit.space, start)
    used: list[int] = []

    def pressing(rows: Any) -> Callable[..., int]:
        def call(*arguments: Any) -> int:
            run = partial(bracket_of(rows), *arguments)
            calls: list[Any] = [_thread.interrupt_main, run] if len(used) % 2 else [run]
            ended = list(map(operator.call, calls))[-1]  # in C: no handler runs in between
            used.append(int(arguments[-2][0]))  # of the tally
            return int(ended)

        return call

    monkeypatch.setattr(gauss_newton_descent, "bracket_of", pressing)
    previous = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        np.testing.assert_array_equal(descended(rows, fit.space, start), usual)
    finally:
        signal.signal(signal.SIGINT, previous)
    assert 0 in used, "a call that stops at once has used no rows"
