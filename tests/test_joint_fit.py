"""Several datasets and outputs at once, against closed forms."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.optimize

import miho
from miho import Part
from miho.core import machine
from miho.fitting.joint_problem import Joint, Measured
from miho.identification import optimal_design
from miho.identification.dependence import series_of
from miho.models.expression import Expression
from miho.models.joint import JointExpression, JointModel, parts_of
from miho.models.layout import PART
from miho.models.traced import TracedExpression
from miho.vehicle.data import embedded_tire
from miho.vehicle.models import Pacejka

needs_machine = pytest.mark.skipif(machine() is None, reason="the machine was not built")
t = np.linspace(0, 1, 30)
rng = np.random.default_rng(5)


def line(t, a, b):
    return a + b * t


def decay(t, a, b):
    return a * np.exp(-b * t)


def test_a_fixed_value_outside_its_bounds_is_refused() -> None:
    parts = {"left": (line, t, t, 0.1), "right": (line, t, t, 0.1)}
    with pytest.raises(ValueError, match=r"'a_left': fixed is 9.0, but low is 0.0 and high is 1.0"):
        miho.fit_joint(parts, {"a": (0, 1), "b": (0, 1)}, local=["a"], fixed={"a": 9})


@pytest.mark.parametrize("x", [t, {"t": t}], ids=["column", "by name"])
def test_a_prediction_of_no_part_names_the_call(x: Any) -> None:
    parts = {"left": (line, t, 1 + 2 * t, 0.1), "right": (line, t, 3 + 2 * t, 0.1)}
    fit = miho.fit_joint(parts, start={"a": 1, "b": 1}, local=["a"])
    with pytest.raises(ValueError, match=r"choose one, as in fit\.part\('left'\)\.predict\(x\)$"):
        fit.predict(x)


def test_lines_with_a_slope_in_common_are_one_regression() -> None:
    """Known sigma: weighted least squares of the stacked rows, in closed form."""
    s = np.linspace(0, 2, 20)
    y = 1 + 2 * t + 0.1 * rng.standard_normal(30)
    z = 3 + 2 * s + 0.4 * rng.standard_normal(20)
    parts = {"left": Part(line, t, y, 0.1), "right": (line, s, z, 0.4)}
    fit = miho.fit_joint(parts, {"a": (-9, 9), "b": (-9, 9)}, local=["a"])
    X = np.zeros((50, 3))
    X[:30, 0], X[:30, 1], X[30:, 1], X[30:, 2] = 1, t, s, 1
    w = np.repeat([1 / 0.1, 1 / 0.4], [30, 20])
    covariance = np.linalg.inv((X * w[:, None]).T @ (X * w[:, None]))
    expected = covariance @ (X * w[:, None]).T @ (np.append(y, z) * w)
    assert list(fit.values) == ["a_left", "b", "a_right"]
    assert miho.fit_joint(parts, {"a": (-9, 9), "b": (-9, 9)}, local="a").values == fit.values
    assert list(fit.values.values()) == pytest.approx(expected, rel=1e-6)
    errors = fit.parameters["standard_error"].tolist()
    assert errors == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-6)
    right = fit.part("right")
    gradient = np.array([0, 1.5, 1.0])
    half = 1.959964 * np.sqrt(gradient @ covariance @ gradient)
    prediction = right.predict(1.5)
    assert prediction.value[0] == pytest.approx(expected @ gradient, rel=1e-6)
    assert prediction.high[0] - prediction.value[0] == pytest.approx(half, rel=1e-5)
    assert fit.problem.linear == ("a_left", "b", "a_right")


def test_a_wrong_optimum_is_more_than_the_noise_of_the_parts() -> None:
    """Parts with other inputs and noise; the noise is unknown if it differs within a part."""
    s, noise = np.linspace(0, 1, 200), np.random.default_rng(1).standard_normal((2, 200))
    sigma = np.linspace(0.1, 0.2, 200)
    parts = {
        "left": (decay, s, decay(s, 2, 3) + 0.1 * noise[0], 0.1),
        "right": (lambda x, a: a * x, s, 4 * s + 2 * noise[1], 2.0),
    }
    start = {"a": 2.0, "b": 3.0}
    problem = miho.fit_joint(parts, start=start, local="a").problem
    right, wrong = problem.loss(np.array([[2.0, 3.0, 4.0], [2.4, 5.0, 4.0]]))
    assert right < problem.noise < wrong
    assert problem.row_parts is not None
    parts["left"] = (*parts["left"][:3], sigma)
    assert np.isinf(miho.fit_joint(parts, start=start, local="a").problem.noise)


def test_deviations_of_parts_are_estimated() -> None:
    """Outputs in two units, one a thousand times the other: scales must not matter."""
    y = decay(t, 2.0, 1.5) + 0.02 * rng.standard_normal(30)
    z = 1e3 * (decay(t, 5.0, 1.5) + 0.2 * rng.standard_normal(30))

    def second(t, c, b):
        return 1e3 * c * np.exp(-b * t)

    space = {"a": (0, 10), "b": (0.1, 10), "c": (0, 10)}
    fit = miho.fit_joint({"V": (decay, t, y), "F": (second, t, z)}, space)
    assert "Converged: " in fit.optimum
    sigma = np.unique(fit.problem.dataset["sigma of the row"])
    freedom = 60 / (60 - 3)
    for name, value, data, model in (("V", sigma[0], y, decay), ("F", sigma[1], z, second)):
        predicted = model(t, *(fit.values[k] for k in ("ab" if name == "V" else "cb")))
        assert value == pytest.approx(np.sqrt(np.mean((data - predicted) ** 2) * freedom), rel=1e-3)
    weights = np.repeat([1 / sigma[0], 1 / sigma[1]], 30)
    best = fit.problem.errors(fit.theta) / fit.problem.scale
    assert best == pytest.approx(weights * np.append(
        decay(t, fit.values["a"], fit.values["b"]) - y, second(t, fit.values["c"], fit.values["b"])
        - z), abs=1e-9)  # fmt: skip


def test_tires_of_an_axle_share_what_is_told_to_be_shared() -> None:
    """B and C of both sides, D and the offsets of each; without noise the truth is found."""
    alpha = np.linspace(-0.15, 0.15, 120)
    shared = {"B": 12.0, "C": 1.5}
    own = {"left": (4000.0, 0.002, 30.0), "right": (3500.0, -0.001, -20.0)}
    parts = {}
    for side, values in own.items():
        theta = np.array([[*shared.values(), *values]])
        force = Pacejka().predict(theta, alpha)[0] + rng.normal(0, 5, 120)
        parts[side] = Part(Pacejka(), alpha, force, 5.0)
    box = {"B": (2, 40), "C": (1, 2), "D": (1e3, 1e4), "Sx": (-0.05, 0.05), "Sy": (-500, 500)}
    fit = miho.fit_joint(parts, box, local=["D", "Sx", "Sy"])
    truth = {**shared}
    for side, values in own.items():
        truth |= {f"{n}_{side}": v for n, v in zip(("D", "Sx", "Sy"), values, strict=True)}
    table = fit.parameters
    z = [(table.loc[n, "value"] - v) / table.loc[n, "standard_error"] for n, v in truth.items()]
    assert np.abs(z).max() < 4.5  # 8 standard normal numbers exceed it in 5 of 100,000 cases
    assert table["unit"].to_dict()["D_left"] == "N"
    assert fit.part("left").parameters.loc["B", "value"] == table.loc["B", "value"]
    fit.part("left").plot()
    # Each tire has its own stiffness, whose error is that of a product (Eq. 14).
    report = fit.report(profiles=False)
    derived = report.derived.set_index("quantity")
    place = [list(fit.values).index(name) for name in ("B", "C", "D_right")]
    theta, covariance = fit.theta[place], report.at.covariance[np.ix_(place, place)]
    row = derived.loc["cornering stiffness B C D (Eq. 14), right"]
    assert row["value"] == pytest.approx(theta.prod())
    slopes = theta.prod() / theta
    assert row["standard error"] == pytest.approx(np.sqrt(slopes @ covariance @ slopes), rel=1e-3)


def test_each_tire_of_a_joint_fit_has_its_own_convention_and_ranges() -> None:
    alpha = np.linspace(-0.15, 0.15, 60)
    force = Pacejka().predict(np.array([[12.0, 1.5, 4000.0, 0.0, 0.0]]), alpha)[0]
    box = {"B": (2, 40), "C": (1, 2), "D": (1e3, 1e4), "Sx": (-0.05, 0.05), "Sy": (-500, 500)}
    left, other = Part(Pacejka(), alpha, force), Part(Pacejka(), alpha, -force)
    with pytest.raises(ValueError, match=r"^right: Fy: .*convention='adapted-sae'"):
        miho.fit_joint({"left": left, "right": other}, box)
    with pytest.raises(ValueError, match=r"^left: alpha, row 1: .* expected 0.2 to 1"):
        miho.fit_joint({"left": left._replace(ranges={"alpha": (0.2, 1)}), "right": left}, box)
    fit = miho.fit_joint({"left": left, "right": other._replace(convention="adapted-sae")}, box)
    assert fit.values["D"] == pytest.approx(4000, rel=1e-6)
    meant = {"left": left, "right": other}, box | {"D_right": (-1e4, -1e3)}
    assert miho.fit_joint(*meant, local="D").values["D_right"] == pytest.approx(-4000, rel=1e-6)


def test_a_row_to_measure_next_counts_by_the_sigma_of_its_part() -> None:
    """Of lines in closed form: the covariance with the chosen rows is the inverse of their sum."""
    parts = {"left": (line, t, 1 + t, 0.1), "right": (line, t, 3 + t, 0.4)}
    fit = miho.fit_joint(parts, {"a": (-9, 9), "b": (-9, 9)}, local=["a"])
    candidates = pd.DataFrame({PART: [0.0, 1.0, 1.0], "t": [5.0, 5.0, 8.0]})
    design = optimal_design(fit.report(profiles=False), candidates, 1, goal="b")
    X = np.zeros((63, 3))
    X[:, 1] = [*t, *t, 5, 5, 8]
    X[[*range(30), 60], 0], X[[*range(30, 60), 61, 62], 2] = 1, 1
    w = np.array([10.0] * 30 + [2.5] * 30 + [10.0, 2.5, 2.5])

    def error(*rows: int) -> float:
        used = (X * w[:, None])[[*range(60), *rows]]
        return float(np.sqrt(np.linalg.inv(used.T @ used)[1, 1]))

    narrower = [100 * (1 - error(row) / error()) for row in (60, 61, 62)]
    assert design.gains["narrows b by %"].tolist() == pytest.approx(narrower, rel=1e-6)
    with pytest.raises(
        ValueError, match="'part of the row' is 2; expected the number of a part, 0 to 1"
    ):
        optimal_design(fit.report(profiles=False), candidates.replace(0.0, 2.0), 1)


def test_joint_parameters_can_be_tied() -> None:
    y, z = decay(t, 2.0, 1.5), decay(t, 2.0, 3.0)
    parts = {
        "slow": (decay, t, y + 0.01 * rng.standard_normal(30), 0.01),
        "fast": (decay, t, z + 0.01 * rng.standard_normal(30), 0.01),
    }
    box = {"a": (0, 5), "b": (0, 9)}
    fit = miho.fit_joint(parts, box, local=["b"], tied={"b_fast": "2 * b_slow"})
    assert fit.values["b_fast"] == pytest.approx(2 * fit.values["b_slow"])
    table = fit.parameters
    assert table.loc["b_fast", "standard_error"] == pytest.approx(
        2 * table.loc["b_slow", "standard_error"]
    )
    assert fit.part("fast").values["b"] == fit.values["b_fast"]


def two_decays() -> tuple[np.ndarray, np.ndarray]:
    """Of one rate and own amplitudes, the second ten times as noisy."""
    noise = np.random.default_rng(7).standard_normal((2, 30))
    return decay(t, 2.0, 1.5) + 0.05 * noise[0], decay(t, 5.0, 1.5) + 0.5 * noise[1]


@pytest.mark.parametrize("sigma", [(None, None), (0.05, None), (0.05, 0.5)])
def test_a_rate_in_common_has_the_largest_likelihood(sigma: tuple[float | None, ...]) -> None:
    """By SciPy: of sigma that is not given the logarithm of its sum of squares is what it leaves in
    the likelihood. To a hundredth of a standard error, as sigma is to four digits."""
    data = two_decays()
    parts = {k: Part(decay, t, y, s) for k, y, s in zip("AB", data, sigma, strict=True)}
    fit = miho.fit_joint(parts, {"a": (0, 9), "b": (0, 9)}, local=["a"])

    def minus_log_likelihood(theta: np.ndarray) -> float:
        total = 0.0
        for y, a, s in zip(data, theta[::2], sigma, strict=True):
            squares = float(np.sum((y - decay(t, a, theta[1])) ** 2))
            freedom = 30 * (1 - 3 / 60)
            total += squares / s**2 / 2 if s else freedom * np.log(squares) / 2
        return total

    best = scipy.optimize.minimize(
        minus_log_likelihood, [2.0, 1.5, 5.0], method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-12},
    )  # fmt: skip
    off = np.abs(fit.theta - best.x) / fit.parameters["standard_error"]
    assert off.max() < 0.01
    assert fit.problem.sigma_known == (sigma[0] is not None)


def test_parts_of_one_formula_are_one_formula() -> None:
    """It gives what the parts' own models give; rows of two parts are no neighbours."""
    y, z = two_decays()
    parts = {"A": Part(decay, t, y), "B": Part(decay, t[:20], z[:20])}
    problem = miho.fit_joint(parts, {"a": (0, 9), "b": (0, 9)}, local=["a"]).problem
    model = pickle.loads(pickle.dumps(problem.model))
    assert isinstance(model, JointExpression)
    by_part, thetas = JointModel(parts_of(model)), np.array([[1.0, 0.3, 7.0], [2.0, 4.0, 3.0]])
    np.testing.assert_allclose(
        model.predict(thetas, *problem.inputs), by_part.predict(thetas, *problem.inputs), rtol=1e-14
    )
    np.testing.assert_allclose(
        model.jacobian(thetas[0], *problem.inputs),
        by_part.jacobian(thetas[0], *problem.inputs),
        rtol=1e-13,
    )
    assert model.linear == by_part.linear == ("a_A", "a_B")
    assert series_of(problem) == [slice(0, 30), slice(30, 50)]
    other = miho.fit_joint(
        {"A": (decay, t, y), "B": (line, t, z)}, {"a": (0, 9), "b": (-9, 9)}, local=["a", "b"]
    )
    assert not isinstance(other.problem.model, TracedExpression)


