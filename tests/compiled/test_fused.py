"""The compiled loss, residuals and derivatives against NumPy's."""

from __future__ import annotations

import os
import signal
import warnings
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from numba.extending import overload
from numpy.typing import NDArray
from scipy.optimize import curve_fit

from miho import MIHO, Budget, CurveFit, Dataset, Parameter, Space, minimize
from miho.compiled.fused import FusedLoss
from miho.compiled.kernel import Formula
from miho.models import Model, Pacejka, PacejkaCurvature, TorqueCubic
from miho.models.expression import Expression
from miho.optim import MIHOGN
from miho.optim.problem import mean_square

Array = NDArray[np.float64]

RELATIVE = 1e-12
"""Sine and arctangent are a few 1e-16 from NumPy's; C up to 200 multiplies the angle's error."""

B, C, D = ("B", 0, 200), ("C", 0, 200), ("D", 500, 10_000)
SX, SY = ("Sx", -0.1, 0.1), ("Sy", -1000, 1000)
TIRE = Pacejka(), (-0.25, 0.25), [B, C, D, SX, SY]
WIDE = [
    pytest.param(*TIRE, id="tire"),
    pytest.param(
        PacejkaCurvature(), (-0.25, 0.25), [B, C, D, ("E", -10, 1), SX, SY],
        id="tire with curvature", marks=pytest.mark.slow,
    ),
    pytest.param(
        TorqueCubic(), (50, 700), [(f"p{k}", -1000, 1000) for k in range(4)],
        id="engine", marks=pytest.mark.slow,
    ),
]  # fmt: skip
"""Each model takes seconds to compile."""
ROWS = [1, 7, 63, 64, 65, 511, 1500]


def space_of(model: Model, box: list[tuple[str, float, float]]) -> Space:
    return Space(tuple(Parameter(n, model.parameters[n], low, high) for n, low, high in box))


def fused(
    model: Expression, between: tuple[float, float], rows: int = 700, threads: int = 1
) -> FusedLoss:
    rng = np.random.default_rng(rows)
    x = rng.uniform(*between, rows)
    return FusedLoss(model, x[None], 2000 * rng.standard_normal(rows), rng.permutation(rows),
                     threads)  # fmt: skip


def by_numpy(loss: FusedLoss, thetas: Array) -> Array:
    return mean_square(loss.model.predict(thetas, *loss.X) - loss.y)


@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize(("model", "between", "box"), WIDE)
def test_losses_are_numpys(
    model: Expression,
    between: tuple[float, float],
    box: list[tuple[str, float, float]],
    rows: int,
) -> None:
    """One row's residual may cancel to nearly 0: its loss is exact to the scale of its terms."""
    loss = fused(model, between, rows)
    thetas = space_of(model, box).sample(200, np.random.default_rng(1), "uniform")
    expected = by_numpy(loss, thetas)
    terms = mean_square(np.abs(model.predict(thetas, *loss.X)) + np.abs(loss.y))
    scale = expected if rows > 7 else terms
    assert (np.abs(loss.losses(thetas) - expected) <= RELATIVE * scale).all()


@pytest.mark.parametrize(("model", "between", "box"), WIDE)
def test_residuals_and_derivatives_are_numpys(
    model: Expression, between: tuple[float, float], box: list[tuple[str, float, float]]
) -> None:
    """To the scale of the terms that cancel: the largest of a column, or of output and data."""
    loss = fused(model, between, 1500)
    for theta in space_of(model, box).sample(50, np.random.default_rng(2), "uniform"):
        residuals = model.predict(theta[None], *loss.X)[0] - loss.y
        scale = np.abs(residuals).max() + np.abs(loss.y).max()
        np.testing.assert_allclose(loss.residuals(theta), residuals, rtol=0, atol=RELATIVE * scale)
        expected, derivatives = model.jacobian(theta, *loss.X), loss.jacobian(theta)
        assert derivatives.shape == expected.shape
        assert (np.abs(derivatives - expected) <= RELATIVE * np.abs(expected).max(axis=0)).all()


