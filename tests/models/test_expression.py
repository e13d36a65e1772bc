"""Models that are one expression: shapes, and arrays of their own."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from miho.compiled.kernel import Formula
from miho.models.expression import Expression
from miho.testing import check_model
from miho.vehicle.models import Pacejka, PacejkaCurvature, TorqueCubic


@dataclass(frozen=True)
class Constant(Expression):
    """y = a, whatever x is: an expression that is as wide as its parameter alone."""

    inputs = MappingProxyType({"x": "1"})
    parameters = MappingProxyType({"a": "1"})
    output = "1"

    @property
    def value(self) -> Formula:
        return lambda inputs, theta: theta[0]

    @property
    def derivatives(self) -> Formula:
        return lambda inputs, theta: (inputs[0] * 0 + 1,)


@dataclass(frozen=True)
class Echo(Expression):
    """y = x, whatever a is: an expression that is as wide as its input alone."""

    inputs = MappingProxyType({"x": "1"})
    parameters = MappingProxyType({"a": "1"})
    output = "1"

    @property
    def value(self) -> Formula:
        return lambda inputs, theta: inputs[0]

    @property
    def derivatives(self) -> Formula:
        return lambda inputs, theta: (inputs[0] * 0,)


@pytest.mark.parametrize("model", [Constant(), Echo()])
@pytest.mark.parametrize(("n", "N"), [(1, 1), (3, 1), (1, 4), (3, 4)])
def test_outputs_are_as_wide_as_they_must_be_and_the_callers_own(
    model: Expression, n: int, N: int
) -> None:
    thetas, x = np.arange(1.0, n + 1)[:, None], np.linspace(0, 1, N)
    before = thetas.copy(), x.copy()
    values = model.predict(thetas, x)
    expected = np.tile(thetas, N) if isinstance(model, Constant) else np.tile(x, (n, 1))
    assert np.array_equal(values, expected)
    values += 1
    assert np.array_equal(thetas, before[0])
    assert np.array_equal(x, before[1])


MODELS: list[tuple[Expression, list[float]]] = [
    (Pacejka(), [12.0, 1.4, 3000.0, 0.01, 80.0]),
    (PacejkaCurvature(), [12.0, 1.4, 3000.0, -0.7, 0.01, 80.0]),
    (TorqueCubic(0.5), [20.0, 300.0, -100.0, -50.0]),
]


@pytest.mark.parametrize(("model", "theta"), MODELS)
def test_expressions_are_models_with_derivatives(model: Expression, theta: list[float]) -> None:
    thetas = np.array(theta) * np.array([[1.0], [1.1], [0.7]])
    check_model(model, thetas, np.linspace(-0.3, 0.3, 41))


@pytest.mark.parametrize(("model", "theta"), MODELS)
def test_derivatives_of_a_batch_are_those_of_its_rows(
    model: Expression, theta: list[float]
) -> None:
    thetas, x = np.array(theta) * np.array([[1.0], [1.1], [0.7]]), np.linspace(-0.3, 0.3, 41)
    batch = model.jacobian(thetas, x)
    assert batch.shape == (3, 41, len(theta))
    for row, jacobian in zip(thetas, batch, strict=True):
        assert np.array_equal(model.jacobian(row, x), jacobian)


def test_what_a_formula_needs_besides_is_in_its_closure() -> None:
    theta, omega = np.array([[20.0, 300.0, -100.0, -50.0]]), np.array([350.0])
    for omega_max in (700.0, 350.0):
        w = 350.0 / omega_max
        expected = 20 + 300 * w - 100 * w**2 - 50 * w**3
        torque: Any = TorqueCubic(omega_max).predict(theta, omega)[0, 0]
        assert torque == pytest.approx(expected, rel=1e-15)
