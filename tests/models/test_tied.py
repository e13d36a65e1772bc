"""Tied models against the same written out, and limits against constrained least squares."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.stats import t as student

import miho
from miho.identification.parameters_file import identified
from miho.models.model import central_differences
from miho.models.tied import TiedModel, Ties, tie
from miho.vehicle.models import Pacejka

ALPHA = np.linspace(-0.2, 0.2, 21)
VALUES = {"B": 12.0, "C": 1.5, "D": 4000.0, "Sx": 0.003, "Sy": 10.0}


@pytest.mark.parametrize(
    ("ties", "linear"),
    [
        ({"C": 1.6}, ("D", "Sy")),
        ({"C": np.int64(2)}, ("D", "Sy")),
        ({"C": np.float32(1.6)}, ("D", "Sy")),
        ({"Sy": "100 * Sx"}, ("D",)),
        ({"Sy": "2 * D"}, ("D",)),
        ({"C": "1 + B / 30", "Sy": "D * 0.01 + 3"}, ("D",)),
        ({"D": "exp(Sy / 10)"}, ()),
        ({"D": "B * 300", "B": "8 * C"}, ("Sy",)),
    ],
)
def test_a_tied_model_is_the_whole_one_at_tied_values(ties, linear: tuple[str, ...]) -> None:
    model = Pacejka()
    free = {name: unit for name, unit in model.parameters.items() if name not in ties}
    tied = tie(model, Ties(tuple(model.parameters), free, ties))
    theta = np.array([VALUES[name] for name in free])
    whole = tied.ties.whole(theta[None])  # type: ignore[attr-defined]
    assert np.array_equal(tied.predict(theta[None], ALPHA), model.predict(whole, ALPHA))
    J = tied.jacobian(theta, ALPHA)
    np.testing.assert_allclose(
        J, central_differences(tied.predict, theta, ALPHA), rtol=1e-6, atol=1e-8 * np.abs(J).max()
    )
    assert tied.linear == linear
    by_numpy = TiedModel(model, tied.ties)  # type: ignore[attr-defined]
    np.testing.assert_allclose(by_numpy.jacobian(theta, ALPHA), J, rtol=1e-10)
    assert tied.whole is model
    copy = pickle.loads(pickle.dumps(tied))
    assert np.array_equal(copy.predict(theta[None], ALPHA), tied.predict(theta[None], ALPHA))


@pytest.mark.parametrize(
    ("ties", "message"),
    [
        ({"B": "C", "C": "B"}, "B -> C -> B is a cycle"),
        ({"B": "q + 1"}, "uses an unknown parameter q"),
        ({"B": "C +"}, "is not an expression"),
        ({"B": "__import__('os')"}, "is not allowed"),
        ({"B": "C.real"}, "'C.real' is not allowed"),
        ({"B": "[C][0]"}, "is not allowed"),
        ({"B": "C if C else 1"}, "is not allowed"),
        ({"B": "1" * 400}, "contains a number that is too large"),
        ({"B": "1 / 0"}, "expected a finite number"),
        ({"B": "True"}, "is not allowed"),
        ({"B": "(" * 300 + "C" + ")" * 300}, "is not an expression|nested too deep"),
        ({"B": "C" + " + C" * 1000}, "is not an expression"),
    ],
)
def test_only_arithmetic_is_an_expression(ties: dict[str, str], message: str) -> None:
    free = {name: "" for name in VALUES if name not in ties}
    with pytest.raises(ValueError, match=message) as caught:
        Ties(tuple(VALUES), free, ties)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(4))
def test_a_limit_that_is_active_is_followed(seed: int) -> None:
    """Shares that sum to 1, the third truly 0: its limit holds, and the others' optimum along it is
    that of one unknown, in closed form."""
    A = np.random.default_rng(3).random((50, 3))
    y = A @ [0.6, 0.4, 0.0] + 0.02 * np.random.default_rng(seed).standard_normal(50)
    fit = miho.fit(
        lambda x, y, z, a, b, c: a * x + b * y + c * z, tuple(A.T), y,
        dict.fromkeys("abc", (0, 1)), tied={"c": "1 - a - b"}, compiled=False,
    )  # fmt: skip
    X = np.stack([A[:, 0] - A[:, 2], A[:, 1] - A[:, 2]], axis=1)
    a, b = np.linalg.lstsq(X, y - A[:, 2], rcond=None)[0]
    if a + b > 1:  # then on the line a + b = 1
        a = float(np.linalg.lstsq((A[:, 0] - A[:, 1])[:, None], y - A[:, 1], rcond=None)[0][0])
        b = 1 - a
        assert "c ends at its limit 0" in fit.optimum
    assert [fit.values["a"], fit.values["b"]] == pytest.approx([a, b], abs=1e-4)


def test_profiles_follow_a_limit_that_is_active() -> None:
    """With one share given, what is left of 1 goes to the others as least squares say, or as near
    as their limits allow; c's own interval ends at its limit."""
    A = np.random.default_rng(3).random((50, 3))
    y = A @ [0.6, 0.4, 0.0] + 0.02 * np.random.default_rng(2).standard_normal(50)
    fit = miho.fit(
        lambda x, y, z, a, b, c: a * x + b * y + c * z, tuple(A.T), y,
        dict.fromkeys("abc", (0, 1)), tied={"c": "1 - a - b"}, compiled=False,
    )  # fmt: skip
    assert "c ends at its limit 0" in fit.optimum

    def cost(value: float, k: int) -> float:
        j, other = (place for place in range(3) if place != k)
        rest = y - value * A[:, k] - (1 - value) * A[:, other]
        direction = A[:, j] - A[:, other]
        share = np.clip(direction @ rest / (direction @ direction), 0, 1 - value)
        return float(np.sum((rest - share * direction) ** 2))

    report = fit.report()
    profiles = {**dict(zip("ab", report.profiles, strict=True)), **report.tied_profiles}
    for k, name in enumerate("abc"):
        grid = np.clip(fit.values[name] + np.linspace(-0.03, 0.03, 2001), 0, 1)
        costs = np.array([cost(value, k) for value in grid])
        inside = grid[costs <= costs.min() * (1 + student.ppf(0.975, 48) ** 2 / 48)]
        # A refit at a limit stays 1e-9 inside, and an end is found to 0.3 % of the half width.
        ends = [profiles[name].low, profiles[name].high]
        assert ends == pytest.approx([inside[0], inside[-1]], abs=1e-4)
    row = report.derived.iloc[0]
    assert row["profile low"] == 0
    assert row["profile high"] == profiles["c"].high
    stored = identified(report, {}).parameters["c"]
    assert (stored.low, stored.high) == (0, profiles["c"].high)


