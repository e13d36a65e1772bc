"""Residuals of robust losses and priors on the machine, compared with NumPy."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import miho
from miho.core import machine
from miho.data import Dataset
from miho.identification import Cauchy, CurveFit, Huber
from miho.identification.residuals import Loss, Square
from miho.models import FunctionModel
from miho.optim import Parameter, Space

pytestmark = pytest.mark.skipif(machine() is None, reason="needs the machine")

Array = NDArray[np.float64]

T = np.linspace(0.0, 2.0, 40)
Y = 2.0 * np.exp(-1.5 * T) + 0.05 * np.random.default_rng(1).standard_normal(T.size)
Y[::9] += 1.0
SIGMA = 0.05 * (1 + T)
A = Parameter("a", "", 0.0, 5.0, prior=(1.8, 0.1))
LOG = Parameter("k", "", 0.1, 10.0, scale="log", prior=(1.4, 0.2))
PLAIN = Parameter("a", "", 0.0, 5.0), Parameter("k", "", 0.1, 10.0)
TIED = Parameter("k", "", 0.1, 10.0, tied="a / 2 + 0.5", prior=(1.4, 0.2))


def decay(t: Array, a: float, k: float) -> Any:
    """A decay."""
    return a * np.exp(-k * t)


def problem_of(
    parameters: tuple[Parameter, ...], rho: Loss, weighted: bool, compiled: bool = True
) -> CurveFit:
    columns = {"t": T, "y": Y, "s": SIGMA}
    model = FunctionModel(decay, columns=("t",))
    return CurveFit(
        model,
        Dataset("decay", columns, dict.fromkeys(columns, ""), "y"),
        Space(parameters),
        rho,
        sigma="s" if weighted else 0.05,
        compiled=compiled,
    )


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize(
    ("parameters", "rho"),
    [
        (PLAIN, Huber(0.1)),
        (PLAIN, Cauchy(0.1)),
        ((A, LOG), Square()),
        ((PLAIN[0], LOG), Square()),
        ((A, TIED), Square()),
    ],
)
def test_residuals_and_derivatives_are_those_of_numpy(
    parameters: tuple[Parameter, ...], rho: Loss, weighted: bool
) -> None:
    """Up to some roundings of terms of the size of the data, 1e-12."""
    problem, by_numpy = (
        problem_of(parameters, rho, weighted, compiled) for compiled in (True, False)
    )
    assert problem.kernel is not None and by_numpy.kernel is None
    taped = problem.kernel.taped
    assert problem.machine_rows is not None
    for theta in problem.space.decode(problem.space.initial(5)):
        residuals, slopes = by_numpy.residuals(theta), by_numpy.jacobian(theta)
        size = max(1.0, np.abs(residuals).max())
        np.testing.assert_allclose(taped.residuals(theta[None])[0], residuals, atol=1e-12 * size)
        np.testing.assert_allclose(
            taped.jacobian(theta), slopes, rtol=1e-10, atol=1e-12 * np.abs(slopes).max()
        )
        losses = problem.loss(theta[None]), by_numpy.loss(theta[None])
        np.testing.assert_allclose(*losses, rtol=1e-12)


@pytest.mark.parametrize("rho", [Huber(0.1), Cauchy(0.1)])
def test_a_residual_of_zero_has_the_derivative_of_the_model(rho: Loss) -> None:
    columns = {"t": T, "y": decay(T, 2.0, 1.5), "s": SIGMA}
    model = FunctionModel(decay, columns=("t",))
    data = Dataset("decay", columns, dict.fromkeys(columns, ""), "y")
    problem = CurveFit(model, data, Space(PLAIN), rho, sigma=0.05)
    assert problem.kernel is not None
    theta = np.array([2.0, 1.5])
    np.testing.assert_allclose(
        problem.kernel.taped.jacobian(theta), problem.error_slopes(theta), rtol=1e-12
    )  # some roundings; residuals of 1e-16 do not bend the losses


class Roots(Loss):
    """rho = |r|, which the machine does not know."""

    def transform(self, residuals: Array) -> Array:
        return np.asarray(np.sign(residuals) * np.sqrt(np.abs(residuals)))

    def influence(self, residuals: Array) -> tuple[Array, Array]:
        return np.sign(residuals) / 2, np.zeros_like(residuals)


def test_a_loss_of_the_user_is_not_on_the_machine() -> None:
    problem = problem_of(PLAIN, Roots(), weighted=False)
    assert problem.kernel is None and problem.machine_rows is None
    theta = np.array([2.0, 1.5])
    expected = Roots().transform(problem.errors(theta))
    np.testing.assert_array_equal(problem.residuals(theta), expected)


@pytest.mark.parametrize("loss", ["huber", "cauchy", None])
def test_a_search_by_the_machine_decides_as_one_by_numpy(loss: str | None) -> None:
    """The same descents end in the same optimum; 1e-6 is far below a standard error of 1e-2."""
    bounds = {"a": (0.0, 5.0), "k": Parameter("k", "", 0.1, 10.0, prior=(1.4, 0.2))}
    space = bounds if loss is None else {"a": (0.0, 5.0), "k": (0.1, 10.0)}
    fit, by_numpy = (
        miho.fit(decay, T, Y, space, sigma=0.05, loss=loss, compiled=compiled)
        for compiled in (True, False)
    )
    assert fit.problem.kernel is not None and by_numpy.problem.kernel is None
    assert fit.descents is not None and by_numpy.descents is not None
    assert fit.descents.started == by_numpy.descents.started
    np.testing.assert_allclose(fit.theta, by_numpy.theta, rtol=1e-6)
    near = {name: 1.1 * value for name, value in fit.values.items()}
    by_start = miho.fit(decay, T, Y, space, start=near, sigma=0.05, loss=loss)
    np.testing.assert_allclose(by_start.theta, fit.theta, rtol=1e-6)
