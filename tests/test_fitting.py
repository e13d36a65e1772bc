"""`miho.fit`: a problem stated in one call, checked against SciPy and closed forms."""

from __future__ import annotations

import inspect
import math
import pickle
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp
from scipy.optimize import curve_fit, least_squares

import miho
from miho.compiled.kernel import Formula
from miho.core import machine
from miho.identification.line_wrapping import with_digits
from miho.models import Trajectory
from miho.vehicle.data import embedded_tire
from miho.vehicle.models import Pacejka, PacejkaCurvature, TireFormula
from miho.vehicle.models.tir_reader import read_tir
from tests.optim.decays import Decay
from tests.printed import flat

DIGITS = 1e-6
"""Both descents end where a step changes the sum of squares by some 1e-10 of itself, which leaves
the parameters at the root of that, 1e-5 of a standard error; a standard error is some per cent."""
needs_machine = pytest.mark.skipif(machine() is None, reason="the machine was not built")
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
    assert "independent searches" in fit.optimum
    prediction = fit.predict([0.5, 1.0])
    gradient = np.array([np.exp(-theta[1] * 0.5), -0.5 * theta[0] * np.exp(-theta[1] * 0.5)])
    error = np.sqrt(gradient @ covariance @ gradient)
    for level, ends in ((0.95, prediction), (0.68, fit.predict([0.5], level=0.68))):
        half = fit.uncertainty.quantile(level) * error
        assert ends.high[0] - ends.value[0] == pytest.approx(half, rel=1e-3)
    with pytest.raises(ValueError, match=r"level is 95; expected a number between 0 and 1"):
        fit.predict([0.5], level=95)


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
    assert "weighted by sigma" in flat(fit)
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
    values = 3 * t + 0.1 * noise
    fit = miho.fit(lambda t, a: a * t, t, values, {"a": (0, 9)}, sigma=0.5, compiled=False)
    row = fit.report().parameters.iloc[0]
    half = 1.959964 * 0.5 / np.sqrt(np.sum(t**2))
    assert (row["profile high"] - row["profile low"]) / 2 == pytest.approx(half, rel=2e-3)


WITHOUT_MACHINE = """
import sys
sys.modules["miho.core._machine"] = None  # as where it was not built
import numpy as np, miho
t = np.linspace(0, 2, 50)
for model in (lambda t, a, b: a * np.exp(-b * t), lambda t, a, b: a / (1 + b * t)):
    y = model(t, 2.0, 1.5)
    fit = miho.fit(model, t, y, {"a": (0, 5), "b": (0, 10)})
    assert abs(fit.values["a"] - 2) < 1e-6
"""


def test_one_line_says_that_the_machine_of_formulas_was_not_built() -> None:
    command = [sys.executable, "-c", WITHOUT_MACHINE]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert process.stderr.count("without a C compiler") == 1
    assert len(process.stderr.splitlines()) == 1


@pytest.mark.parametrize(("sign", "bound"), [(-1, 0.0), (1, 0.3)])
def test_a_parameter_ends_at_its_bound_and_not_near_it(sign: int, bound: float) -> None:
    data = y + sign
    start = {"a": 1.0, "b": 1.0, "c": 0.1}
    box = BOX | {"c": (0.0, 0.3)}

    def shifted(t, a, b, c):
        return decay(t, a, b) + min(c, 1.0)  # which is not traced

    assert miho.fit(shifted, t, data, box, start=start).values["c"] == bound
    assert miho.fit(shifted, t, data, box, method="least_squares").values["c"] == bound


def test_a_start_takes_the_place_of_bounds() -> None:
    theta, _ = curve_fit(decay, t, y, [1.0, 1.0], xtol=1e-12)
    fit = miho.fit(decay, t, y, start={"a": 1, "b": 1}, compiled=False)
    assert list(fit.values.values()) == pytest.approx(theta, rel=DIGITS)
    assert "a single search" in fit.optimum


@pytest.mark.parametrize("scale", [1e-4, 1e-12, 1e-60])
@pytest.mark.parametrize("formula", [True, False])
def test_a_descent_from_a_start_reaches_the_optimum_in_any_unit(
    scale: float, formula: bool
) -> None:
    """The range of a parameter without bounds is 1e6 or more, and its value is 1e-4 or less."""

    def scaled(t, a, b):
        return decay(t, a, b / scale) if formula or a < 1e300 else t

    theta, covariance = curve_fit(decay, t, y, [1.0, 1.0], xtol=1e-12)
    fit = miho.fit(scaled, t, y, start={"a": 1, "b": 0.5 * scale})
    assert fit.theta / [1, scale] == pytest.approx(theta, rel=DIGITS)
    errors = fit.parameters["standard_error"] / [1, scale]
    assert errors.to_numpy() == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-4)


def test_descents_from_rough_starts_reach_the_optimum_of_two_decays() -> None:
    """Errors from 0.01 to 10; ranges are a million times the start."""
    x = np.linspace(0.1, 5.0, 60)

    def decays(x, a, b, c, d):
        return a * np.exp(-b * x) + c * np.exp(-d * x) if a < 1e300 else x

    truth, rng = np.array([2.0, 0.3, 1.0, 3.0]), np.random.default_rng(1)
    for _ in range(8):
        start = dict(zip("abcd", truth * 10 ** rng.uniform(-1.5, 1.5, 4), strict=True))
        fit = miho.fit(decays, x, decays(x, *truth), start=start, sigma=np.linspace(0.01, 10, 60))
        assert fit.error < 1e-5


def test_a_descent_leaves_a_bound_with_an_infinite_slope() -> None:
    x = np.linspace(0.1, 5.0, 60)

    def rising(x, a, b):
        return a**2 * x + np.sqrt(b) * x**2

    bounds = {"a": (0, 1e6), "b": (0, 1e6)}
    fit = miho.fit(rising, x, rising(x, 2.0, 2.0), bounds, start={"a": 9.98, "b": 4.85})
    assert fit.theta == pytest.approx([2.0, 2.0])