@dataclass(frozen=True)
class Scaled(Expression):
    """A line times numbers that its value takes from a field, which does not compare."""

    scales: np.ndarray
    inputs, parameters, output, linear = {"t": "-"}, {"a": "-", "b": "-"}, "-", ("a", "b")

    @property
    def value(self):
        scale = float(self.scales[0])
        return lambda inputs, theta: scale * (theta[0] + theta[1] * inputs[0])

    @property
    def derivatives(self):
        scale = float(self.scales[0])
        return lambda inputs, theta: (scale + 0 * inputs[0], scale * inputs[0])


def test_models_that_do_not_compare_are_asked_part_by_part() -> None:
    parts = {
        name: (Scaled(np.array([scale, 1.0])), t, scale * (1 + 2 * t), 0.1)
        for name, scale in (("A", 2.0), ("B", 5.0))
    }
    fit = miho.fit_joint(parts, {"a": (-9, 9), "b": (-9, 9)})
    assert fit.values == pytest.approx({"a": 1.0, "b": 2.0})
    assert not isinstance(fit.problem.model, TracedExpression)


@needs_machine
def test_a_joint_formula_runs_on_the_machine() -> None:
    """To what NumPy gives, and the same optimum."""
    y, z = two_decays()
    parts = {"A": Part(decay, t, y, 0.05), "B": Part(decay, t, z, 0.5)}
    box = {"a": (0, 9), "b": (0, 9)}
    fit = miho.fit_joint(parts, box, local=["a"], compiled=True)
    assert fit.problem.kernel is not None
    slow = replace(fit.problem, compiled=False)
    thetas = fit.problem.space.decode(fit.problem.space.initial(20))
    np.testing.assert_allclose(fit.problem.loss(thetas), slow.loss(thetas), rtol=1e-12)
    plain = miho.fit_joint(parts, box, local=["a"])
    np.testing.assert_allclose(fit.theta, plain.theta, rtol=1e-6)