def test_a_quantity_that_the_model_does_not_have_is_told_of_as_well() -> None:
    model, alpha = Pacejka(), np.linspace(-0.2, 0.2, 60)
    rng = np.random.default_rng(0)
    force = model.predict(np.array([list(VALUES.values())]), alpha)[0] + rng.normal(0, 20, 60)
    box = {"B": (2, 40), "C": (1, 2), "D": (1e3, 1e4), "Sx": (-0.05, 0.05), "Sy": (-500, 500)}
    plain = miho.fit(model, alpha, force, box)
    fit = miho.fit(model, alpha, force, {**box, "K": {"unit": "N/rad"}}, tied={"K": "B * C * D"})
    B, C, D = (plain.values[name] for name in "BCD")
    gradient = np.array([C * D, B * D, B * C, 0, 0])
    row = fit.parameters.loc["K"]
    assert row["value"] == pytest.approx(B * C * D, rel=1e-5)
    assert row["unit"] == "N/rad"
    spread = np.sqrt(gradient @ plain.uncertainty.covariance @ gradient)
    assert row["standard_error"] == pytest.approx(spread, rel=1e-3)


@pytest.mark.parametrize("theta", [0.0, 5e-324, 1e-200, 1e-17])
def test_a_vanishing_parameter_has_differences(theta: float) -> None:
    """Steps in the scale of the smallest floats would be 0."""
    slope = central_differences(lambda rows, x: rows + 1.0 + 0 * x, np.array([theta]), np.ones(3))
    np.testing.assert_allclose(slope, np.ones((3, 1)), rtol=1e-6)