@pytest.mark.parametrize("formula", [True, False])
def test_a_start_may_be_far_from_a_tiny_optimum(formula: bool) -> None:
    def straight(x, a, b):
        return a + b * x if formula or a < 1e300 else x

    slope, offset = np.polyfit(t, y, 1)
    fit = miho.fit(straight, t, 1e-30 * y, start={"a": 1, "b": 1})
    assert 1e30 * fit.theta == pytest.approx([offset, slope], rel=DIGITS)


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
    assert list(table["status"]) == ["free", "free", "= 3 - a", "= b + gap", "free"]
    fixed = miho.fit(two, frame, "V", box, fixed={"c": 2.0}, tied={"d": "b + gap"}, compiled=False)
    assert fixed.parameters.loc["c", ["value", "standard_error", "status"]].tolist() == [
        2.0, 0.0, "fixed",
    ]  # fmt: skip


def test_the_covariance_of_ordered_tied_and_fixed_parameters_is_scipys() -> None:
    values = two(t, 1.0, 0.7, 2.0, 4.0) + 0.01 * noise
    _, expected = curve_fit(lambda t, b, d: two(t, 1.0, b, 2.0, d), t, values, [0.7, 4.0])
    box = {"b": (0, 5), "d": (0, 20), "sum": {}}
    stated = {"fixed": {"a": 1, "c": 2}, "tied": {"sum": "b + d"}}
    covariance = miho.fit(two, t, values, box, constraints="b < d", **stated).covariance
    assert list(covariance) == list(covariance.index) == ["a", "b", "c", "d", "sum"]
    free = covariance.loc[["b", "d"], ["b", "d"]].to_numpy()
    assert free == pytest.approx(expected, rel=1e-4)
    assert covariance.loc["sum", ["a", "b", "sum"]].tolist() == pytest.approx(
        [0, free[0].sum(), free.sum()]
    )
    lost = miho.fit(lambda t, a, b, c: a * c * np.exp(-b * t), t, y, {**BOX, "c": (1, 2)})
    assert np.isfinite(lost.covariance).to_numpy().sum() == 1


def test_with_a_start_a_bound_may_be_open() -> None:
    start = {"a": 1e-3, "b": 1}
    plain = miho.fit(decay, t, y, start=start).values
    half: dict[str, Any] = {"a": (0, math.inf), "b": {"low": 0}}
    assert miho.fit(decay, t, y, half, start=start).values == pytest.approx(plain, rel=1e-5)
    assert miho.fit(decay, t, y, {"a": (-math.inf, 1)}, start=start).values["a"] == 1
    with pytest.raises(ValueError, match=r"start: a is 0\.001; give one from 1 to inf"):
        miho.fit(decay, t, y, {"a": (1, math.inf)}, start=start)
    with pytest.raises(ValueError, match=r"high is inf; expected finite bounds .* or a start"):
        miho.fit(decay, t, y, half)


def test_a_picofarad_is_not_at_the_bound_of_a_farad() -> None:
    def charge(t: Any, V: Any, C: Any) -> Any:
        return V * (1 - np.exp(-t / (1e5 * C)))

    time = np.linspace(0, 2e-5, 60)
    volts = charge(time, 5, 4.7e-11) + 0.02 * noise
    _, covariance = curve_fit(lambda t, V, C: charge(t, V, 1e-11 * C), time, volts, [5, 5])
    errors = np.sqrt(np.diag(covariance)) * [1, 1e-11]
    for compiled in (True, False):  # where C is large, 1 - exp(...) cancels, which is no warning
        fit = miho.fit(charge, time, volts, {"V": (0, 10), "C": (0, 1)}, compiled=compiled)
        assert fit.parameters["standard_error"].to_numpy() == pytest.approx(errors, rel=1e-4)
        assert fit.caveats == []


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
    with pytest.raises(ValueError, match="x has the columns b, V; expected at least one"):
        miho.fit(decay, frame[["b", "V"]], "V", BOX)


def test_errors_that_drift_widen_intervals_and_it_is_said() -> None:
    drift = np.zeros(60)
    for k in range(1, 60):  # a first-order autoregression of 0.9
        drift[k] = 0.9 * drift[k - 1] + 0.05 * noise[k]
    fit = miho.fit(decay, t, decay(t, 2.0, 1.5) + drift, BOX, compiled=False)
    assert "intervals allow for correlated errors" in flat(fit)
    assert "times as wide" not in flat(fit)
    cut = miho.fit(decay, t, y, {"a": (0, 5), "b": (0, 1)}, compiled=False)
    assert re.search(r"neighbouring rows, up to \d\d+ times as wide: fit.report\(\)", flat(cut))
    assert "intervals allow" not in str(miho.fit(decay, t, y, BOX, compiled=False))
    plain = fit.uncertainty.independent.standard_errors
    assert (fit.parameters["standard_error"].to_numpy() > 1.2 * plain).all()


def test_what_takes_the_numbers_away_is_printed_below_the_table() -> None:
    def both(t, a, b):  # type: ignore[no-untyped-def]
        return (a + b) * t

    cases = [
        (both, {"a": (-5, 5), "b": (-5, 5)}, {}, ["not identifiable", "not identifiable"],
         ["a and b are not identifiable one by one"]),
        (decay, {"a": (0, 5), "b": (0, 1)}, {}, ["free", "at upper bound"],
         ["b is at its upper bound 1: widen the bounds"]),
        (decay, BOX, {"a": 1.0, "b": 1.0}, ["free", "free"],
         ["the optimum is in doubt: a single search", "search from more starting points"]),
        (decay, BOX, {}, ["free", "free"], []),
    ]  # fmt: skip
    for function, box, start, held, caveats in cases:
        fit = miho.fit(function, t, y, box, start=start or None, compiled=False)
        assert list(fit.parameters["status"]) == held
        lines = [line for line in str(fit).splitlines() if line.startswith("- ")]
        assert len(lines) == len(caveats)
        assert all(line.startswith(f"- {c}") for line, c in zip(lines, caveats, strict=True))
        table = str(fit).splitlines()[1:3]
        assert all(mark in line for line, mark in zip(table, held, strict=True))
        assert all(caveat in fit._repr_html_() for caveat in caveats)
    few = miho.fit(decay, t[:2], y[:2], BOX, compiled=False)
    assert "- there are no standard errors: " in str(few)
    value, low, high = few.predict(t[:2])
    np.testing.assert_allclose(value, y[:2])
    assert np.isnan([low, high]).all()
    assert few.plot().axes


