"""Models with an unknown period are recognised, and their claims state a higher rate."""

# mypy: disable-error-code="no-untyped-def"
from typing import Any

import numpy as np
import pytest

import miho
from experiments.check.families import FAMILIES
from miho.identification.periodic import REMARK, searches_period
from miho.optim import Budget
from miho.vehicle.models import PacejkaCurvature
from tests.printed import flat

X = np.linspace(0, 10, 60)
RNG = np.random.default_rng(3)


def sine(x, a, w, p) -> Any:
    """A sine of any frequency and phase."""
    return a * np.sin(w * x + p)


def by_numbers(x, a, w, p):
    """The same, which needs numbers."""
    return a * np.array([np.sin(float(w) * float(v) + float(p)) for v in x])


BOUNDS = {"a": (0, 3), "w": (0.1, 6), "p": (0, 6.3)}
Y = sine(X, 1, 2, 1) + 0.1 * RNG.standard_normal(60)


@pytest.mark.parametrize("name", FAMILIES)
def test_each_family_of_the_measured_rates_is_recognised(name: str) -> None:
    problem, _ = FAMILIES[name].problem(np.random.default_rng(1))
    assert searches_period(problem) == (FAMILIES[name].kind in ("periods", "many minima"))


def test_a_claim_on_a_period_states_its_rate() -> None:
    fit = miho.fit(sine, X, Y, BOUNDS)
    assert fit.optimum.startswith("Converged: ")
    assert fit.optimum.endswith(f" %. {REMARK}.")
    assert fit.report().conclusion.statement == fit.optimum
    for text in (flat(fit), flat(fit.report())):
        assert f"{REMARK}." in text


@pytest.mark.parametrize(
    ("model", "settings"),
    [
        (sine, {"fixed": {"w": 2.0}}),
        (sine, {"space": {**BOUNDS, "w": (1.9, 2.1)}}),
        (by_numbers, {}),
        (lambda x, a, w, p: a * x**2 + w * x + p, {}),
    ],
    ids=["a known period", "less than a period", "no formula", "no sine"],
)
def test_no_rate_is_stated_if_no_period_is_searched_or_known(model, settings) -> None:
    bounds = {n: b for n, b in BOUNDS.items() if n not in settings.get("fixed", {})}
    fit = miho.fit(model, X, Y, **{"space": bounds, **settings})
    assert "period" not in fit.optimum


def test_a_period_that_is_tied_to_a_free_parameter_is_searched() -> None:
    bounds = {"a": (0, 3), "p": (0, 6.3), "T": (1, 40)}
    fit = miho.fit(sine, X, Y, bounds, tied={"w": "6.2832 / T"})
    assert searches_period(fit.problem)


@pytest.mark.parametrize("fixed", [{}, {"w": 2.0}])
def test_a_period_of_a_part_of_a_joint_fit_is_searched(fixed) -> None:
    def line(x, b):
        return b * x

    bounds = {name: ends for name, ends in {**BOUNDS, "b": (0, 9)}.items() if name not in fixed}
    for settings in ({}, {"constraints": "a < b"}):
        parts, budget = {"wave": (sine, X, Y), "line": (line, X, 3 * X + Y)}, Budget(evaluations=50)
        fit = miho.fit_joint(parts, bounds, fixed=fixed, budget=budget, **settings)
        assert searches_period(fit.problem) == (not fixed)


def test_the_sine_of_the_magic_formula_is_no_period() -> None:
    alpha = np.linspace(-0.3, 0.3, 60)
    force = PacejkaCurvature().predict(np.array([[10, 1.5, 1, -0.5, 0, 0]]), alpha)[0]
    wide = {"B": (1, 1e3), "C": (0.1, 20), "D": (0.1, 3), "E": (-9, 1)}
    fit = miho.fit(PacejkaCurvature(), alpha, force, wide, fixed={"Sx": 0, "Sy": 0})
    assert not searches_period(fit.problem)
