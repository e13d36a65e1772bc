"""Traced functions: the same values, exact derivatives, and refusal of what is no formula."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import miho
from miho.core import machine
from miho.models.expression import Expression
from miho.models.formula_text import written
from miho.models.function_model import FunctionModel
from miho.models.model import central_differences
from miho.models.symbolic import NotAFormulaError, argument, gradient, ordered, trace
from miho.models.traced import jointly_linear

needs_machine = pytest.mark.skipif(machine() is None, reason="the machine was not built")
t = np.linspace(0.0, 3.0, 31)
THETAS = np.array([[0.7, 1.3, 2.1], [1.9, 0.4, 0.6]])
FORMULAS: dict[str, Callable[..., Any]] = {
    "arithmetic": lambda t, a, b, c: (a * t - b) / (c + t**2) + 3 - (-t) * +a,
    "exponentials": lambda t, a, b, c: a * np.exp(-b * t) + np.expm1(c * t) - np.log1p(a * t),
    "logarithms": lambda t, a, b, c: np.log(a + t) + np.log10(b + t) * np.log2(c + t),
    "waves": lambda t, a, b, c: a * np.sin(b * t) + np.cos(c * t) * np.tan(0.3 * t),
    "arcs": lambda t, a, b, c: np.arctan(a * t) + np.arcsin(t / (4 + b)) + np.arccos(t / (4 + c)),
    "hyperbolas": lambda t, a, b, c: np.tanh(a * t) + np.sinh(b * t) - np.cosh(c * t),
    "inverse hyperbolas": lambda t, a, b, c: (
        np.arcsinh(a * t) + np.arccosh(1.5 + b * t) + np.arctanh(t / (4 + c))
    ),
    "powers": lambda t, a, b, c: (1 + a * t) ** b + c**t + t ** (1 + b) + np.power(1 + t, -2),
    "roots": lambda t, a, b, c: np.sqrt(a + t) + np.square(b * t) + abs(c - t) ** 3,
    "bends": lambda t, a, b, c: np.minimum(a * t, b + 0.01) + np.maximum(c * t, 1.003),
    "choices": lambda t, a, b, c: (
        np.where(t > a + 0.05, b * t, np.where(t**2 < c + 0.03, np.exp(c * t), a)) + a * (t >= 1.43)
    ),
    "cases": lambda t, a, b, c: np.where(
        ((t > a + 0.05) & ~(t > 2)) | (t == 0) | (t != t), b * t, c * np.sign(t - a - 0.01)
    ),
    "limits": lambda t, a, b, c: np.clip(a * t, 0.503, b + 0.01) + np.clip(c * t, 0.1, 1.003) ** 2,
    "steps": lambda t, a, b, c: (
        1 * (t > 1) + a * (1.0 * (t > 2.05)) + b * (t <= c + 0.05) + (t > a + 0.05)
    ),
    "what is not chosen": lambda t, a, b, c: np.where(
        t > 0.05, a * np.log(t) + np.sqrt(t - 0.05) / t, np.where(t < -1, np.log(-t - b), c)
    ),
    "planes": lambda t, a, b, c: np.hypot(a * t, b) + np.arctan2(a * t, c + t),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_values_and_derivatives_are_the_functions(name: str) -> None:
    """Central differences leave some 1e-10 of a derivative's size, a few digits less at bends."""
    model = FunctionModel(FORMULAS[name], columns=("t",))
    formula = model.formula_at(THETAS, t)
    assert isinstance(formula, Expression)
    np.testing.assert_allclose(
        formula.predict(THETAS, t), model.predict(THETAS, t), rtol=1e-13, atol=1e-13
    )
    for theta in THETAS:
        exact = formula.jacobian(theta, t)
        by_differences = central_differences(model.predict, theta, t)
        size = np.abs(exact).max()
        np.testing.assert_allclose(exact, by_differences, rtol=1e-7, atol=1e-8 * size)


def _kept(t: Any, a: Any, b: Any) -> Any:
    total = a * t
    copy = total
    copy += b
    return total


OTHERS: dict[str, Callable[..., Any]] = {
    "a mean": lambda t, a, b: a * (t - np.mean(t)) + b,
    "a branch on the type": lambda t, a, b: a * t + b * isinstance(t, np.ndarray),
    "an attribute": lambda t, a, b: a * t + b * hasattr(t, "shape"),
    "a sum": lambda t, a, b: a * t / np.sum(t) + b,
    "a branch": lambda t, a, b: a * t if np.all(t >= 0) else b * t,
    "a sum of truths": lambda t, a, b: a * t * ((t > 1) + (t > 2)) + b,
    "a condition that is a number": lambda t, a, b: np.where(t, a * t, b),
    "a size": lambda t, a, b: a * t + b * np.size(t),
    "a change in place": _kept,
    "a norm": lambda t, a, b: a * t / np.linalg.norm(t) + b,
    "no derivative where there is a value": lambda t, a, b: a * np.exp(b * np.log(t)),
}


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_more_than_a_formula_is_taken_as_it_is(name: str) -> None:
    function = OTHERS[name]
    with np.errstate(divide="ignore"):
        y = np.asarray(function(t, 1.5, 0.7), dtype=float)
        fit = miho.fit(function, t, y, {"a": (0.1, 5), "b": (0.1, 5)}, compiled=False)
    assert fit.error == pytest.approx(0, abs=1e-6 * np.abs(y).max())


