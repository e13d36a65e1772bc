"""Least-squares problems of the machine, and the same ones whose residuals come from Python."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from miho.compiled.kernel import Formula
from miho.data import Dataset
from miho.identification import CurveFit
from miho.models.expression import Expression
from miho.optim import LeastSquaresProblem, Parameter, Space

Array = NDArray[np.float64]


def value(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> Any:
    a, b, c = theta
    return a * np.exp(-b * inputs[0]) + c


def derivatives(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> tuple[Any, ...]:
    a, b, _ = theta
    decay = np.exp(-b * inputs[0])
    return decay, -a * inputs[0] * decay, 1.0 + 0.0 * decay


@dataclass(frozen=True)
class Decay(Expression):
    """a exp(-b t) + c, linear in a and c, or not said to be."""

    linear: tuple[str, ...] = ("a", "c")
    inputs = MappingProxyType({"t": "s"})
    parameters = MappingProxyType({"a": "V", "b": "1/s", "c": "V"})
    output = "V"

    @property
    def value(self) -> Formula:
        return value

    @property
    def derivatives(self) -> Formula:
        return derivatives


SPACE = Space(
    (
        Parameter("a", "V", 0.0, 100.0),
        Parameter("b", "1/s", 0.01, 100.0, scale="log"),
        Parameter("c", "V", -10.0, 10.0),
    )
)


def fit(
    N: int = 600,
    space: Space = SPACE,
    noise: float = 0.05,
    linear: tuple[str, ...] = ("a", "c"),
) -> CurveFit:
    """A decay with an offset in N noisy rows."""
    rng = np.random.default_rng(7)
    t = rng.uniform(0, 5, N)
    y = 2 * np.exp(-0.7 * t) + 0.3 + noise * rng.standard_normal(N)
    return CurveFit(
        Decay(linear), Dataset("decay", {"t": t, "y": y}, {"t": "s", "y": "V"}, "y"), space
    )


class Outside(LeastSquaresProblem):
    """A problem as it is, but without its kernel, which counts the rows it evaluates.

    `says_rows` is False for one that does not say how many there are. `requests` lists the
    configurations and the numbers of rows of all residuals.
    """

    def __init__(self, problem: LeastSquaresProblem, says_rows: bool = True) -> None:
        self.problem, self.name, self.space = problem, problem.name, problem.space
        self.linear, self.rounding, self.noise = problem.linear, problem.rounding, problem.noise
        self.resolution = problem.resolution
        self.rows = problem.rows if says_rows else None
        self.residual_rows = self.jacobian_rows = 0
        self.requests: list[tuple[Array, int]] = []

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        return self.problem.loss(thetas, fidelity)

    def cost(self, fidelity: float) -> float:
        return self.problem.cost(fidelity)

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        residuals = self.problem.residuals(theta, fidelity)
        self.residual_rows += residuals.size
        self.requests.append((theta.copy(), residuals.size))
        return residuals

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        jacobian = self.problem.jacobian(theta, fidelity)
        self.jacobian_rows += len(jacobian)
        return jacobian