def test_a_fit_is_pickled_printed_and_drawn() -> None:
    fit = miho.fit(decay, t, y, BOX, compiled=False)
    copy = pickle.loads(pickle.dumps(fit))
    assert str(copy) == str(fit)
    assert "<table" in fit._repr_html_()
    (ax,) = fit.plot().axes
    assert ax.get_xlabel() == "t"
    own = Figure()
    left, right = own.subplots(1, 2)
    assert fit.plot(right) is own
    for wrong, kind in (
        (own.axes, "a list"),
        (np.array(own.axes), "an array of axes"),
        (own, "a Fig"),
    ):
        with pytest.raises(TypeError, match=f"^ax is {kind}.*: pass one axes, such as"):
            fit.plot(wrong)
    assert right.get_ylabel() == "y"
    assert not left.has_data()
    assert fit.report().parameters["value"].tolist() == pytest.approx(list(fit.values.values()))


def test_start_and_fixed_values_may_be_a_series() -> None:
    fit = miho.fit(decay, t, y, BOX, compiled=False)
    again = miho.fit(decay, t, y, start=fit.parameters["value"], compiled=False)
    assert again.values == pytest.approx(fit.values, rel=DIGITS)
    assert miho.fit(decay, t, y, BOX, fixed=pd.Series({"a": 1.0})).values["a"] == 1.0
    with pytest.raises(ValueError, match="start is a b 0 1 2; give its values by name"):
        miho.fit(decay, t, y, start=pd.DataFrame({"a": [1], "b": [2]}))


def test_a_dataset_gives_columns_and_units() -> None:
    data = miho.Dataset("cells", {"t": t, "V": y}, {"t": "s", "V": "V"}, "V")
    fit = miho.fit(decay, data, "V", BOX)
    assert fit.values == pytest.approx(miho.fit(decay, t, y, BOX).values, rel=1e-8)
    assert fit.plot().axes[0].get_ylabel() == "V [V]"
    assert fit.predict(data).value.shape == t.shape

    def in_minutes(t, *, a, b):
        return decay(t, a, b)

    in_minutes.__annotations__ = {"t": "'min'"}  # as text of the source
    with pytest.raises(ValueError, match=r"column 't' of .* has unit 's'; model .* 'min'"):
        miho.fit(in_minutes, data, "V", BOX)


def test_a_dataset_gives_the_unit_of_sigma_and_none_of_an_array() -> None:
    columns = {"t": t, "V": y, "s": np.full(t.size, 0.1), "y": t}
    units = {"t": "s", "V": "A", "s": "mA", "y": "m"}
    data = miho.Dataset("cells", columns, units, "V")
    refused = "sigma has the unit 'mA'; expected 'A', the unit of 'V'"
    with pytest.raises(ValueError, match=rf"^{refused}"):
        miho.fit(decay, data, "V", BOX, sigma="s")
    with pytest.raises(ValueError, match=rf"^p: {refused}"):
        miho.fit_joint({"p": (decay, data, "V", "s"), "q": (decay, data, "V")}, BOX)
    same = miho.Dataset("cells", columns, {**units, "s": "A"}, "V")
    assert miho.fit(decay, same, "V", BOX, sigma="s").problem.scale == pytest.approx(0.1)
    assert miho.fit(decay, data, y, BOX).problem.unit == ""


def test_a_model_without_a_value_near_the_start_is_not_blamed_on_a_row() -> None:
    with pytest.raises(ValueError, match="in any trial of the space; change the bounds or the sta"):
        miho.fit(lambda t, a, b: a * np.log(b * t + 1e-3), t, y, start={"a": 1, "b": -1})


def test_a_model_may_have_values_in_a_hundredth_of_its_box() -> None:
    """Some rows have no value at the first trials; the root is real for b below 0.5."""
    root = 3 * np.sqrt(1 - 0.4 * t)
    fit = miho.fit(lambda t, a, b: a * np.sqrt(1 - b * t), t, root, {"a": (0, 9), "b": (0, 50)})
    assert fit.values == pytest.approx({"a": 3, "b": 0.4})


def test_a_pandas_column_gives_the_output_its_name() -> None:
    fit = miho.fit(decay, t, pd.Series(y, name="voltage"), BOX, compiled=False)
    assert fit.plot().axes[0].get_ylabel() == "voltage"
    with pytest.raises(ValueError, match="voltage: a number is missing"):
        miho.fit(decay, t, pd.Series(np.where(t > 1, np.nan, y), name="voltage"), BOX)


@pytest.mark.parametrize("model", [Pacejka(), PacejkaCurvature()])
def test_degrees_and_wrong_signs_of_a_slip_angle_are_refused(model: Pacejka) -> None:
    alpha = np.linspace(-0.15, 0.15, 50)
    force = -4000 * np.sin(1.5 * np.arctan(12 * alpha))
    box = {"B": (2, 40), "C": (1, 2.5), "D": (1e3, 9e3), "Sx": (-0.05, 0.05), "Sy": (-500, 500)}
    box |= {"E": (-1, 0.9)} if "E" in model.parameters else {}
    with pytest.raises(ValueError, match=r"largest \|alpha\| is 8.594 rad.*is the column in deg"):
        miho.fit(model, np.rad2deg(alpha), force, box)
    remedy = "set convention='adapted-sae', or negate alpha or Fy$"
    with pytest.raises(ValueError, match=f"Fy rises with alpha, but it falls in ISO-W; {remedy}"):
        miho.fit(model, alpha, -force, box)
    for fit in (
        miho.fit(model, alpha, -force, box, convention="adapted-sae"),
        miho.fit(model, -alpha, -force, box),
        miho.fit(model, alpha, force, box),
        miho.fit(model, alpha, -force, box | {"D": (-9e3, -1e3)}),
    ):
        assert abs(fit.values["D"]) == pytest.approx(4000, rel=1e-3)
    meant = {name: fit.values[name] for name in model.parameters}
    assert meant["D"] < 0
    assert miho.fit(model, alpha, -force, start=meant).values["D"] < 0
    unit = {**box, "D": (0.1, 3), "Sy": (-1, 1)}
    assert miho.fit(model, alpha, force / 4000, unit).values["D"] == pytest.approx(1, rel=1e-3)