@pytest.mark.parametrize("threads", [1, 2, 3, 5])
@pytest.mark.parametrize("rows", [7, 700])
def test_a_loss_is_the_same_bits_alone_in_a_batch_and_on_any_threads(
    rows: int, threads: int
) -> None:
    model, between, box = TIRE
    thetas = space_of(model, box).initial(101)
    alone = [fused(model, between, rows).losses(theta[None])[0] for theta in thetas]
    several = fused(model, between, rows, threads)
    assert several.losses(thetas).tolist() == alone
    assert several.losses(thetas[40:43]).tolist() == alone[40:43]
    assert several.losses(thetas[::3]).tolist() == alone[::3]
    assert several.losses(thetas[:0]).shape == (0,)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_fork_has_threads_of_its_own() -> None:
    model, between, box = TIRE
    thetas = space_of(model, box).initial(200)
    loss = fused(model, between, 700, 2)
    losses = loss.losses(thetas).tolist()
    child = os.fork()
    if child == 0:
        signal.alarm(20)  # which ends it where it waits for its parent's threads
        os._exit(0 if loss.losses(thetas).tolist() == losses else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_the_callers_arrays_are_left_alone() -> None:
    loss = fused(*TIRE[:2])
    X, y = loss.X.copy(), loss.y.copy()
    thetas = space_of(loss.model, TIRE[2]).initial(5)
    thetas.flags.writeable = False
    loss.losses(thetas)
    loss.residuals(thetas[0])
    loss.jacobian(thetas[0])
    assert np.array_equal(loss.X, X)
    assert np.array_equal(loss.y, y)


def test_what_is_not_finite_stays_so() -> None:
    model, between, _ = TIRE
    good = fused(model, between)
    theta = np.array([[12.0, 1.4, 3000.0, 0.01, 80.0]])
    for bad, expected in ((np.nan, np.nan), (np.inf, np.inf)):
        for row in (0, 100, 699):
            y = good.y.copy()
            y[row] = bad
            loss = FusedLoss(model, good.X, y, good.order)
            assert np.array_equal(loss.losses(theta), [expected], equal_nan=True)
            assert np.array_equal(np.abs(loss.residuals(theta[0]))[row], bad, equal_nan=True)
    huge = np.tile(theta, (4, 1))
    huge[0, 2] = 1e200
    huge[1, 0] = np.nan
    huge[2, 1] = np.inf
    losses = good.losses(huge)
    assert losses[0] == np.inf
    assert np.isnan(losses[1:3]).all()
    assert losses[3] == good.losses(theta)[0]


@dataclass(frozen=True)
class Plane(Expression):
    """y = a x + b z + c x z^2: several inputs."""

    inputs = MappingProxyType({"x": "1", "z": "1"})
    parameters = MappingProxyType({"a": "1", "b": "1", "c": "1"})
    output = "1"

    @property
    def value(self) -> Formula:
        return lambda i, t: t[0] * i[0] + t[1] * i[1] + t[2] * i[0] * i[1] * i[1]

    @property
    def derivatives(self) -> Formula:
        return lambda i, t: (i[0] * 1, i[1] * 1, i[0] * i[1] * i[1])


def test_several_inputs() -> None:
    rng = np.random.default_rng(3)
    loss = FusedLoss(Plane(), rng.random((2, 900)), rng.random(900), rng.permutation(900))
    thetas = rng.standard_normal((20, 3))
    np.testing.assert_allclose(loss.losses(thetas), by_numpy(loss, thetas), rtol=RELATIVE)
    np.testing.assert_allclose(loss.jacobian(thetas[0]), loss.model.jacobian(thetas[0], *loss.X))


@dataclass(frozen=True)
class Sum(Expression):
    """y = a_1 x_1 + ... + a_p x_p + c: derivatives that are the inputs, and a number."""

    p: int

    @property
    def inputs(self) -> dict[str, str]:  # type: ignore[override]
        return {f"x{k}": "1" for k in range(self.p)}

    @property
    def parameters(self) -> dict[str, str]:  # type: ignore[override]
        return {**{f"a{k}": "1" for k in range(self.p)}, "c": "1"}

    output = "1"

    @property
    def value(self) -> Formula:
        if self.p == 1:
            return lambda i, t: t[0] * i[0] + t[1]
        return lambda i, t: (
            t[0] * i[0] + t[1] * i[1] + t[2] * i[2] + t[3] * i[3] + t[4] * i[4] + t[5]
        )

    @property
    def derivatives(self) -> Formula:
        return (
            (lambda i, t: (i[0], 1))
            if self.p == 1
            else (lambda i, t: (i[0], i[1], i[2], i[3], i[4], 1.0))
        )


@pytest.mark.parametrize("p", [1, pytest.param(5, marks=pytest.mark.slow)])
def test_derivatives_may_be_inputs_of_any_number(p: int) -> None:
    """A line of one input and of five, whose least squares are known in closed form."""
    rng, model = np.random.default_rng(5), Sum(p)
    X, y = rng.standard_normal((p, 700)), rng.standard_normal(700)
    columns = dict(zip([*model.inputs, "y"], [*X, y], strict=True))
    data = Dataset("sum", columns, dict.fromkeys(columns, "1"), "y")
    space = Space(tuple(Parameter(name, "1", -2, 2) for name in model.parameters))
    problem = CurveFit(model, data, space)
    theta = space.initial(1)[0]
    A = np.vstack([X, np.ones(700)]).T
    np.testing.assert_array_equal(problem.jacobian(theta), A)
    np.testing.assert_allclose(problem.residuals(theta), A @ theta - y, atol=1e-14)
    best, squares = np.linalg.lstsq(A, y)[:2]
    record = minimize(MIHOGN(), problem)
    np.testing.assert_allclose(record.theta, best, rtol=0, atol=1e-8)
    assert record.loss == pytest.approx(squares[0] / 700, rel=1e-12)


@dataclass(frozen=True)
class Plain(Model):
    """The tire model as any other model is written: with NumPy, and not as an expression."""

    inputs = Pacejka.inputs
    parameters = Pacejka.parameters
    output = "N"
    linear = ("D", "Sy")

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        B, C, D, Sx, Sy = thetas.T[:, :, None]
        return np.asarray(D * np.sin(C * np.arctan(B * (Sx - inputs[0]))) + Sy)

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        return Pacejka().jacobian(theta, *inputs)


def test_a_model_that_is_no_expression_goes_the_way_of_numpy() -> None:
    loss = fused(*TIRE[:2])
    units = {"alpha": "rad", "Fy": "N"}
    data = Dataset("d", {"alpha": loss.X[0], "Fy": loss.y}, units, "Fy")
    space = space_of(Pacejka(), TIRE[2])
    plain, compiled = (
        CurveFit(model, data, space, label="one problem") for model in (Plain(), Pacejka())
    )
    assert plain.kernel is None
    assert compiled.kernel.climb is not None
    thetas = space.initial(300)
    np.testing.assert_allclose(compiled.loss(thetas), plain.loss(thetas), rtol=RELATIVE)
    theta = thetas[0]
    np.testing.assert_allclose(compiled.residuals(theta), plain.residuals(theta), atol=1e-8)
    np.testing.assert_allclose(compiled.jacobian(theta), plain.jacobian(theta), atol=1e-6)
    short = Budget(evaluations=300)
    records = [minimize(MIHO(R=30, eta=3), fit, short) for fit in (plain, compiled)]
    assert records[0].evaluations == records[1].evaluations
    assert records[0].loss == pytest.approx(records[1].loss, rel=1e-9)


def test_equal_models_share_one_compilation() -> None:
    x = np.linspace(50, 700, 100)
    thetas = np.random.default_rng(4).uniform(-100, 100, (5, 4))
    first, second, other = (
        FusedLoss(TorqueCubic(omega_max), x[None], x, np.arange(100))
        for omega_max in (650.0, 650.0, 600.0)
    )
    assert first._compiled is second._compiled
    assert first._compiled is not other._compiled
    for loss in (first, second):  # another compilation would take a second
        np.testing.assert_allclose(loss.losses(thetas), by_numpy(loss, thetas), rtol=RELATIVE)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("model", "between", "box"), WIDE)
