"""Derived quantities in closed form, and their errors by simulation."""

from dataclasses import replace

import numpy as np
import pytest

import miho
from miho.data import Dataset
from miho.identification import CurveFit, linearised, make_report
from miho.identification.derived import delta_method, derived
from miho.identification.refit import refit
from miho.optim import Parameter, Space
from miho.vehicle.data import sample_tir
from miho.vehicle.models import Pacejka

THETA = np.array([12.0, 1.7, 4000.0, -0.005, 150.0])
SPACE = Space(
    (
        Parameter("B", "1/rad", 2, 40),
        Parameter("C", "-", 1, 2.5),
        Parameter("D", "N", 1000, 9000),
        Parameter("Sx", "rad", -0.05, 0.05),
        Parameter("Sy", "N", -900, 900),
    )
)


def values(theta: np.ndarray = THETA) -> dict[str, float]:
    found = derived(Pacejka(), sample_tir("lf", 500, 0))
    return {quantity.name: float(quantity.evaluate(theta[None])[0]) for quantity in found}


def test_a_tire_in_closed_form() -> None:
    """Peaks are read from a grid with a parabola: 1e-4 of the slip, 1e-6 of the force."""
    B, C, D, Sx, Sy = THETA
    found = values()
    z = B * Sx
    slope = B * C * D * np.cos(C * np.arctan(z)) / (1 + z * z)  # from the derivative of Eq. 4
    assert found["cornering stiffness B C D (Eq. 14)"] == pytest.approx(B * C * D)
    assert found["cornering stiffness at zero slip"] == pytest.approx(slope, rel=1e-6)
    peak = np.tan(np.pi / (2 * C)) / B
    assert found["slip angle at peak, alpha > 0"] == pytest.approx(Sx + peak, rel=1e-4)
    assert found["slip angle at peak, alpha < 0"] == pytest.approx(Sx - peak, rel=1e-4)
    assert found["peak force, alpha > 0"] == pytest.approx(Sy - D, rel=1e-6)
    assert found["peak force, alpha < 0"] == pytest.approx(Sy + D, rel=1e-6)
    load = float(np.median(sample_tir("lf", 500, 0)["Fz"]))
    assert found[f"mean peak force over the median load, {load:.0f} N"] == pytest.approx(
        D / load, rel=1e-6
    )


def test_a_curve_that_keeps_rising_has_no_peak() -> None:
    found = values(np.array([3.0, 0.9, 4000.0, 0.0, 0.0]))
    assert np.isnan(found["slip angle at peak, alpha > 0"])
    assert np.isnan(found["peak force, alpha < 0"])


@pytest.mark.slow
def test_the_delta_method_agrees_with_repeated_experiments() -> None:
    """300 data sets know a standard deviation to 4 %; the tolerance is four times that."""
    rng = np.random.default_rng(0)
    estimates, errors = [], []
    for _ in range(300):
        alpha = rng.uniform(-0.2, 0.2, 200)
        force = Pacejka().predict(THETA[None], alpha)[0] + 150 * rng.standard_normal(200)
        units = {"alpha": "rad", "Fy": "N"}
        data = Dataset("simulated", {"alpha": alpha, "Fy": force}, units, "Fy")
        problem = CurveFit(Pacejka(), data, SPACE)
        at = linearised(problem, refit(problem, THETA).theta)
        rows = [delta_method(quantity, at) for quantity in derived(Pacejka(), data)]
        estimates.append([value for value, _ in rows])
        errors.append([error for _, error in rows])
    np.testing.assert_allclose(np.std(estimates, axis=0), np.mean(errors, axis=0), rtol=0.16)


def test_a_quantity_of_held_parameters_has_no_standard_error() -> None:
    """B, C and Sx end at bounds beyond which the truth is: the peak lies where they say."""
    rng = np.random.default_rng(0)
    alpha = rng.uniform(-0.2, 0.2, 200)
    force = Pacejka().predict(THETA[None], alpha)[0] + 150 * rng.standard_normal(200)
    data = Dataset("d", {"alpha": alpha, "Fy": force}, {"alpha": "rad", "Fy": "N"}, "Fy")
    ends = {"B": (2, 11), "C": (1, 1.6), "Sx": (0.001, 0.05)}
    parameters = tuple(
        replace(p, low=ends[p.name][0], high=ends[p.name][1]) if p.name in ends else p
        for p in SPACE.parameters
    )
    problem = CurveFit(Pacejka(), data, Space(parameters), compiled=False)
    theta = refit(problem, np.array([11, 1.6, 4000, 0.001, 0.0])).theta
    report = make_report(problem, theta, profiles=False)
    assert report.at.at_bound.tolist() == [True, True, False, True, False]
    errors = report.derived.set_index("quantity")["standard error"]
    assert np.isnan(errors["slip angle at peak, alpha > 0"])
    assert errors["peak force, alpha > 0"] > 1  # of D and Sy, which are not held
    sentence = "slip angle at peak, alpha > 0 depends only on parameters at a bound"
    assert any(note.startswith(sentence) for note in report.notes)


def test_a_tied_parameter_of_held_ones_has_no_standard_error() -> None:
    t = np.linspace(0, 2, 40)
    y = 2 * np.exp(-1.5 * t) + 0.05 * np.random.default_rng(0).standard_normal(40)
    bounds = {"a": (0, 5), "b": (0, 1), "c": (0, 9)}
    fit = miho.fit(
        lambda t, a, b, c: a * np.exp(-b * t) + 0 * c,
        t, y, bounds, tied={"c": "2 * b"}, start={"a": 1.0, "b": 0.5}, compiled=False,
    )  # fmt: skip
    assert fit.parameters.loc["c", "value"] == pytest.approx(2.0)
    assert np.isnan(fit.parameters.loc["c", "standard_error"])


def test_a_quantity_without_a_value_beyond_a_bound_has_its_error() -> None:
    """The root has none below 0, where c is held; the rest of K is known as `print(fit)` says."""
    t = np.linspace(0, 2, 40)
    y = 2 - 0.5 * t + 0.05 * np.random.default_rng(0).standard_normal(40)
    fit = miho.fit(
        lambda t, a, c, K: a + c * t + 0 * K,
        t, y, {"a": (0, 5), "c": (0, 1)}, tied={"K": "a + sqrt(c)"}, compiled=False,
    )  # fmt: skip
    assert fit.parameters.loc["c", "value"] == 0
    (row,) = fit.report(profiles=False).derived.to_dict("records")
    assert row["standard error"] == pytest.approx(fit.parameters.loc["K", "standard_error"])
    assert np.isfinite(row["standard error"])


def test_a_model_nobody_derives_anything_from() -> None:
    from tests.identification.published import puromycin

    problem = puromycin()
    assert derived(problem.model, problem.dataset) == ()
