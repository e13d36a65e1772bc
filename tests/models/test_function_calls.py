"""How a user's function is called: side by side or alone, for all rows of data or for some."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import j0

from miho import CurveFit, Dataset, Parameter, Space
from miho.models import FunctionModel, function_calls
from miho.parallel import worth

THETAS = np.array([[2.0, 1.5], [0.5, 0.3], [1.2, 4.0]])
t = np.linspace(0, 2, 50)


@pytest.fixture(autouse=True)
def cheap(monkeypatch: pytest.MonkeyPatch) -> None:
    """All calls count as cheap, however busy the machine is."""
    monkeypatch.setattr(worth, "EXPENSIVE", math.inf)


def model(function: Callable[..., Any], **settings: Any) -> FunctionModel:
    return FunctionModel(function, columns=("t",), **settings)


def branching(t, a, b):
    return a * np.exp(-b * t) if a > 1 else 0


def looping(t, a, b):
    return [math.sqrt(a) * math.exp(-b * x) for x in t]


def cumulative(t, a, b):
    return np.cumsum(a * np.exp(-b * t))


def normalised(t, a, b):
    return a * np.exp(-b * t) / np.sum(np.exp(-b * t))


def greatest(t, a, b):
    return np.max([a, b]) * t


def parameterless(t, a, b):
    return t


@pytest.mark.parametrize(
    "function", [branching, looping, cumulative, normalised, greatest, parameterless]
)
def test_what_does_not_broadcast_is_called_row_by_row(function: Callable[..., Any]) -> None:
    """Some of these raise for columns of parameters, some give another shape, some other values."""
    expected = [np.broadcast_to(function(t, *theta), 50) for theta in THETAS.tolist()]
    automatic = model(function)
    assert np.array_equal(automatic.predict(THETAS[:1], t), expected[:1])
    for _ in range(2):
        assert np.array_equal(automatic.predict(THETAS, t), expected)
    assert np.array_equal(automatic.predict(THETAS[:1], t), expected[:1])


@pytest.mark.parametrize("first", [1, 3])
def test_a_function_of_arrays_alone_gets_arrays(first: int) -> None:
    automatic = model(lambda t, a, b: a * np.exp(-b * t) + np.zeros(a.shape))
    expected = THETAS[:, :1] * np.exp(-THETAS[:, 1:] * t)
    assert np.array_equal(automatic.predict(THETAS[:first], t), expected[:first])
    assert np.array_equal(automatic.predict(THETAS, t), expected)


def test_one_that_broadcasts_is_compared_once_and_then_called_once() -> None:
    shapes = []

    def decay(t, a, b):
        shapes.append(np.shape(a))
        return a * np.exp(-b * t)

    automatic = model(decay)
    expected = THETAS[:, :1] * np.exp(-THETAS[:, 1:] * t)
    for _ in range(2):
        assert np.array_equal(automatic.predict(THETAS, t), expected)
    automatic.predict(THETAS[:1], t)
    assert shapes == [(), (), (), (3, 1), (3, 1), (1, 1)]
    many = np.repeat(THETAS, 100, axis=0)
    shapes.clear()
    assert np.array_equal(model(decay).predict(many, t), np.repeat(expected, 100, axis=0))
    assert shapes == [()] * function_calls.TRIED + [(300, 1)]


def test_a_expensive_function_is_never_called_to_compare(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worth, "EXPENSIVE", 0.0)
    shapes = []

    def decay(t, a, b):
        shapes.append(np.shape(a))
        if b == 4:
            raise RuntimeError("diverges")
        return a * np.exp(-b * t)

    automatic = model(decay)
    automatic.predict(THETAS[:1], t)
    automatic.predict(THETAS[:2], t)
    for rows in (slice(2, 3), slice(0, 3)):
        with pytest.raises(ValueError, match="decay raises RuntimeError: diverges"):
            automatic.predict(THETAS[rows], t)
    assert shapes == [()] * 7


def test_a_row_without_a_value_does_not_decide() -> None:
    """Numbers raise where arrays are infinite; in a function that branches they raise as well."""
    automatic = model(lambda t, a, b: a / b * t)
    values = automatic.predict(np.array([[1.0, 0.0], [1.0, 2.0]]), t[1:])
    assert np.isinf(values[0]).all()
    assert np.array_equal(values[1], t[1:] / 2)

    def branching(t, a, b):
        return a / b * t if a > 1 else 0 * t

    automatic = model(branching)
    with pytest.raises(ValueError, match="float division by zero"):
        automatic.predict(np.array([[2.0, 0.0], [1.0, 2.0]]), t)
    assert np.array_equal(automatic.predict(THETAS, t)[1:], [0 * t, 1.2 / 4 * t])


def test_rows_that_were_alike_by_chance_are_no_end() -> None:
    automatic = model(lambda t, a, b: a * t if np.ndim(a) == 0 or a.max() < 3 else float(a) * t)
    for thetas in (THETAS, 2 * THETAS, THETAS):
        assert np.array_equal(automatic.predict(thetas, t), thetas[:, :1] * t)
    assert automatic.predict(np.empty((0, 2)), t).shape == (0, 50)


ORDERED = {
    "a sum": cumulative,
    "a slope": lambda t, a, b: np.gradient(a * np.exp(-b * t), t),
    "a filter": lambda t, a, b: lfilter([0.1], [1, -0.9], a * np.exp(-b * t)),
    "a mean": lambda t, a, b: a * np.exp(-b * t) - np.exp(-b * t).mean(),
    "a first row": lambda t, a, b: a * np.exp(-b * (t - t[0])),
    "a last row": lambda t, a, b: a * np.exp(-b * t / t[-1]),
    "a largest value": lambda t, a, b: a * np.exp(-b * t / t.max()),
    "an order": lambda t, a, b: a * np.arange(50)[: t.size] ** b,
    "a column of its own": lambda t, a, b: a * np.linspace(0, 1, 50) ** b + 0 * t,
}


@pytest.mark.parametrize("name", ORDERED)
def test_what_depends_on_other_rows_needs_all_of_them(name: str) -> None:
    problem = _problem(model(ORDERED[name]))
    assert problem.model.ordered
    assert problem.rows is None
    theta = problem.space.decode(problem.space.initial(1))
    assert problem.loss(theta, 0.1) == problem.loss(theta)
    assert pickle.loads(pickle.dumps(model(cumulative, rowwise=True))).ordered is False


def test_what_is_element_by_element_is_known_to_be() -> None:
    """Also beside a column of two values, of which most rows are an end."""
    function = model(bessel)
    assert function.ordered
    known = _problem(function).model
    assert not known.ordered
    assert not pickle.loads(pickle.dumps(known)).ordered
    two = FunctionModel(lambda t, s, a, b: bessel(t, a, b) * s, columns=("t", "s"))
    assert two.tried_at(THETAS, t, t > 1).tried.rowwise is True
    declared = model(bessel, rowwise=False, batched=True)
    assert declared.tried_at(THETAS, t) is declared
    assert model(bessel, rowwise=False).tried_at(THETAS, t).ordered


def test_nothing_is_known_of_three_rows_or_of_failures() -> None:
    function = model(bessel)
    assert function.tried_at(THETAS, t[:3]).tried == (True, None, False)
    failing = model(lambda t, a, b: 1 / 0)
    assert failing.tried_at(THETAS, t).tried == (None, None, False)
    partly = model(lambda t, a, b: bessel(t, a, b) if a < 1 else 1 / 0)
    assert partly.tried_at(THETAS, t).tried == (False, True, False)


def bessel(t, a, b):
    return a * j0(b * t)


def failing(t, a, b):
    raise RuntimeError("diverges")


def test_to_know_that_a_function_needs_all_rows_takes_two_calls() -> None:
    lengths = []

    def counted(t, a, b):
        lengths.append(t.size)
        return cumulative(t, a, b)

    tried = model(counted).tried_at(THETAS, t)
    assert lengths[:2] == [50, 25]
    assert set(lengths[2:]) == {50}
    assert tried.tried == (False, False, False)


@pytest.mark.parametrize("function", [bessel, failing])
def test_a_expensive_function_is_tried_twice_at_most(
    monkeypatch: pytest.MonkeyPatch, function: Callable[..., Any]
) -> None:
    monkeypatch.setattr(worth, "EXPENSIVE", 0.0)
    calls = []

    def counted(t, a, b):
        calls.append(a)
        return function(t, a, b)

    expensive = model(counted).tried_at(THETAS, t)
    assert expensive.ordered
    assert len(calls) == 2


def test_a_expensive_function_of_arrays_alone_gets_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """It fails at once for numbers, and takes long for arrays."""
    latest = []

    def expensive(t, a, b):
        latest[:] = [isinstance(a, np.ndarray)]
        return a * np.exp(-b * t) + np.zeros(a.shape)

    monkeypatch.setattr(function_calls, "is_expensive", lambda *_: latest[0])
    tried = model(expensive).tried_at(THETAS, t)
    expected = THETAS[:, :1] * np.exp(-THETAS[:, 1:] * t)
    assert np.array_equal(tried.predict(THETAS, t), expected)


def test_what_was_tried_is_not_tried_again() -> None:
    known = model(bessel).tried_at(THETAS, t)
    assert known.tried_at(THETAS, t) is known


def test_what_was_tried_is_known_in_other_processes() -> None:
    """They call the function as this one does, without another trial."""
    shapes = []

    def decay(t, a, b):
        shapes.append(np.shape(a))
        return a * np.exp(-b * t)

    known = model(decay).tried_at(THETAS, t)
    shapes.clear()
    same = replace(known)
    same.predict(THETAS, t)
    assert shapes == [(3, 1)]
    assert same.tried == known.tried == (True, True, False)


def _problem(function: FunctionModel) -> CurveFit:
    data = Dataset("d", {"t": t, "y": 2 * np.exp(-1.5 * t)}, {"t": "", "y": ""}, "y")
    return CurveFit(function, data, Space((Parameter("a", "", 0.1, 5), Parameter("b", "", 0.1, 9))))