def test_the_first_rows_are_numpys(
    model: Expression,
    between: tuple[float, float],
    box: list[tuple[str, float, float]],
    threads: int,
) -> None:
    """From 7 rows on, as the residual of a single row may cancel to nearly 0."""
    loss = fused(model, between, 1500, threads)
    thetas = space_of(model, box).sample(200, np.random.default_rng(6), "uniform")
    whole = loss.losses(thetas)
    for rows in (7, 19, 64, 500, 1499):
        part = loss.order[:rows]
        expected = mean_square(model.predict(thetas, loss.X[0, part]) - loss.y[part])
        np.testing.assert_allclose(loss.losses(thetas, rows), expected, rtol=RELATIVE)
    assert loss.losses(thetas, 1500).tolist() == whole.tolist()


def shifted(x: Any) -> Any:
    """As NumPy sees it, and no formula can be traced through it."""
    return np.asarray(x)


@overload(shifted)
def _as_compiled(x: Any) -> Any:
    def compiled(x: Any) -> Any:
        return x + SHIFT

    return compiled


SHIFT = 1e-3


@pytest.mark.parametrize("wrong", ["value", pytest.param("derivatives", marks=pytest.mark.slow)])
def test_compiled_values_that_are_not_numpys_are_not_used(wrong: str) -> None:
    class Shifted(Expression):
        inputs = MappingProxyType({"x": "1"})
        parameters = MappingProxyType({"a": "1", "b": "1"})
        output = "1"

        @property
        def value(self) -> Formula:
            if wrong == "value":
                return lambda i, t: t[0] * np.exp(-t[1] * shifted(i[0]))
            return lambda i, t: t[0] * np.exp(-t[1] * i[0])

        @property
        def derivatives(self) -> Formula:
            if wrong == "value":
                return lambda i, t: (
                    np.exp(-t[1] * i[0]),
                    -t[0] * i[0] * np.exp(-t[1] * i[0]),
                )
            return lambda i, t: (
                np.exp(-t[1] * shifted(i[0])),
                -t[0] * i[0] * np.exp(-t[1] * i[0]),
            )

    x = np.linspace(0, 2, 300)
    y = 2 * np.exp(-1.5 * x) + 0.01 * np.cos(40 * x)
    data = Dataset("d", {"x": x, "y": y}, {"x": "1", "y": "1"}, "y")
    space = Space((Parameter("a", "1", 0, 5), Parameter("b", "1", 0, 5)))
    problem = CurveFit(Shifted(), data, space)
    theta = np.array([2.5, 1.0])
    with pytest.warns(UserWarning, match=r"Shifted: rows: compiled .* where NumPy gives .* at \["):
        assert problem.kernel.rows is None
    for kind in ["losses", "residuals"] if wrong == "value" else ["jacobian"]:
        of_numpy = {
            "losses": lambda: np.mean((problem.model.predict(theta[None], x) - y) ** 2, axis=1),
            "residuals": lambda: problem.model.predict(theta[None], x)[0] - y,
            "jacobian": lambda: problem.model.jacobian(theta, x),
        }[kind]
        with pytest.warns(UserWarning, match=f"Shifted: {kind}: compiled"):
            values = (
                problem.loss(theta[None]) if kind == "losses" else getattr(problem, kind)(theta)
            )
        np.testing.assert_allclose(values, of_numpy(), rtol=1e-14)
    truth, _ = curve_fit(lambda x, a, b: a * np.exp(-b * x), x, y, [2, 1.5])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        record = minimize(MIHOGN(), problem)
    np.testing.assert_allclose(record.theta, truth, rtol=1e-6)


def test_what_cancels_is_compared_to_its_rounding() -> None:
    """Two terms of 1e12 leave 1: NumPy and compiled code differ by 1e-4 of that, and are right."""

    class Cancelling(Expression):
        inputs = MappingProxyType({"x": "1"})
        parameters = MappingProxyType({"a": "1", "b": "1"})
        output = "1"
        value = property(
            lambda self: lambda i, t: 1e12 * np.exp(t[0] * i[0]) - 1e12 * np.exp(t[1] * i[0] * 1.0)
        )
        derivatives = property(
            lambda self: (
                lambda i, t: (1e12 * i[0] * np.exp(t[0] * i[0]), -1e12 * i[0] * np.exp(t[1] * i[0]))
            )
        )

    x = np.linspace(0, 1, 50)
    data = Dataset("d", {"x": x, "y": x}, {"x": "1", "y": "1"}, "y")
    space = Space((Parameter("a", "1", 1, 1 + 1e-12), Parameter("b", "1", 1, 1 + 1e-12)))
    assert CurveFit(Cancelling(), data, space).kernel.rows is not None