def test_held_out_rows_and_conditions_of_parts_stay() -> None:
    """The error on rows that no fit saw, weighted as the rest, by hand."""
    y, z = two_decays()
    units = {"t": "-", "load": "N", "y": "-", "s": "-"}
    members = {}
    for name, values, s in (("A", y, 0.05), ("B", z, 0.5)):
        columns = {"t": t, "load": 10 * t, "y": values, "s": np.full(30, s)}
        data = miho.Dataset(name, columns, units, "y")
        model = miho.models.FunctionModel(decay, columns=("t",))
        members[name] = Measured(model, data.hold_out({"t": (0.5, 0.6)}) if s > 0.1 else data, "s")
    joint = Joint(members, ["a"])
    assert list(joint.dataset.columns) == [
        PART, "t", "load", "output of the part", "sigma of the row"
    ]  # fmt: skip
    held = joint.dataset.held_out
    assert held is not None
    assert set(held[PART]) == {1.0}
    problem = joint.problem(joint.space({"a": (0, 9), "b": (0, 9)}))
    theta = np.array([2.0, 1.5, 5.0])
    out = replace(problem, dataset=held).errors(theta)
    inside = (t >= 0.5) & (t <= 0.6)
    np.testing.assert_allclose(out, (decay(t, 5.0, 1.5) - z)[inside], atol=1e-14)