class Line:
    """A model by methods, whose gain may change between a fit and its use."""

    gain = 1.0

    @staticmethod
    def traced(t: Any, a: Any, b: Any) -> Any:
        return Line.gain * a * np.exp(-b * t)

    @staticmethod
    def called(t: Any, a: Any, b: Any) -> Any:
        if Line.gain < 0:
            raise RuntimeError("no gain")
        return Line.gain * float(a) * np.exp(-float(b) * t)


@pytest.mark.parametrize("model", [Line.traced, Line.called])
def test_a_pickled_fit_says_that_its_model_has_changed(
    model: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = miho.fit(model, t, y, BOX, start={"a": 1.0, "b": 1.0})
    stored = pickle.dumps(fit)
    assert pickle.loads(stored).error == fit.error
    monkeypatch.setattr(Line, "gain", 1 + 1e-13)  # as another machine rounds
    pickle.loads(stored)
    assert not capsys.readouterr().err
    monkeypatch.setattr(Line, "gain", 2.0)
    changed = pickle.loads(stored)
    assert capsys.readouterr().err == (
        f"miho: {fit.problem.name}: the model has changed since this fit was stored: its error at "
        f"the optimum is {changed.error:.9g}, not {fit.error:.9g}; fit again, or restore the "
        "model\n"
    )
    assert changed.error > 2 * fit.error


def test_a_pickled_fit_says_that_its_model_raises(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = pickle.dumps(miho.fit(Line.called, t, y, BOX, start={"a": 1.0, "b": 1.0}))
    monkeypatch.setattr(Line, "gain", -1.0)
    pickle.loads(stored)
    said = capsys.readouterr().err
    assert "it raises ValueError: tests.test_fitting: called raises RuntimeError: no gain" in said
    assert said.count("\n") == 1


def _fall(h: Any, v: Any, *, g: Any) -> Any:
    return v, -g + 0 * h


def _raising(t: Any, a: Any, b: Any) -> Any:
    raise RuntimeError("no first\nor second")


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no bounds": ({"space": None}, "a has no bounds; give them, for example {'a': \\(0, 10\\)}"),
    "a bound short": ({"space": {"a": (0, 5)}}, "b has no bounds"),
    "one number": ({"space": {"a": (0, 5), "b": 3}}, "bounds of b are 3; expected"),
    "unknown": ({"space": {**BOX, "q": (0, 1)}}, "no parameter q, and none is tied|also has q"),
    "fixed unknown": ({"fixed": {"c": 1}}, "fixed: c is not a parameter; choose from a, b"),
    "fixed outside": ({"fixed": {"a": 9.0}}, "'a': fixed is 9.0, but low is 0.0 and high is 5.0"),
    "a cycle": ({"tied": {"a": "b", "b": "a"}}, "cycle|every parameter"),
    "code": ({"tied": {"a": "__import__('os')"}}, "is not allowed; use numbers"),
    "an attribute": ({"tied": {"a": "b.real"}}, "'b.real' is not allowed"),
    "no expression": ({"tied": {"a": "1 +"}}, "'1 \\+' is not an expression"),
    "a typing error": ({"tied": {"a": "2 * bb"}}, "unknown parameter bb; did you mean b"),
    "a quantity without a place": (
        {"tied": {"K": "a * b"}},
        "tied: K is not a parameter; choose from a, b, or add {'K': {}} to the bounds, as a quant",
    ),
    "never": (
        {"space": {"a": (50, 60), "b": (0, 5)}, "tied": {"a": "2 * b"}},
        "expected values from 50 to 60",
    ),
    "start short": ({"space": None, "start": {"a": 1}}, "b has no bounds|lacks b"),
    "start by position": (
        {"space": None, "start": [1, 1]},
        "start is \\[1, 1\\]; give its values by name, as in {'a': 1}",
    ),
    "start outside": ({"start": {"a": 1e3, "b": 1}}, "start: a is 1000; give one from"),
    "start a word": ({"space": None, "start": {"a": "x", "b": 1}}, "start: a is 'x'; expected a"),
    "start NaN": ({"space": None, "start": {"a": np.nan, "b": 1}}, "start: a is nan; expected a"),
    "fixed by position": ({"fixed": ["a"]}, "fixed is \\['a'\\]; give its values by name"),
    "fixed to a word": ({"fixed": {"a": "one"}}, "fixed: a is 'one'; expected a finite number"),
    "a misspelt name": ({"space": {"a": (0, 5), "B": (0, 5)}}, "decay has no parameter B"),
    "a setting of lmfit": (
        {"space": {**BOX, "a": {"min": 0, "max": 5}}},
        "bounds of a: min is not a setting; choose from unit, low, high, scale",
    ),
    "words": ({"y": [*y[:-1], "n/a"]}, "y is 'n/a' in row 60; expected real numbers"),
    "dates": (
        {"x": pd.Series(pd.to_datetime(t, unit="s"), name="t")},
        "expected real numbers, for example the seconds \\(t - t.min\\(\\)\\) / pandas.Timedelta",
    ),
    "dates with a time zone": (
        {"x": pd.Series(pd.to_datetime(t, unit="s", utc=True), name="t")},
        "t is '1970-01-01 .*' in row 1; expected real numbers, for example the seconds",
    ),
    "durations": (
        {"x": pd.to_timedelta(t, unit="s")},
        "for example the seconds t / pandas.Timedel",
    ),
    "dates as words": (
        {"x": [f"2024-05-03 10:00:{s:09.6f}" for s in t]},
        "t is '2024-05-03 10:00:00.000000' .*; convert times by pandas.to_datetime\\(t\\)",
    ),
    "a column twice": (
        {"x": pd.DataFrame(np.stack([t, y, y], axis=1), columns=["t", "V", "V"]), "y": "V"},
        "x has 2 columns V; rename or drop all but one",
    ),
    "a frame as the output": (
        {"y": pd.DataFrame({"y": y})},
        r"y has the shape \(60, 1\); expected a column \(N,\); give numpy.ravel\(y\)$",
    ),
    "a function as a tie": (
        {"tied": {"a": lambda b: b}},
        "space.a.tied: is <function .*; expected an expression as text, such as '2 \\* b'",
    ),
    "a class": ({"model": Pacejka}, "model is the class Pacejka; expected an object, for example"),
    "a class of functions": ({"model": dict}, "model is the class dict; expected an object"),
    "a forgotten return": ({"model": lambda t, a, b: None}, "real numbers, got NoneType"),
    "an array of parameters": (
        {"model": lambda t, a, b: a[0] + t},
        "'float' object is not subscriptable; a parameter is one number: name each",
    ),
    "a switch for a fixed number": ({"fixed": {"a": True}}, "fixed: a is True; expected a finite"),
    "a switch for a journal": ({"journal": True}, "journal is True; expected a file"),
    "a model's column": (
        {"model": Pacejka(), "x": {"slip": t}},
        "x has no column alpha; expected alpha for Pacejka$",
    ),
    "several outputs": (
        {"model": Trajectory(_fall, {"h": 0.0, "v": 0.0}, ["h", "v"]), "x": {"t": t}},
        "has no column output; .* for _fall; fit each output as a part of miho.fit_joint",
    ),
    "data first": ({"model": t}, "model is of type ndarray; expected a function; the order"),
    "a word for a function": ({"model": "decay"}, "model is 'decay'; expected a function, or"),
    "a misspelt column": (
        {"x": pd.DataFrame({"t": t, "V": y}), "y": "v"},
        "y is 'v'; expected values, or the name of a column of x, one of t, V",
    ),
    "lengths": ({"y": y[:3]}, "differ in length"),
    "no number": (
        {"y": np.where(t > 1, np.nan, y)},
        "y: a number is missing.*in 30 of 60 rows, first in row 31",
    ),
    "no column": ({"y": "W"}, "y is 'W'; expected values, or the name of a column"),
    "sigma": ({"sigma": -1.0}, "sigma is -1.0; expected a number above 0"),
    "sigma as a switch": ({"sigma": True}, "sigma is True; expected a number above 0"),
    "sigma as a NumPy switch": ({"sigma": np.True_}, "sigma is .*True.*; expected a number above"),
    "an error of two lines": (
        {"model": _raising},
        "_raising raises RuntimeError: no first or second",
    ),
    "huge numbers": ({"y": 1e200 * y}, r"column 'y' of decay reaches \S+e\+200, whose square"),
    "a word for a switch": ({"compiled": "no"}, "compiled is 'no'; expected True or False"),
    "a word for known": ({"sigma_known": "false"}, "sigma_known is 'false'; expected True or"),
    "sigma 0": ({"sigma": np.zeros(60)}, "is 0 in row 1"),
    "sigma too small": ({"sigma": 1e-200}, "sigma is 1e-200; expected 1e-140 to"),
    "a row's sigma too small": ({"sigma": np.full(60, 1e-200)}, "is 1e-200 in row 1"),
    "a table for a column": (
        {"x": np.ones((60, 2))},
        "t has the shape \\(60, 2\\); expected a column .* a grid as numpy.ravel\\(t\\)",
    ),
    "other labels": (
        {"x": pd.DataFrame({"t": t}), "y": pd.Series(y, index=range(1, 61))},
        "x, y and sigma have different row labels; align them",
    ),
    "a constraint": ({"constraints": "a < c"}, "'c' uses an unknown parameter c; choose from a, b"),
    "columns": ({"x": (t, t)}, "a has bounds, but x has 2 columns, for the arguments t, a"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_does_not_fit_together_is_refused_in_a_line(case: str) -> None:
    changes, message = BAD[case]
    arguments = {"model": decay, "x": t, "y": y, "space": BOX, "compiled": False, **changes}
    with pytest.raises(ValueError, match=message) as caught:
        miho.fit(**arguments)
    assert "\n" not in str(caught.value)


WORN = {"PCY1": 1.45, "PDY1": 1.9, "PKY1": -48.0, "PKY2": 1.7, "PHY1": 0.004, "PVY1": 0.03}


def _rows_of_a_worn_tire(n: int = 400, noise: float = 30.0) -> dict[str, Any]:
    tire = miho.load_tir(embedded_tire("lf"))
    worn = replace(tire, parameters=replace(tire.parameters, **WORN))
    rng = np.random.default_rng(0)
    box = {"alpha": (-0.2, 0.2), "Fz": (800.0, 6000.0), "gamma": (-0.05, 0.05)}
    rows = {name: rng.uniform(*ends, n) for name, ends in box.items()}
    force = worn.forces(rows["Fz"], 0.0, rows["alpha"], rows["gamma"]).Fy
    return rows | {"Fy": force + rng.normal(0, noise, n)}


def test_coefficients_of_a_tire_are_fitted_and_written_back(tmp_path: Path) -> None:
    """Against SciPy's least squares on the tire's own forces, to some of its last digits."""
    path, rows = embedded_tire("lf"), _rows_of_a_worn_tire()
    tire = miho.load_tir(path)
    fit = miho.fit(path, rows, "Fy", list(WORN))

    def residuals(theta: Any) -> Any:
        values = dict(zip(WORN, theta, strict=True))
        of = replace(tire, parameters=replace(tire.parameters, **values))
        return of.forces(rows["Fz"], 0.0, rows["alpha"], rows["gamma"]).Fy - rows["Fy"]

    start = [getattr(tire.parameters, name) for name in WORN]
    settings = {"x_scale": np.abs(start), "xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14}
    peer = least_squares(residuals, start, jac="3-point", **settings)
    assert list(fit.values.values()) == pytest.approx(peer.x, rel=1e-6)
    errors = fit.parameters["standard_error"]
    assert all(abs(fit.values[name] - WORN[name]) < 5 * errors[name] for name in WORN)

    fit.to_tir(tmp_path / "worn.tir")
    before, after = read_tir(path).sections, read_tir(tmp_path / "worn.tir").sections
    changed = {
        key: value for name, entries in after.items() for key, value in entries.items()
        if before[name].get(key) != value
    }  # fmt: skip
    assert changed == fit.values
    assert {name: set(entries) for name, entries in before.items()} == {
        name: set(entries) for name, entries in after.items()
    }


def test_a_tire_is_searched_within_bounds_and_tied() -> None:
    """As the one with the tied coefficient in place of what it is tied to."""
    tire, rows = miho.load_tir(embedded_tire("lf")), _rows_of_a_worn_tire()
    held = {name: WORN[name] for name in ("PCY1", "PKY2", "PVY1")}
    bounds = {"PDY1": (1, 3), "PKY1": (-80, -20)}
    plain = miho.fit(tire, rows, "Fy", bounds | {"PHY1": (0.001, 0.008)}, fixed=held)
    bounds |= {"part": (0.5, 4)}
    fit = miho.fit(tire, rows, "Fy", bounds, fixed=held, tied={"PHY1": "0.002 * part"})
    expected = plain.values | {"part": plain.values["PHY1"] / 0.002}
    assert fit.values == pytest.approx(expected, rel=DIGITS)
    assert "Converged: " in fit.optimum


def test_force_and_moment_of_a_tire_share_coefficients(tmp_path: Path) -> None:
    """Made with a stiffness that both depend on and a trail that only the moment does."""
    tire = miho.load_tir(embedded_tire("lf"))
    truth = {"PKY1": -45.0, "QBZ1": 9.0}
    worn = replace(tire, parameters=replace(tire.parameters, **truth))
    x = {name: _rows_of_a_worn_tire(200)[name] for name in ("alpha", "Fz")}
    made, rng = worn.forces(x["Fz"], 0.0, x["alpha"]), np.random.default_rng(1)
    parts = {
        "force": miho.Part(TireFormula(tire, ("PKY1",), "Fy"), x, made.Fy + rng.normal(0, 30, 200)),
        "moment": miho.Part(
            TireFormula(tire, ("PKY1", "QBZ1"), "Mz"), x, made.Mz + rng.normal(0, 1, 200)
        ),
    }
    fit = miho.fit_joint(parts, {"PKY1": (-90, -20), "QBZ1": (3, 20)})
    errors = fit.parameters["standard_error"]
    assert all(abs(fit.values[name] - truth[name]) < 4 * errors[name] for name in truth)
    fit.part("moment").to_tir(tmp_path / "worn.tir")
    again = miho.load_tir(tmp_path / "worn.tir").parameters
    assert (fit.values["PKY1"], fit.values["QBZ1"]) == (again.PKY1, again.QBZ1)


@pytest.mark.parametrize(
    ("x", "y", "space", "message"),
    [
        (["alpha", "Fz"], "Fy", (), "coefficients is empty; name"),
        (["alpha", "Fz"], "Fy", ["PDY"], "'PDY', which is given twice or not a"),
        (["alpha", "Fz"], "Fy", ["FZMIN"], "'FZMIN', which is"),
        (["alpha", "Fz"], "alpha", ["PDY1"], "expected Fx, Fy, Mz"),
        (["alpha"], "Fy", ["PDY1"], "expected at least Fz"),
    ],
)
def test_a_tire_that_cannot_be_fitted(x: list[str], y: str, space: Any, message: str) -> None:
    rows = _rows_of_a_worn_tire(20)
    with pytest.raises(ValueError, match=message):
        miho.fit(
            embedded_tire("lf"), {name: rows[name] for name in [*x, "Fy"]}, y, space,
            tied={"PEY2": "2 * PEY1"} if space else None,
        )  # fmt: skip


WRONG: dict[str, tuple[dict[str, float], str, str]] = {
    "sign of the slip angle": (
        {"alpha": -1},
        "Fy",
        "Fy: Fy .*; set convention='adapted-sae', or neg",
    ),
    "its sign, seen by the moment": ({"alpha": -1}, "Mz", "Mz: Mz falls with alpha"),
    "sign of the slip ratio": ({"kappa": -1}, "Fx", "Fx: Fx .* in ISO-W; negate kappa or Fx$"),
    "sign of the load": ({"Fz": -1}, "Fy", "Fz: Fz is mostly negative.*'sae', or negate Fz$"),
    "degrees": ({"alpha": 57.3}, "Fy", r"alpha, row \d+: largest .* is the column in deg\?"),
    "camber in degrees": ({"gamma": 57.3}, "Mz", r"gamma, row \d+: .* column in deg or mrad\?"),
    "kN": ({"Fy": 1e-3}, "Fy", r"Fy, row \d+: largest .* in kN, daN, lbf or kgf\?"),
    "load in lbf": (
        {"Fz": 1 / 4.448},
        "Fx",
        "Fx: largest .* times the largest .* correct the unit",
    ),
    "bar": ({"pressure": 1e-5}, "Fy", r"pressure, row 1: largest .* is 1.4 Pa"),
}


def _conditions_of_a_tire(n: int = 100) -> dict[str, Any]:
    rng = np.random.default_rng(3)
    box = {"alpha": 0.15, "kappa": 0.1, "gamma": 0.05}
    x = {name: rng.uniform(-end, end, n) for name, end in box.items()}
    return x | {"Fz": rng.uniform(1500, 5000, n), "pressure": np.full(n, 1.4e5)}


@pytest.mark.parametrize("case", WRONG)
def test_a_tire_s_columns_in_another_unit_or_sign_are_refused(case: str) -> None:
    """As the columns of a file are, and before anything is fitted."""
    factors, y, message = WRONG[case]
    tire, rows = miho.load_tir(embedded_tire("lf")), _conditions_of_a_tire(200)
    if y == "Mz":
        del rows["kappa"]
    forces = tire.forces(**({"kappa": 0.0} | rows))
    rows |= {name: column * factors.get(name, 1.0) for name, column in rows.items()}
    rows[y] = getattr(forces, y) * factors.get(y, 1.0)
    coefficient = {"Fx": "PDX1", "Fy": "PDY1", "Mz": "QDZ1"}[y]
    for model in (tire, TireFormula(tire, (coefficient,), y, tuple(n for n in rows if n != y))):
        with pytest.raises(ValueError, match=message) as caught:
            miho.fit(model, rows, y, start={coefficient: 1.0})
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("convention", ["iso-w", "sae", "adapted-sae"])
def test_a_tire_is_fitted_in_the_signs_of_its_data(convention: str) -> None:
    tire, rows = miho.load_tir(embedded_tire("lf")), _conditions_of_a_tire()
    rows["Fy"] = tire.forces(**rows).Fy
    start = {"PDY1": 1.6, "PKY1": -50.0}
    reversed_ = {"iso-w": (), "sae": ("alpha", "Fz", "Fy"), "adapted-sae": ("Fy",)}[convention]
    data = pd.DataFrame(rows | {name: -rows[name] for name in reversed_})
    fit = miho.fit(tire, data, "Fy", start=start, convention=convention)
    own = {name: getattr(tire.parameters, name) for name in start}
    assert fit.values == pytest.approx(own, rel=1e-6)
    if convention == "sae":
        with pytest.raises(ValueError, match="predict takes a tire's inputs in ISO-W"):
            fit.predict(data)


def test_sizes_and_signs_that_are_stated_are_taken() -> None:
    tire, rows = miho.load_tir(embedded_tire("lf")), _conditions_of_a_tire()
    rows["alpha"] = rows["alpha"] / 1e4
    rows["Fy"] = tire.forces(**rows).Fy
    ranges = {"alpha": (0.001, 0.1)}
    with pytest.raises(ValueError, match=r"alpha, row \d+: .* expected 0.001 to 0.1"):
        miho.fit(tire, rows, "Fy", start={"PHY1": 0.0}, ranges=ranges)
    assert miho.fit(tire, rows, "Fy", start={"PHY1": 0.0}, ranges={"alpha": None})
    rows["Fy"] = np.where(np.arange(100) == 7, np.nan, rows["Fy"])
    with pytest.raises(ValueError, match=r"Fy: a number is missing .* in row 8"):
        miho.fit(tire, rows, "Fy", start={"PHY1": 0.0})
    with pytest.raises(ValueError, match="columns differ in length"):
        miho.fit(tire, rows | {"Fy": np.zeros(5)}, "Fy", start={"PHY1": 0.0})
    with pytest.raises(ValueError, match="convention is 'iso'; expected one of iso-w, sae"):
        miho.fit(tire, rows, "Fy", start={"PHY1": 0.0}, convention="iso")
    with pytest.raises(ValueError, match="convention and ranges: expected for the data of a tire"):
        miho.fit(decay, t, y, BOX, convention="sae")


def test_bounds_without_names_are_refused() -> None:
    for bounds in ([(0, 1)], pd.DataFrame({"a": [0, 1], "b": [0, 1]})):
        with pytest.raises(ValueError, match="; give them by name") as refused:
            miho.fit(lambda t, a: a * t, np.arange(5.0), np.arange(5.0), bounds)  # type: ignore[arg-type]
        assert "\n" not in str(refused.value)
    fit = miho.fit(lambda t, a: a * t, np.arange(5.0), np.arange(5.0), start={"a": 1})
    with pytest.raises(TypeError, match="only a fit of a tire"):
        fit.to_tir("x.tir")


@pytest.mark.parametrize("start", [None, {"a": 0.0, "b": 0.0}])
def test_a_fit_of_a_linear_function_has_no_better_optimum(start: dict[str, float] | None) -> None:
    """By linear algebra, also within bounds that hold its optimum back."""
    x = np.linspace(0, 1, 30)
    y = 1 + 2 * x + 0.1 * np.cos(9 * x)
    for high in (10, 1.5):
        space = {"a": (-10, 10), "b": (-10, high)}
        fit = miho.fit(lambda x, a, b: a + b * x, x, y, space, start=start, compiled=False)
        assert "no other optimum is better" in fit.optimum
    bent = miho.fit(decay, x, y, start={"a": 1, "b": 1}, compiled=False)
    assert "no other optimum" not in bent.optimum


def _oscillator(t, w, d):
    def slopes(_, state):
        return [state[1], -w * w * state[0] - 2 * d * w * state[1]]

    return solve_ivp(slopes, (0, t[-1]), [1, 0], t_eval=t, rtol=1e-8, atol=1e-8).y[0]


def _branching(t, a, b):
    if a > 1:
        return a * np.exp(-b * t)
    return math.exp(-a) + 0 * t


def _cumulative(t, a, b):
    return np.cumsum(a * np.exp(-b * t))


@pytest.mark.parametrize(
    ("function", "truth", "box"),
    [
        (_oscillator, {"w": 5.0, "d": 0.1}, {"w": (1, 10), "d": (0.01, 1)}),
        (_branching, {"a": 2.0, "b": 1.5}, {"a": (0.1, 5), "b": (0.01, 10)}),
        (_cumulative, {"a": 2.0, "b": 1.5}, {"a": (0.1, 5), "b": (0.01, 10)}),
    ],
)
def test_any_function_of_numbers_is_fitted(function: Any, truth: Any, box: Any) -> None:
    """As by SciPy from beside the truth; a simulation is asked for all rows, in their order."""
    lengths = []

    def counted(t, **parameters):
        lengths.append(t.size)
        return function(t, **parameters)

    values = function(t, **truth) + 0.02 * noise
    counted.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]
    fit = miho.fit(counted, t, values, box)
    start = [0.9 * value for value in truth.values()]
    theta, _ = curve_fit(function, t, values, start, xtol=1e-12, ftol=1e-12)
    assert list(fit.values.values()) == pytest.approx(theta, rel=1e-4)
    assert "Converged: " in fit.optimum
    assert fit.problem.model.ordered == (function is not _branching)
    if function is not _branching:
        assert sum(length < 60 for length in lengths) == 1  # the comparison


def test_from_a_start_a_simulation_is_tried_out_near_it() -> None:
    """And not within the box of a million times the start, where it would take for ever."""
    seen = []

    def counted(t, w, d):
        seen.extend(value for value in (w, d) if isinstance(value, float))  # tracing has symbols
        return _oscillator(t, w, d)

    fit = miho.fit(counted, t, _oscillator(t, 5.0, 0.1), start={"w": 4.5, "d": 0.2})
    assert fit.values == pytest.approx({"w": 5.0, "d": 0.1}, rel=1e-4)
    assert 5 < max(seen) < 100


def test_rounding_is_relative_to_the_weighted_output() -> None:
    """Rates of a reaction from 300 K to 900 K span 14 decades; each has an error of 3 %."""

    def rate(T, A, E):
        return A * np.exp(-E / (8.314 * T))

    T = np.linspace(300, 900, 25)
    k = rate(T, 1e13, 1.2e5) * (1 + 0.03 * np.random.default_rng(3).standard_normal(25))
    bounds = {"A": {"low": 1e5, "high": 1e20, "scale": "log"}, "E": (1e4, 3e5)}
    fit = miho.fit(rate, T, k, bounds, sigma=0.03 * k)
    assert "zero to rounding" not in fit.optimum
    assert not any("reproduced to rounding" in note for note in fit.report(profiles=False).notes)
    weights = fit.problem.weights
    assert fit.problem.resolution < 1e-12 * np.mean((weights * k) ** 2)


def test_an_error_far_below_the_offset_is_shown_and_is_not_rounding() -> None:
    """Milliseconds of a clock in seconds: an error of 1e-12 of the output, or 8000 roundings."""
    fit = miho.fit(
        lambda t, a, b: a + b * t, t, 1e9 + t + 1e-3 * noise, {"a": (0, 2e9), "b": (-5, 5)}
    )
    value, error, low, high = fit.parameters.loc["a", ["value", "standard_error", "low", "high"]]
    report = fit.report()
    assert not any("no error" in note for note in report.notes)
    assert report.profiles[0] is not None
    for text in (str(fit), str(report)):
        (row,) = (line.split() for line in text.splitlines() if line.split()[:1] == ["a"])
        shown = [float(word) for word in row[1:5]]
        assert shown == pytest.approx([value, error, low, high], rel=1e-15, abs=error / 20)


def test_no_more_digits_are_printed_than_a_double_has() -> None:
    table = pd.DataFrame({"value": [0.3, 1e300], "error": [1e-30, 1e-300]})
    assert list(with_digits(table, "error")["value"]) == ["0.29999999999999999", f"{1e300:.17g}"]


def test_doses_of_several_decades_have_a_logarithmic_axis() -> None:
    """On a linear axis half of the rows would be within 1 % of its length."""
    dose = np.geomspace(1e-9, 1e-4, 21)
    fit = miho.fit(lambda c, k: c / (c + k), dose, dose / (dose + 3e-7), {"k": (1e-9, 1e-4)})
    axes = fit.plot().axes[0]
    assert axes.get_xscale() == "log"
    curve = axes.lines[0].get_ydata()
    assert np.abs(np.diff(curve)).max() < 0.02  # the rise is drawn
    assert miho.fit(decay, t, y, BOX).plot().axes[0].get_xscale() == "linear"


def test_the_curve_of_a_simulation_is_drawn_at_the_rows_of_data() -> None:
    values = _cumulative(t, 2.0, 1.5) + 0.02 * noise
    fit = miho.fit(_cumulative, t, values, {"a": (0.1, 5), "b": (0.01, 10)})
    (line,) = fit.plot().axes[0].lines
    assert np.array_equal(line.get_xdata(), t)
    assert np.array_equal(line.get_ydata(), fit.predict(t).value)


NO_NUMBA = """
import sys
import numpy as np
import miho

class Growth:
    def __call__(self, t, a, b):  # its branch cannot be traced
        return a * np.exp(-b * t) if t[0] < 1 else t

t = np.linspace(0, 2, 50)
y = 2 * np.exp(-1.5 * t) + 0.05 * np.random.default_rng(1).standard_normal(50)
box = {"a": (0, 5), "b": (0, 10)}
many = np.linspace(0, 2, 30_000)
miho.fit(lambda t, a, b: a / (1 + b * t), many, 2 / (1 + 1.5 * many), box)
for model in (lambda t, a, b: a * np.exp(-b * t), Growth().__call__):
    fit = miho.fit(model, t, y, box)
    print(fit, fit.report())
    miho.fit(model, t, y, box, compiled=False)
assert "numba" not in sys.modules
"""


def test_no_search_waits_for_a_compiler() -> None:
    """A long one, the README's, of a function that is only called, and with steps in NumPy."""
    command = [sys.executable, "-c", NO_NUMBA]
    process = subprocess.run(command, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    progress = "stops by itself", " evaluations, "  # of a search that another process slows down
    lines = [x for x in process.stderr.splitlines() if not any(words in x for words in progress)]
    assert machine() is None or not lines


@pytest.fixture
def without_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """The library as it is where it was installed without a C compiler."""
    monkeypatch.setattr("miho.compiled.kernel.machine", lambda: None)


@needs_machine
def test_the_machine_searches_a_formula_at_once() -> None:
    """With the same evaluations as steps in Python."""
    plain = miho.fit(decay, t, y, BOX, compiled=False)
    fit = miho.fit(decay, t, y, BOX)
    assert fit.problem.kernel.rows is not None
    assert fit.problem.kernel.climb is not None
    assert fit.values == pytest.approx(plain.values, rel=1e-9)
    assert fit.descents.screened == plain.descents.screened
    assert fit.descents.ends == pytest.approx(plain.descents.ends, rel=1e-9)
    assert plain.problem.kernel is None


@pytest.mark.usefixtures("without_machine")
def test_without_the_machine_a_search_is_numpys() -> None:
    plain = miho.fit(decay, t, y, BOX, compiled=False)
    fit = miho.fit(decay, t, y, BOX)
    assert fit.problem.kernel is None
    assert fit.values == pytest.approx(plain.values, rel=1e-9)
    assert fit.descents.screened == plain.descents.screened
    assert fit.descents.ends == pytest.approx(plain.descents.ends, rel=1e-9)


@dataclass(frozen=True)
class OtherOnArrays(Decay):
    """A decay, whose amplitude on arrays, as its derivatives, has another form and a limit."""

    @property
    def value(self) -> Formula:
        return lambda inputs, theta: super(OtherOnArrays, self).value(inputs, _own(inputs, theta))


def _own(inputs: tuple[Any, ...], theta: tuple[Any, ...]) -> tuple[Any, ...]:
    on_arrays = isinstance(inputs[0], np.ndarray)
    return (theta[0] * np.sqrt(6.0 - theta[1]) if on_arrays else theta[0], *theta[1:])


@needs_machine
@pytest.mark.filterwarnings("ignore:OtherOnArrays")
def test_a_start_is_descended_from_where_the_machine_gives_other_values() -> None:
    y = 2 * np.exp(-8 * t) + 0.3
    box = {"a": (0.0, 10.0), "b": (0.0, 20.0), "c": (-5.0, 5.0)}
    fit = miho.fit(OtherOnArrays(), t, y, box, start={"a": 1.0, "b": 3.0, "c": 0.0})
    assert math.isfinite(fit.error)
