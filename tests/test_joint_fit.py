"""Several datasets and outputs at once, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

import miho
from miho import Part
from miho.models import Pacejka

t = np.linspace(0, 1, 30)
rng = np.random.default_rng(5)


def line(t, a, b):
    return a + b * t


def decay(t, a, b):
    return a * np.exp(-b * t)


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


def test_deviations_of_parts_are_estimated() -> None:
    """Outputs in two units, one a thousand times the other: scales must not matter."""
    y = decay(t, 2.0, 1.5) + 0.02 * rng.standard_normal(30)
    z = 1e3 * (decay(t, 5.0, 1.5) + 0.2 * rng.standard_normal(30))

    def second(t, c, b):
        return 1e3 * c * np.exp(-b * t)

    space = {"a": (0, 10), "b": (0.1, 10), "c": (0, 10)}
    fit = miho.fit_joint({"V": (decay, t, y), "F": (second, t, z)}, space)
    assert "none found a better one" in fit.optimum
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


@pytest.mark.parametrize(
    ("parts", "keywords", "message"),
    [
        ({"one": (decay, t, t)}, {}, "1 part; give at least two"),
        ({"A": (decay, t, t, 1.0), "B": (decay, t, t)}, {}, "B: lacks sigma"),
        ({"A": (decay, t, t), "B": (decay, t, t)}, {"local": ["q"]}, "local: q is no parameter"),
        ({"A": (decay, t, t), "B": (line, t, t)}, {"fixed": {"z": 1}}, "fixed: z is no parameter"),
        ({"A": (decay, t, t), "B": (decay, t, t[:4])}, {}, "differ in length"),
    ],
)
def test_what_does_not_fit_together_is_refused(parts, keywords, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        miho.fit_joint(parts, {"a": (0, 5), "b": (0, 5)}, **keywords)
    assert "\n" not in str(caught.value)
