"""Criteria and F-tests against R's and printed ones, and bad input."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

import miho
from miho import compare_models
from miho.data import Dataset
from miho.identification import CurveFit, Huber, Report, make_report
from miho.models.model import Array, DifferencedModel, Model
from miho.optim import Parameter, Space
from miho.vehicle.models import Pacejka
from miho.vehicle.models.tire import PacejkaCurvature
from tests.identification.published import Line, puromycin
from tests.printed import flat


class Constant(Model):
    """y = a."""

    inputs = MappingProxyType({"x": "-"})
    parameters = MappingProxyType({"a": "-"})
    output = "-"
    linear = ("a",)

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        return np.asarray(thetas[:, :1] + 0 * inputs[0])

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        return np.ones((inputs[0].size, 1))


class Proportional(DifferencedModel):
    """y = a x: the name of a parameter of Constant and Line, and no special case of the former."""

    inputs = MappingProxyType({"x": "-"})
    parameters = MappingProxyType({"a": "-"})
    output = "-"

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        return np.asarray(thetas[:, :1] * inputs[0])


class Velocity(DifferencedModel):
    """Michaelis and Menten's, in which the treatment changes the velocity."""

    inputs = MappingProxyType({"x": "-", "treated": "-"})
    parameters = MappingProxyType({"Vm": "-", "dV": "-", "K": "-"})
    output = "-"

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        Vm, dV, K = thetas.T[:, :, None]
        x, treated = inputs
        return np.asarray((Vm + dV * treated) * x / (K + x))


class VelocityAndConstant(Velocity):
    """The same, in which it changes Michaelis' constant too."""

    parameters = MappingProxyType({"Vm": "-", "dV": "-", "K": "-", "dK": "-"})

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        Vm, dV, K, dK = thetas.T[:, :, None]
        x, treated = inputs
        return np.asarray((Vm + dV * treated) * x / (K + dK * treated + x))


def fit(
    model: Model, label: str, box: tuple[float, float], start: list[float], **columns: Array
) -> Report:
    data = Dataset("data", columns, dict.fromkeys(columns, "-"), "y")
    space = Space(tuple(Parameter(name, "-", *box) for name in model.parameters))
    problem = CurveFit(model, data, space, label=label)
    return make_report(problem, np.array(start), profiles=False)


SPEED = [4, 4, 7, 7, 8, 9, 10, 10, 10, 11, 11, 12, 12, 12, 12, 13, 13, 13, 13, 14, 14, 14, 14,
         15, 15, 15, 16, 16, 17, 17, 17, 18, 18, 18, 18, 19, 19, 19, 20, 20, 20, 20, 20, 22, 23,
         24, 24, 24, 24, 25]  # fmt: skip
DISTANCE = [2, 10, 4, 22, 16, 10, 18, 26, 34, 17, 28, 14, 20, 24, 28, 26, 34, 34, 46, 26, 36, 60,
            80, 20, 26, 54, 32, 40, 32, 40, 50, 42, 56, 76, 84, 36, 46, 68, 32, 48, 52, 56, 64, 66,
            54, 70, 92, 93, 120, 85]  # fmt: skip


def cars(model: Model, label: str) -> Report:
    """R's `cars` (Ezekiel 1930): stopping distance over speed."""
    columns = {"x": np.array(SPEED, dtype=float), "y": np.array(DISTANCE, dtype=float)}
    return fit(model, label, (-1000, 1000), [1.0] * len(model.parameters), **columns)


def test_criteria_and_f_test_are_those_of_r() -> None:
    """What R prints of lm(dist ~ speed, cars): AIC 419.1569, BIC 424.8929, F 89.57, p 1.49e-12."""
    comparison = compare_models(cars(Constant(), "constant"), cars(Line(), "line"))
    line, constant = comparison.table.to_dict("records")
    assert (line["model"], line["parameters"]) == ("line", 2)
    assert line["AIC"] == pytest.approx(419.1569, abs=5e-5)
    assert line["BIC"] == pytest.approx(424.8929, abs=5e-5)
    assert line["AICc"] == pytest.approx(line["AIC"] + 2 * 3 * 4 / (50 - 3 - 1))
    assert line["deviation"] == pytest.approx(15.38, abs=5e-3)
    n, squares = 50, np.sum((np.array(DISTANCE) - np.mean(DISTANCE)) ** 2)
    likelihood = -n / 2 * (np.log(2 * np.pi * squares / n) + 1)
    assert constant["AIC"] == pytest.approx(-2 * likelihood + 2 * 2)
    assert constant["difference"] == pytest.approx(constant["AICc"] - line["AICc"])
    assert line["weight"] == pytest.approx(1 / (1 + np.exp(-constant["difference"] / 2)))
    (test,) = comparison.tests.to_dict("records")
    assert (test["smaller"], test["larger"]) == ("constant", "line")
    assert (test["more"], test["freedom"]) == (1, 48)
    assert test["F"] == pytest.approx(89.57, abs=5e-3)
    assert test["p"] == pytest.approx(1.49e-12, abs=5e-15)
    assert "line is preferred: constant, the next by AICc" in flat(comparison)
    assert "line fits significantly better than constant, which it contains" in flat(comparison)


