"""`miho.fit`: a problem stated in one call, checked against SciPy and closed forms."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import curve_fit

import miho
from miho.models import Pacejka

DIGITS = 1e-6
"""Both descents end where a step changes the sum of squares by some 1e-10 of itself, which leaves
the parameters at the root of that, 1e-5 of a standard error; a standard error is some per cent."""
t = np.linspace(0, 2, 60)
noise = np.random.default_rng(1).standard_normal(60)


def decay(t, a, b):
    return a * np.exp(-b * t)


def two(t, a, b, c, d):
    return a * np.exp(-b * t) + c * np.exp(-d * t)


y = decay(t, 2.0, 1.5) + 0.05 * noise
BOX = {"a": (0, 5), "b": (0.01, 10)}


@pytest.mark.parametrize("compiled", [True, False])
def test_it_is_scipys_fit_without_a_start(compiled: bool) -> None:
    theta, covariance = curve_fit(decay, t, y, [1.0, 1.0], xtol=1e-12)
    fit = miho.fit(decay, t, y, BOX, compiled=compiled)
    assert list(fit.values.values()) == pytest.approx(theta, rel=DIGITS)
    errors = fit.parameters["standard_error"].to_numpy()
    assert errors == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-4)
    assert "brackets" in fit.optimum
    prediction = fit.predict([0.5, 1.0])
    gradient = np.array([np.exp(-theta[1] * 0.5), -0.5 * theta[0] * np.exp(-theta[1] * 0.5)])
    half = fit.uncertainty.quantile() * np.sqrt(gradient @ covariance @ gradient)
    assert prediction.high[0] - prediction.value[0] == pytest.approx(half, rel=1e-3)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("known", [True, False])
def test_sigma_of_each_row_is_scipys(compiled: bool, known: bool) -> None:
    sigma = np.where(t < 1, 0.02, 0.2)
    values = decay(t, 2.0, 1.5) + sigma * noise
    theta, covariance = curve_fit(
        decay, t, values, [1.0, 1.0], sigma, absolute_sigma=known, xtol=1e-12
    )
    fit = miho.fit(decay, t, values, BOX, sigma=sigma, sigma_known=known, compiled=compiled)
    assert list(fit.values.values()) == pytest.approx(theta, rel=DIGITS)
    errors = fit.parameters["standard_error"].to_numpy()
    assert errors == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-4)
    assert "weighted by sigma" in str(fit)
    by_name = miho.fit(
        decay, {"t": t, "V": values, "s": sigma}, "V", BOX, sigma="s", sigma_known=known
    )
    assert by_name.values == pytest.approx(fit.values, rel=DIGITS)


def test_a_known_sigma_that_the_errors_contradict_is_named() -> None:
    for factor, words in ((0.3, "too small, or the model is wrong"), (3.0, "sigma is too large")):
        fit = miho.fit(decay, t, y, BOX, sigma=0.05 * factor, compiled=False)
        assert any(words in note for note in fit.notes)
    fit = miho.fit(decay, t, y, BOX, sigma=0.05, compiled=False)
    assert not any("sigma" in note for note in fit.notes)


def test_a_profile_with_known_sigma_is_that_of_a_linear_model() -> None:
    """For y = a t the interval is a +- z sigma / sqrt(sum t^2), whatever the residuals are."""
    fit = miho.fit(lambda t, a: a * t, t, 3 * t + 0.1 * noise, {"a": (0, 9)}, sigma=0.5)
    row = fit.report().parameters.iloc[0]
    half = 1.959964 * 0.5 / np.sqrt(np.sum(t**2))
    assert (row["profile high"] - row["profile low"]) / 2 == pytest.approx(half, rel=2e-3)


def test_a_start_takes_the_place_of_bounds() -> None:
    theta, _ = curve_fit(decay, t, y, [1.0, 1.0], xtol=1e-12)
    fit = miho.fit(decay, t, y, start={"a": 1, "b": 1}, compiled=False)
    assert list(fit.values.values()) == pytest.approx(theta, rel=DIGITS)
    assert "one search" in fit.optimum


def test_tied_and_fixed_parameters_are_as_substituted_ones() -> None:
    """a (exp(-b t)) + (3 - a) exp(-(b + gap) t), written out and tied."""
    values = two(t, 1.0, 0.7, 2.0, 4.0) + 0.01 * noise
    frame = pd.DataFrame({"t": t, "V": values})
    box = {"a": (0, 5), "b": (0, 5), "gap": (0, 20)}
    tied = miho.fit(two, frame, "V", box, tied={"c": "3 - a", "d": "b + gap"}, compiled=False)

    def written(t, a, b, gap):
        return a * np.exp(-b * t) + (3 - a) * np.exp(-(b + gap) * t)

    plain = miho.fit(written, t, values, box, compiled=False)
    assert {k: tied.values[k] for k in box} == pytest.approx(plain.values, rel=1e-5)
    table = tied.parameters
    assert table.loc["c", "value"] == pytest.approx(3 - table.loc["a", "value"])
    assert table.loc["c", "standard_error"] == pytest.approx(table.loc["a", "standard_error"])
    b, gap = (list(plain.values).index(name) for name in ("b", "gap"))
    covariance = plain.uncertainty.covariance
    spread = np.sqrt(covariance[b, b] + covariance[gap, gap] + 2 * covariance[b, gap])
    assert table.loc["d", "standard_error"] == pytest.approx(spread, rel=1e-3)
    assert list(table["held"]) == ["free", "free", "= 3 - a", "= b + gap", "free"]
    fixed = miho.fit(two, frame, "V", box, fixed={"c": 2.0}, tied={"d": "b + gap"})
    assert fixed.parameters.loc["c", ["value", "standard_error", "held"]].tolist() == [
        2.0, 0.0, "fixed",
    ]  # fmt: skip


def test_a_model_of_ours_and_a_data_frame() -> None:
    alpha = np.linspace(-0.15, 0.15, 200)
    truth = np.array([12.0, 1.5, 4000.0, 0.002, 20.0])
    force = Pacejka().predict(truth[None], alpha)[0]
    frame = pd.DataFrame({"alpha": alpha, "Fy": force})
    box = {"B": (2, 40), "C": (1, 2), "D": (1e3, 1e4), "Sx": (-0.05, 0.05), "Sy": (-500, 500)}
    fit = miho.fit(Pacejka(), frame, "Fy", box)
    assert list(fit.values.values()) == pytest.approx(truth, rel=1e-6)
    assert fit.parameters["unit"].tolist() == ["1/rad", "-", "N", "rad", "N"]


def test_columns_may_stand_anywhere_and_be_called_as_parameters_are() -> None:
    frame = pd.DataFrame({"b": 0.0, "V": y, "t": t})
    swapped = miho.fit(lambda a, t, b: decay(t, a, b), frame, "V", BOX, compiled=False)
    assert swapped.values == pytest.approx(miho.fit(decay, t, y, BOX, compiled=False).values)
    with pytest.raises(ValueError, match="x has the columns b, V; none is an argument"):
        miho.fit(decay, frame[["b", "V"]], "V", BOX)


def test_errors_that_drift_widen_intervals_and_it_is_said() -> None:
    drift = np.zeros(60)
    for k in range(1, 60):  # a first-order autoregression of 0.9
        drift[k] = 0.9 * drift[k - 1] + 0.05 * noise[k]
    fit = miho.fit(decay, t, decay(t, 2.0, 1.5) + drift, BOX, compiled=False)
    assert "intervals allow for errors that depend" in str(fit)
    assert "intervals allow" not in str(miho.fit(decay, t, y, BOX, compiled=False))
    plain = fit.uncertainty.independent.standard_errors
    assert (fit.parameters["standard_error"].to_numpy() > 1.2 * plain).all()


def test_a_fit_is_pickled_printed_and_drawn() -> None:
    fit = miho.fit(decay, t, y, BOX, compiled=False)
    copy = pickle.loads(pickle.dumps(fit))
    assert str(copy) == str(fit)
    assert "<table" in fit._repr_html_()
    (ax,) = fit.plot().axes
    assert ax.get_xlabel() == "t"
    assert fit.report().parameters["value"].tolist() == pytest.approx(list(fit.values.values()))


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no bounds": ({"space": None}, "a has no bounds; give them, as in {'a': \\(0, 10\\)}"),
    "a bound short": ({"space": {"a": (0, 5)}}, "b has no bounds"),
    "one number": ({"space": {"a": (0, 5), "b": 3}}, "bounds of b are 3; expected"),
    "unknown": ({"space": {**BOX, "q": (0, 1)}}, "no parameter q, and none is tied|has q besides"),
    "fixed unknown": ({"fixed": {"c": 1}}, "fixed: c is no parameter; choose from a, b"),
    "a cycle": ({"tied": {"a": "b", "b": "a"}}, "cycle|every parameter"),
    "code": ({"tied": {"a": "__import__('os')"}}, "is not allowed; give numbers"),
    "an attribute": ({"tied": {"a": "b.real"}}, "'b.real' is not allowed"),
    "no expression": ({"tied": {"a": "1 +"}}, "'1 \\+' is no expression"),
    "a typing error": ({"tied": {"a": "2 * bb"}}, "no parameter bb; did you mean b"),
    "never": ({"space": {"a": (50, 60), "b": (0, 5)}, "tied": {"a": "2 * b"}}, "never 50 to 60"),
    "start short": ({"space": None, "start": {"a": 1}}, "b has no bounds|lacks b"),
    "lengths": ({"y": y[:3]}, "differ in length"),
    "no number": ({"y": np.where(t > 1, np.nan, y)}, "30 not finite"),
    "no column": ({"y": "W"}, "y is 'W', which is no column of x"),
    "sigma": ({"sigma": -1.0}, "sigma is -1.0; expected a number above 0"),
    "sigma 0": ({"sigma": np.zeros(60)}, "is 0 in row 1"),
    "sigma too small": ({"sigma": 1e-200}, "sigma is 1e-200; expected 1e-140 to"),
    "a row's sigma too small": ({"sigma": np.full(60, 1e-200)}, "is 1e-200 in row 1"),
    "a table for a column": ({"x": np.ones((60, 2))}, "t has the shape \\(60, 2\\); give a column"),
    "other labels": (
        {"x": pd.DataFrame({"t": t}), "y": pd.Series(y, index=range(1, 61))},
        "x, y and sigma have different row labels; align them",
    ),
    "a constraint": ({"constraints": "a < c"}, "'c' has no parameter c; choose from a, b"),
    "columns": ({"x": (t, t)}, "needs the parameters b; the space has a besides|has 2"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_does_not_fit_together_is_refused_in_a_line(case: str) -> None:
    changes, message = BAD[case]
    arguments = {"model": decay, "x": t, "y": y, "space": BOX, "compiled": False, **changes}
    with pytest.raises(ValueError, match=message) as caught:
        miho.fit(**arguments)
    assert "\n" not in str(caught.value)