def test_a_symbol_has_no_value() -> None:
    x = argument("x0")
    refused: tuple[Callable[[Any], Any], ...] = (
        lambda x: 1 if x > 0 else 2, lambda x: bool(x == 1), lambda x: max(x, 1), float, len,
        list, np.asarray, np.mean,
    )  # fmt: skip
    for function in refused:
        with pytest.raises(NotAFormulaError):
            trace(function, x)
    assert trace(lambda x: 3, x).number == 3


def test_a_long_chain_of_choices_has_derivatives() -> None:
    """As a table that is looked up: no deeper than Python's stack, nor doubled by each choice."""
    x, p = argument("x0"), argument("p0")
    table: Any = p
    for k in range(1500):
        table = np.where(x > k, k * p, table)
    through: Any = p
    for k in range(200):
        through = np.where(x > k, 2 * through, through)
    for graph, expected in ((table, 1499.0), (through, 2.0**200)):
        (slope,) = gradient(graph, [p])
        assert len(ordered([slope])) < 10_000
        value = written("slope", {"x": ["x0"], "p": ["p0"]}, [slope], single=True)
        assert value((5000.0,), (1.0,)) == expected


FINITE: dict[str, tuple[Callable[..., Any], dict[str, float], dict[str, tuple[float, float]]]] = {
    "a logistic that overflows": (
        lambda t, a, b, c: a / (1 + np.exp(-b * (300 * t - c))),
        {"a": 2.0, "b": 0.02, "c": 400.0}, {"a": (0, 5), "b": (0, 10), "c": (0, 900)},
    ),
    "an arc of what is clamped": (
        lambda t, a, b: b * np.arcsin(np.minimum(a * t, 1.0)),
        {"a": 0.7, "b": 2.0}, {"a": (0.1, 5), "b": (0, 9)},
    ),
    "a power at 0": (
        lambda t, a, b: a * t**b, {"a": 0.7, "b": 1.6}, {"a": (0.1, 5), "b": (0.1, 9)},
    ),
    "a root at 0": (
        lambda t, a, b: b * np.sqrt(a * t), {"a": 0.7, "b": 1.6}, {"a": (0.1, 5), "b": (1.5, 1.7)},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FINITE)
def test_a_fit_needs_no_more_than_finite_values(name: str) -> None:
    """Where differences give a derivative, formulas must give one too, or leave it to them."""
    function, truth, box = FINITE[name]
    y = function(t, *truth.values())
    fit = miho.fit(function, t, y, box, compiled=False)
    assert fit.error <= 1e-6 * np.abs(y).max()


def test_a_negative_base_has_whole_powers() -> None:
    n = np.arange(12.0)
    fit = miho.fit(
        lambda n, c, r: c * r**n, n, 2 * (-0.7) ** n, {"c": (0, 5), "r": (-0.99, 0.99)},
        compiled=False,
    )  # fmt: skip
    assert fit.values == pytest.approx({"c": 2.0, "r": -0.7}, rel=1e-6)


def test_linear_parameters_are_found_and_bends_are_not_taken_for_lines() -> None:
    a, b, c, x = (argument(name) for name in ("p0", "p1", "p2", "x0"))
    cases: dict[str, tuple[Any, list[int]]] = {
        "a peak": (a * np.exp(-b * x) + c, [0, 2]),
        "a product": (a * (x + b) + c, [0, 2]),
        "a sign": (a + b * np.sign(x - c), [0, 1]),
        "a choice by an input": (np.where(x > 1, a * x, b) + c, [0, 1, 2]),
        "a choice by a parameter": (np.where(x > c, a * x, b), [0, 1]),
        "a bend": (np.minimum(a * x, 1) + b, [1]),
        "none": (np.exp(a + b) * np.exp(c), []),
    }
    for name, (graph, expected) in cases.items():
        assert jointly_linear(graph, [a, b, c], gradient(graph, [a, b, c])) == expected, name


@needs_machine
def test_choices_on_the_machine_are_those_of_numpy() -> None:
    """The two orders of the sum over rows differ by a few roundings."""

    def choices(t: Any, a: Any, b: Any, c: Any) -> Any:
        return np.where((t > a) & ~(t > 2.5), np.clip(b * t, 0.5, c), np.sign(t - b)) + a * (t < 1)

    y = choices(t, 1.0, 1.2, 0.5)
    space = miho.Space(tuple(miho.Parameter(name, "", 0.1, 3) for name in "abc"))
    dataset = miho.Dataset("choices", {"t": t, "y": y}, {"t": "", "y": ""}, "y")
    model = FunctionModel(choices, columns=("t",))
    fast, numpy = (miho.CurveFit(model, dataset, space, compiled=c) for c in (True, False))
    assert fast.kernel is not None
    assert numpy.kernel is None
    np.testing.assert_allclose(fast.loss(THETAS), numpy.loss(THETAS), rtol=1e-13)


def test_a_piecewise_line_is_found_with_its_break() -> None:
    """By derivatives of either piece, from the truth's rows without noise."""
    rows = np.linspace(0, 3, 200)

    def line(t: Any, a: Any, b: Any, at: Any) -> Any:
        return np.where(t < at, a * t, a * at + b * (t - at))

    box = {"a": (-5, 5), "b": (-5, 5), "at": (0, 3)}
    fit = miho.fit(line, rows, line(rows, 2.0, -1.0, 1.234), box, compiled=False)
    assert fit.values == pytest.approx({"a": 2.0, "b": -1.0, "at": 1.234}, rel=1e-6)