def test_a_published_extra_sum_of_squares() -> None:
    """Bates and Watts (1988, p. 106): 2055 with 19 degrees of freedom, 2241 with 20, F 1.7."""
    treated = puromycin().dataset
    x = [0.02, 0.02, 0.06, 0.06, 0.11, 0.11, 0.22, 0.22, 0.56, 0.56, 1.10]
    untreated = [67, 51, 84, 86, 98, 115, 131, 124, 144, 158, 160]
    columns = {
        "x": np.append(treated["x"], x),
        "treated": np.repeat([1.0, 0.0], [12, 11]),
        "y": np.append(treated["y"], np.array(untreated, dtype=float)),
    }
    small = fit(Velocity(), "velocity", (-300, 300), [160, 50, 0.05], **columns)
    large = fit(VelocityAndConstant(), "both", (-300, 300), [160, 50, 0.05, 0.0], **columns)
    comparison = compare_models(large, small)
    table = comparison.table.set_index("model")
    assert table.loc["both", "squares"] == pytest.approx(2055, abs=0.5)
    assert table.loc["velocity", "squares"] == pytest.approx(2241, abs=0.5)
    (test,) = comparison.tests.to_dict("records")
    assert (test["smaller"], test["more"], test["freedom"]) == ("velocity", 1, 19)
    assert test["F"] == pytest.approx(1.7, abs=0.05)
    assert test["p"] == pytest.approx(0.21, abs=0.005)
    assert "both does not fit significantly better than velocity" in flat(comparison)
    assert "the optimum of both is in doubt" in flat(comparison)


def test_models_are_nested_if_one_can_follow_the_other() -> None:
    """Not because names are alike; and only within the space of the larger one."""
    comparison = compare_models(
        cars(Constant(), "constant"), cars(Proportional(), "proportional"), cars(Line(), "line")
    )
    pairs = comparison.tests[["smaller", "larger"]].to_numpy().tolist()
    assert pairs == [["constant", "line"], ["proportional", "line"]]

    rng = np.random.default_rng(0)
    alpha = rng.uniform(-0.3, 0.3, 200)
    truth = np.array([[12.0, 1.6, 4000.0, 0.0, 0.0]])
    force = Pacejka().predict(truth, alpha)[0] + 100 * rng.standard_normal(200)
    data = Dataset("tire", {"alpha": alpha, "Fy": force}, {"alpha": "rad", "Fy": "N"}, "Fy")
    box = {"B": (2, 40), "C": (1, 2.5), "D": (1e3, 9e3), "E": (-2, 0.9), "Sx": (-0.05, 0.05),
           "Sy": (-500, 500)}  # fmt: skip

    def tire(model: Model, label: str, **changed: tuple[float, float]) -> Report:
        bounds = box | changed
        units = model.parameters
        space = Space(tuple(Parameter(name, units[name], *bounds[name]) for name in units))
        start = dict(zip("BCD", truth[0], strict=False))
        theta = np.array([start.get(name, 0.0) for name in units])
        return make_report(CurveFit(model, data, space, label=label), theta, profiles=False)

    plain, curved = tire(Pacejka(), "plain"), tire(PacejkaCurvature(), "curved")
    assert len(compare_models(plain, curved).tests) == 1
    away = tire(PacejkaCurvature(), "curved away from 0", E=(0.2, 0.9))
    assert compare_models(plain, away).tests.empty


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("one", "expected at least two reports, got 1"),
        ("list", "expected a fit or its report, got a list"),
        ("name", "two reports are called 'line'; give a mapping of names to reports"),
        ("data", "line and other are fits of different data .y in 50 rows of data, y in 49 of"),
        ("loss", "other has the loss Huber; expected Square, for which criteria"),
        ("exact", "other reproduces every row to rounding"),
        ("few", "other: 4 rows for 2 parameters; expected at least 5 rows"),
    ],
)
def test_bad_input(change: str, message: str) -> None:
    line = cars(Line(), "line")
    reports = [line]
    x, y = np.array(SPEED, dtype=float), np.array(DISTANCE, dtype=float)
    if change == "list":
        reports = [[line, line]]
    elif change == "name":
        reports.append(cars(Constant(), "line"))
    elif change == "loss":
        problem = replace(line.problem, rho=Huber(20.0), label="other")
        reports.append(make_report(problem, line.at.theta, profiles=False))
    elif change == "data":
        reports.append(fit(Line(), "other", (-99, 99), [1.0, 1.0], x=x[1:], y=y[1:]))
    elif change == "exact":
        reports = [fit(Line(), "other", (-99, 99), [1.0, 1.0], x=x, y=2 * x)]
        reports.append(fit(Constant(), "constant", (-99, 99), [1.0], x=x, y=2 * x))
    elif change == "few":
        reports = [
            fit(model, label, (-99, 99), [1.0] * len(model.parameters), x=x[:24:6], y=y[:24:6])
            for model, label in ((Constant(), "constant"), (Line(), "other"))
        ]
    with pytest.raises(ValueError, match=message) as error:
        compare_models(*reports)
    assert "\n" not in str(error.value)