@pytest.mark.parametrize(
    ("parts", "keywords", "message"),
    [
        ({"one": (decay, t, t)}, {}, "parts: expected at least two, got 1"),
        ([(decay, t, t)] * 2, {}, "parts are a list; give them by name"),
        (
            {"A": (decay, t, t, 1.0), "B": (decay, t, t, -1)},
            {},
            "B: sigma is -1 in row 1",
        ),
        ({"A": (decay, t, t), "B": (decay, [0, 1], [1, 2])}, {}, "B: 2 rows for 2 parameters"),
        ({"A": (decay, t, t), "B": (decay, t, t)}, {"local": ["q"]}, "local: q is not a parameter"),
        (
            {"A": (decay, t, t), "B": (line, t, t)},
            {"fixed": {"z": 1}},
            "fixed: z is not a parameter",
        ),
        ({"A": (decay, t, t), "B": (decay, t, t[:4])}, {}, "differ in length"),
        ({"A": (decay, t, t), "B": (decay, t)}, {}, "B: expected .*, got a tuple of 2 entries"),
        ({"A": decay, "B": decay}, {}, "A: expected .* got a function"),
        ({1: (decay, t, t), 2: (decay, t, t)}, {}, "parts: 1 is no name; give"),
        ({"A": (decay, t, t), "B": (Pacejka(), t, t)}, {}, "B: Fy: Fy rises with alpha"),
        (
            {"A": (miho.load_tir(embedded_tire("lf")), t, t)},
            {},
            "a MagicFormula; expected its parameters",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(parts, keywords, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        miho.fit_joint(parts, {"a": (0, 5), "b": (0, 5)}, **keywords)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("level", [0.0, 5.0])
def test_a_part_whose_output_is_constant_needs_no_sigma(level: float) -> None:
    t = np.linspace(0.0, 1.0, 20)
    noisy = 3 * t + 0.1 * np.random.default_rng(0).standard_normal(20)
    parts = {"flat": (lambda t, a, b: a + b * t, t, np.full(20, level)),
             "rising": (lambda t, a, c: a + c * t, t, level + noisy)}  # fmt: skip
    fit = miho.fit_joint(parts, {"a": (-9, 9), "b": (-9, 9), "c": (-9, 9)}, compiled=False)
    assert fit.values["a"] == pytest.approx(level, abs=1e-9)
    assert fit.values["c"] == pytest.approx(3.0, abs=0.2)


def magic(x, B, C, D, E):
    return D * np.sin(C * np.arctan(B * x - E * (B * x - np.arctan(B * x))))


def test_a_part_spans_the_optima_that_the_data_of_all_cannot_tell_apart() -> None:
    x = np.linspace(-0.8, 0.8, 60)
    noise = np.random.default_rng(3).standard_normal((2, x.size))
    left, right = magic(x, 5.4, 1.5, 1.0, -0.5) + 0.02 * noise
    bounds = {"B": (1, 30), "C": (0.5, 3), "D": (0.1, 3), "E": (-10, 1)}
    fit = miho.fit_joint({"left": (magic, x, left), "right": (magic, x, right)}, bounds)
    assert len(fit.alternatives) > 1, "or this tests nothing"
    part = fit.part("right")
    assert part.alternatives["B"].tolist() == fit.alternatives["B"].tolist()
    assert part.alternatives["excess"].tolist() == fit.alternatives["excess"].tolist()
    for end in ("low", "high"):
        own = part.parameters[end].to_dict()
        assert own == pytest.approx(fit.parameters[end].to_dict(), rel=1e-6)


def test_a_part_states_its_parameters_as_the_joint_fit_does() -> None:
    def settling(t, a, b, c=0.5):
        return a * np.exp(-b * t) + c

    noise = 0.05 * np.random.default_rng(0).standard_normal((2, t.size))
    left, right = settling(t, 2, 1.5) + noise[0], settling(t, 3, 1.5) + noise[1]
    fit = miho.fit_joint(
        {"left": (settling, t, left), "right": (settling, t, right)},
        {"a": (0, 10), "b": (0, 1)},
        local=["a"],
        tied={"a_right": "1.5 * a_left"},
    )
    part = fit.part("right")
    expected = fit.parameters.loc[["a_right", "b", "c"]].set_axis(["a", "b", "c"])
    assert expected["status"].tolist() == ["= 1.5 * a_left", "at upper bound", "fixed"]
    pd.testing.assert_frame_equal(part.parameters, expected)
    assert "b = 1 (at its upper bound)" in str(part)


def test_a_pickled_part_keeps_what_all_parts_know() -> None:
    """A report of the part's data alone would have other values, so that the joint fit is named."""
    noise = 0.05 * np.random.default_rng(3).standard_normal((2, t.size))
    left, right = line(t, 1, 2) + noise[0], line(t, 3, 2) + noise[1]
    parts = {"left": (line, t, left), "right": (line, t, right)}
    fit = miho.fit_joint(parts, {"a": (-9, 9), "b": (-9, 9)}, local=["a"], compiled=False)
    part = fit.part("right")
    copy = pickle.loads(pickle.dumps(part))
    pd.testing.assert_frame_equal(copy.parameters, part.parameters)
    assert copy.predict(0.5).high == part.predict(0.5).high
    assert str(copy) == str(part)
    for each in (part, copy):
        for what in ("report", "posterior"):
            with pytest.raises(ValueError, match=f"{what}: part 'right' needs the joint fit"):
                getattr(each, what)()
    pd.testing.assert_frame_equal(copy.parameters, part.parameters)


def test_a_column_of_one_part_may_be_a_parameter_of_another_one() -> None:
    v = np.linspace(1, 2, 20)
    parts = {
        "drag": (lambda v, c: c * v**2, {"v": v}, 0.3 * v**2, 0.1),
        "speed": (lambda t, v: v * t, {"t": t}, 5.0 * t, 0.1),
    }
    fit = miho.fit_joint(parts, {"c": (0, 1), "v": (0, 10)})
    assert fit.values == pytest.approx({"c": 0.3, "v": 5.0})


def test_a_joint_fit_descends_from_a_start() -> None:
    """Two lines in closed form; without bounds, sigma estimated or known."""
    rng = np.random.default_rng(0)
    y = {"low": 1 + 2 * t + rng.normal(0, 0.1, t.size), "high": 3 + 2 * t}
    y["high"] += rng.normal(0, 0.1, t.size)
    columns = np.kron(np.eye(2), np.ones((t.size, 1)))
    columns = np.column_stack([columns, np.tile(t, 2)])
    low, high, slope = np.linalg.lstsq(columns, np.concatenate([*y.values()]), rcond=None)[0]
    parts = {name: (line, t, values, 0.1) for name, values in y.items()}
    fit = miho.fit_joint(parts, start={"a": 1, "a_high": 5, "b": 1}, local=["a"])
    assert fit.values == pytest.approx({"a_low": low, "b": slope, "a_high": high}, rel=1e-6)
    assert fit.descents is None
    without = {name: part[:3] for name, part in parts.items()}
    unknown = miho.fit_joint(without, start=fit.values, local=["a"])
    assert unknown.values["b"] == pytest.approx(slope, abs=0.1)
    held = miho.fit_joint(parts, {"b": (0, 5)}, start={"b": 1}, local=["a"], fixed={"a": 2.0})
    assert held.parameters["status"].tolist() == ["fixed", "free", "fixed"]
    for start, message in (({"b": 1}, "a_low has no bounds"), ([1], "give its values by name")):
        with pytest.raises(ValueError, match=message):
            miho.fit_joint(parts, start=start, local=["a"])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="method is 'steepest'"):
        miho.fit_joint(parts, start={"a": 1, "b": 1}, local=["a"], method="steepest")


def test_a_unit_that_one_part_does_not_know_is_that_of_another_part() -> None:
    """A function without annotations has unknown units."""

    def part_in(unit: str) -> tuple:
        def turn(t, *, f):
            return f * t

        turn.__annotations__ = {"f": repr(unit)} if unit else {}  # as text of the source
        return turn, t, 2 * t

    fit = miho.fit_joint({"a": part_in(""), "b": part_in("Hz")}, {"f": (0, 5)})
    assert fit.values["f"] == pytest.approx(2.0)
    assert fit.parameters["unit"].tolist() == ["Hz"]
    spelled = {"a": part_in("1/s"), "b": part_in("Hz")}
    assert miho.fit_joint(spelled, {"f": (0, 5)}).parameters["unit"].tolist() == ["1/s"]
    with pytest.raises(ValueError, match="f has the unit 'Hz' in b and 'kg' in c"):
        miho.fit_joint({"a": part_in(""), "b": part_in("Hz"), "c": part_in("kg")}, {"f": (0, 5)})


def test_a_local_name_that_another_part_has_is_refused() -> None:
    t = np.linspace(0, 1, 9)
    parts = {"p": (lambda t, a, b: a + b * t, t, t), "q": (lambda t, a_p, b: a_p + b * t, t, t)}
    box = {"a": (0, 5), "b": (0, 5), "a_p": (0, 5)}
    with pytest.raises(ValueError, match="a_p is also a parameter that is not local; rename"):
        miho.fit_joint(parts, box, local="a")


@pytest.mark.parametrize(("loss", "factor"), [("huber", 1.345), ("cauchy", 2.385)])
def test_a_robust_loss_of_all_parts_is_scipys(loss: str, factor: float) -> None:
    """Optima of both programs agree to the tolerance of SciPy's descent."""
    rng = np.random.default_rng(0)
    t = np.linspace(0, 2, 60)
    y = 2 * np.exp(-1.5 * t) + rng.normal(0, 0.02, 60)
    z = 3000 * t + rng.normal(0, 10, 60)
    y[::9] += 1
    z[::11] -= 600
    parts: dict[str, tuple[Any, ...]] = {
        "p": (lambda t, a, b: a * np.exp(-b * t), t, y, 0.02),
        "q": (lambda t, a, b: 1000 * a * b * t, t, z, 10.0),
    }
    box = {"a": (0, 5), "b": (0, 10)}

    def residuals(p: np.ndarray) -> np.ndarray:
        return np.concatenate([(f(t, *p) - v) / s for f, t, v, s in parts.values()])

    expected = scipy.optimize.least_squares(
        residuals, [2, 1.5], loss=loss, f_scale=factor, xtol=1e-12
    ).x
    assert miho.fit_joint(parts, box, loss=loss).theta == pytest.approx(expected, rel=1e-5)
    parts["p"] = parts["p"][:3]
    with pytest.raises(ValueError, match="p: lacks sigma, which a robust loss needs"):
        miho.fit_joint(parts, box, loss=loss)
