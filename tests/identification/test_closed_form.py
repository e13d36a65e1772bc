"""The closed-form optimum, against published answers and against a search."""

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

import miho
from experiments.app.build import build
from experiments.app.compose import composed
from miho import CurveFit, Dataset, Parameter, Space, minimize
from miho.identification import Huber, linear_optimum
from miho.methods.least_squares import LeastSquares
from miho.models import FunctionModel
from tests.identification.published import line, longley, misra1a

Array = NDArray[np.float64]


def polynomial(x, *, b0, b1, b2, b3, b4, b5):  # type: ignore[no-untyped-def]
    return b0 + x * (b1 + x * (b2 + x * (b3 + x * (b4 + x * b5))))


polynomial.__annotations__ = dict.fromkeys(("x", "b0", "b1", "b2", "b3", "b4", "b5", "return"), "-")


def wampler(base: float) -> CurveFit:
    """NIST StRD, Wampler1 (base 1) and Wampler2 (base 0.1): y = sum of (base x)^k, k = 0 ... 5."""
    x = np.arange(21.0)
    y = sum((base * x) ** k for k in range(6))
    names = [f"b{k}" for k in range(6)]
    model = FunctionModel(polynomial, linear=tuple(names))
    space = Space(tuple(Parameter(name, "-", -100, 100) for name in names))
    return CurveFit(model, Dataset("w", {"x": x, "y": y}, {"x": "-", "y": "-"}, "y"), space)


@pytest.mark.parametrize("base", [1.0, 0.1])
def test_certified_polynomials(base: float) -> None:
    """Two roundings of each model value, up to 3.4e6, move b1 = 1 by 3.3e-10 at most.

    That is the pseudo-inverse of the powers, in absolute values, times the roundings.
    """
    optimum = linear_optimum(wampler(base))
    assert optimum is not None
    theta, loss = optimum
    assert theta == pytest.approx(base ** np.arange(6), rel=4e-10)
    assert loss < 1e-18


def test_certified_plane() -> None:
    """Seven terms of up to 3.6e6: were each rounded for the worst, 1e-9 would be left."""
    optimum = linear_optimum(longley())
    assert optimum is not None
    certified = [-3482258.63459582, 15.0618722713733, -0.358191792925910e-1, -2.02022980381683,
                 -1.03322686717359, -0.511041056535807e-1, 1829.15146461355]  # fmt: skip
    assert optimum[0] == pytest.approx(certified, rel=1e-9)
    assert optimum[1] * 16 == pytest.approx(836424.055505915, rel=1e-11)


def test_a_line_by_hand() -> None:
    """Means 2 and 4.5, Sxx 14, Sxy 28.5."""
    x = np.array([0.0, 1.0, 2.0, 5.0])
    y = np.array([1.0, 2.5, 3.5, 11.0])
    optimum = linear_optimum(line(y, x))
    assert optimum is not None
    slope = 28.5 / 14
    assert optimum[0] == pytest.approx([4.5 - 2 * slope, slope], rel=1e-13)
    assert optimum[1] * 4 == pytest.approx(((y - 4.5) ** 2).sum() - 28.5**2 / 14, rel=1e-12)


def test_an_optimum_outside_the_box_is_the_best_inside() -> None:
    x = np.linspace(0, 1, 20)
    problem = line(3 + 5 * x + 0.1 * np.sin(40 * x), x, b=(-1.0, 2.0))
    optimum = linear_optimum(problem)
    assert optimum is not None
    assert optimum[0][1] == 2
    searched = minimize(LeastSquares(screen=50, starts=5, rounds=1), problem)
    assert optimum[1] == pytest.approx(searched.loss, rel=1e-9)
    assert optimum[1] <= searched.loss


def test_what_is_not_linear_has_none() -> None:
    assert linear_optimum(misra1a()) is None
    assert linear_optimum(line(np.ones(4), np.arange(4.0), Huber(1.0))) is None


def test_every_run_of_a_linear_model_knows_its_optimum() -> None:
    experiment = build(composed(["dataset=torque_15"]))
    data, model = experiment.problem.dataset, experiment.problem.model
    w = data["omega"] / model.omega_max
    fit = np.polynomial.Polynomial.fit(w, data[data.output], 3)
    rms = np.sqrt(np.mean((fit(w) - data[data.output]) ** 2))
    assert experiment.facts["optimum"] ** 0.5 == pytest.approx(rms, rel=1e-12)
    assert "optimum" not in build(composed(["dataset=tire_lf", "dataset.n=100"])).facts


@pytest.mark.parametrize("degree", [4, 5])
def test_powers_of_calendar_years_are_fitted_as_powers_of_scaled_years(degree: int) -> None:
    """The powers depend on each other to 1e-11 and 3e-14, of which a double leaves four digits
    and one; the curve and its band depend on them by 1e-16 divided by these."""
    names = "abcdef"[: degree + 1]
    x = np.linspace(1990, 2020, 61)
    scaled = (x - 2005) / 15
    y = 1 + scaled + scaled**2 + np.random.default_rng(0).normal(0, 0.1, x.size)
    terms = " + ".join(f"{name} * x**{k}" for k, name in enumerate(names))
    powers = eval(f"lambda x, {', '.join(names)}: {terms}")
    fit = miho.fit(powers, x, y, dict.fromkeys(names, (-1e12, 1e12)))
    value, low, high = fit.predict(x)
    basis, _ = np.linalg.qr(np.vander(scaled, degree + 1))
    expected = basis @ (basis.T @ y)
    variance = np.sum((y - expected) ** 2) / (x.size - degree - 1)
    reach = scipy.stats.t.ppf(0.975, x.size - degree - 1) * np.sqrt(variance * (basis**2).sum(1))
    assert value == pytest.approx(expected, abs=0.05 * reach.min())
    assert high - low == pytest.approx(2 * reach, rel=0.05)
    assert "linear in all parameters" in fit.optimum


def test_a_linear_function_that_raises_at_an_end_of_a_range_is_fitted() -> None:
    def broken(x: NDArray[np.float64], *, a: float, b: float) -> NDArray[np.float64]:
        if abs(a) > 9:
            raise RuntimeError("too far")
        return float(a) + float(b) * x

    x = np.linspace(-1, 1, 20)
    fit = miho.fit(FunctionModel(broken, linear=("a", "b")), x, 1 + 2 * x, start={"a": 0, "b": 0})
    assert fit.values == pytest.approx({"a": 1, "b": 2})
    assert "linear" not in fit.optimum


def test_the_end_of_a_search_is_not_its_closed_form() -> None:
    x = np.linspace(-1, 1, 20)
    fit = miho.fit(
        lambda x, a, b: a + b * x, x, 1 + 2 * x**2, {"a": (-9, 9), "b": (-9, 9)},
        method="random", budget=miho.Budget(20),
    )  # fmt: skip
    assert fit.problem.loss(fit.run[None])[0] > 1.01 * fit.problem.loss(fit.theta[None])[0]