def test_joint_fits_are_compared_by_a_common_sigma() -> None:
    """Without one, each fit has estimated the sigma of its parts, and the squares differ."""
    x = np.linspace(0, 2, 30)
    noise = 0.05 * np.random.default_rng(1).standard_normal((2, 30))
    y = np.array([[2.0], [3.0]]) * np.exp(-1.5 * x) + noise
    bounds = {"a": (0, 5), "b": (0, 3)}

    def joint(sigma: float | None, *local: str) -> miho.fitting.Fit:
        parts = {
            name: miho.Part(decay, x, values, sigma) for name, values in zip("pq", y, strict=True)
        }
        return miho.fit_joint(parts, bounds, local=local)

    with pytest.raises(ValueError, match="give both fits, and each part of a joint fit, the same"):
        compare_models({"one": joint(None, "b"), "two": joint(None, "a", "b")})
    result = compare_models({"one": joint(0.05, "b"), "two": joint(0.05, "a", "b")})
    assert result.table["model"].tolist() == ["two", "one"]
    with pytest.raises(ValueError, match="the same output, and joint fits with joint fits"):
        compare_models({"all": miho.fit(decay, x, y[0], bounds), "two": joint(0.05, "a", "b")})


def test_fits_are_compared_by_their_reports() -> None:
    x = np.linspace(0, 2, 30)
    y = 2 * np.exp(-1.5 * x) + 0.05 * np.random.default_rng(1).standard_normal(30)
    fits = [
        miho.fit(model, x, y, dict.fromkeys("abc"[:number], (0, 3)))
        for number, model in ((2, decay), (3, settling))
    ]
    expected = compare_models(*(fit.report() for fit in fits))
    assert str(compare_models(*fits)) == str(expected)


def decay(x: Array, a: float, b: float) -> Array:
    return np.asarray(a * np.exp(-b * x))


def settling(x: Array, a: float, b: float, c: float) -> Array:
    return np.asarray(a * np.exp(-b * x) + c)


def test_fits_of_one_function_are_named_by_a_mapping() -> None:
    """With and without a fixed parameter; the F-test is that of the sums of squares."""
    x = np.linspace(0, 1, 40)
    y = 1 + 0.1 * np.random.default_rng(0).standard_normal(40)
    box = {"a": (-9, 9), "b": (-9, 9)}
    free = miho.fit(lambda x, a, b: a + b * x, x, y, box)
    fixed = miho.fit(lambda x, a, b: a + b * x, x, y, box, fixed={"b": 0.0})
    comparison = compare_models({"free": free, "b = 0": fixed.report()})
    (test,) = comparison.tests.to_dict("records")
    assert (test["smaller"], test["larger"]) == ("b = 0", "free")
    assert test["F"] == pytest.approx(38 * (fixed.error**2 / free.error**2 - 1), rel=1e-6)
    assert free.problem.name != "free"


@pytest.mark.parametrize("name", ["", " ", None])
def test_a_fit_without_a_name_is_refused(name: str) -> None:
    x = np.arange(5.0)
    fit = miho.fit(lambda x, *, a: a * x, x, x + x % 2, {"a": (0, 5)})
    with pytest.raises(ValueError, match=f"a fit has the name {name!r}; expected words"):
        miho.compare_models({"one": fit, name: fit})


def test_fits_may_spell_the_unit_of_the_output_differently() -> None:
    """A function without annotations does not know its unit."""
    t = np.linspace(0.0, 1.0, 20)
    y = 2 * t + np.random.default_rng(0).normal(0, 0.01, 20)
    fits = {}
    for unit in ("Hz", "1/s", "", "kg"):

        def turn(t, *, f):
            return f * t

        turn.__annotations__ = {"return": unit} if unit else {}
        fits[unit or "none"] = miho.fit(turn, t, y, {"f": (0, 5)})
    wrong = {"Hz": fits["Hz"], "kg": fits.pop("kg")}
    assert miho.compare_models(fits).table["weight"].tolist() == pytest.approx([1 / 3] * 3)
    with pytest.raises(ValueError, match="fits of different data"):
        miho.compare_models(wrong)
