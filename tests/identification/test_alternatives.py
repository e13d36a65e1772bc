"""Optima that the data cannot tell apart, on a Magic Formula with curvature that has two."""

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import miho
from miho import Fit
from miho.data import Dataset
from miho.identification import CurveFit, linearised, make_report
from miho.identification.alternatives import (
    hull,
    optima_table,
    optima_within_noise,
    several_values,
)
from miho.identification.bootstrap import bootstrap
from miho.identification.refit import Refit, refit
from miho.optim import Descents, Minimum, Parameter, Space
from miho.quantities import Array
from miho.vehicle.models import Pacejka
from tests.identification.profiles import profile_of
from tests.printed import flat

LOWER, UPPER = np.array([3.799, 1.981, 1.0, 0.907]), np.array([5.329, 1.417, 1.0, 0.026])
"""Parameters B, C, D, E of the two optima; the truth is 5.385, 1.4, 1 and 0."""
DIGITS = 2e-3
"""Optima are known to this: to half a unit of their last digit, of E's 0.026 to 2 %."""


def magic_formula(x: Array, *, B: float, C: float, D: float, E: float) -> Array:
    return D * np.sin(C * np.arctan(B * x - E * (B * x - np.arctan(B * x))))


@cache
def problem() -> CurveFit:
    """One curve within 0.8 rad with 2 % noise."""
    x = np.linspace(-0.8, 0.8, 161)
    noise = 0.02 * np.random.default_rng(1).standard_normal(x.size)
    columns = {"x": x, "y": magic_formula(x, B=5.385, C=1.4, D=1.0, E=0.0) + noise}
    ranges = {"B": (1, 30), "C": (0.5, 3), "D": (0.1, 3), "E": (-10, 1)}
    space = Space(tuple(Parameter(name, "", *ends) for name, ends in ranges.items()))
    data = Dataset("curve", columns, dict.fromkeys(columns, ""), "y")
    return CurveFit(magic_formula, data, space, compiled=False)  # type: ignore[arg-type]


def minimum(fit: CurveFit, theta: Array) -> Minimum:
    return Minimum(float(fit.loss(theta[None])[0]), tuple(theta.tolist()))


@cache
def best() -> Refit:
    return refit(problem(), LOWER)


@cache
def both() -> tuple[Refit, ...]:
    return optima_within_noise(problem(), best(), [minimum(problem(), UPPER)])


def descents(fit: CurveFit, *thetas: Array) -> Descents:
    """Seven that agree, and where they ended."""
    minima = tuple(minimum(fit, theta) for theta in thetas)
    return Descents(7, 7, 7, 0, (minima[0].loss,) * 7, agreeing=7, minima=minima)


def test_optima_within_the_noise_are_told_together() -> None:
    lower, upper = both()
    assert lower.theta == pytest.approx(LOWER, abs=DIGITS)
    assert upper.theta == pytest.approx(UPPER, abs=DIGITS)
    optima = [linearised(problem(), fit.theta) for fit in both()]
    table = optima_table(problem(), optima)
    assert table["optimum"].tolist() == [1, 2]
    assert table["excess"].tolist() == pytest.approx([0, 0.0668], abs=2e-3)
    assert table["B"].tolist() == [lower.theta[0], upper.theta[0]]
    first, second = several_values(problem(), optima)
    assert "B is 3.799 or 5.329; C is 1.981 or 1.417; E is 0.9074 or 0.02639" in first
    assert "D is" not in first, "which has one value"
    assert "B C = 7.526 or 7.549 ± 0.0" in second
    assert several_values(problem(), optima[:1]) == []
    assert optima_table(problem(), optima[:1]).empty


def test_an_optimum_counts_once_and_the_best_is_first() -> None:
    fit = problem()
    lower, upper = both()
    near = [minimum(fit, theta) for theta in (UPPER, 1.001 * UPPER, LOWER, upper.theta)]
    assert len(optima_within_noise(fit, lower, near)) == 2
    first, second = optima_within_noise(fit, upper, [minimum(fit, LOWER)])
    assert first.theta == pytest.approx(lower.theta, rel=1e-4), "refits agree to their tolerance"
    assert second is upper
    far = np.array([20.0, 0.6, 1.1, -5.0])
    assert optima_within_noise(fit, lower, [minimum(fit, far)]) == (lower,)
    assert optima_within_noise(fit, lower, []) == (lower,)


def test_less_noise_tells_them_apart() -> None:
    fit = replace(problem(), sigma=0.001)  # a twentieth: chi-squared differs by 400 times as much
    assert optima_within_noise(fit, best(), [minimum(fit, UPPER)]) == (best(),)
    assert len(optima_within_noise(replace(fit, sigma=0.02), best(), [minimum(fit, UPPER)])) == 2


def test_a_symmetry_repeats_one_optimum() -> None:
    t = np.linspace(0, 3, 60)
    y = 2 * np.exp(-4 * t) + np.exp(-t) + 0.01 * np.random.default_rng(0).standard_normal(t.size)
    bounds = {"a": (0, 5), "b": (0, 9), "c": (0, 5), "d": (0, 9)}

    def two(t: Array, a: float, b: float, c: float, d: float) -> Array:
        return a * np.exp(-b * t) + c * np.exp(-d * t)

    start = {"a": 2.0, "b": 4.0, "c": 1.0, "d": 1.0}
    fit = miho.fit(two, t, y, bounds, start=start, compiled=False)
    swapped = minimum(fit.problem, fit.theta[[2, 3, 0, 1]])
    optimum = refit(fit.problem, fit.theta)
    assert optima_within_noise(fit.problem, optimum, [swapped]) == (optimum,)


def test_a_profile_spans_all_optima() -> None:
    at, other = (linearised(problem(), fit.theta) for fit in both())
    for k, (near, far) in enumerate(zip(LOWER, UPPER, strict=True)):
        alone = profile_of(problem(), at, k)
        curve = profile_of(problem(), at, k, others=[other])
        assert curve.low < min(near, far)
        assert max(near, far) < curve.high
        assert curve.low <= alone.low + 1e-3 * abs(alone.low)  # ends are known to 0.5 % of tau
        assert alone.high <= curve.high + 1e-3 * abs(curve.high)


def test_a_parameter_at_its_bound_in_one_optimum_has_the_profile_of_the_other() -> None:
    *others, E = problem().space.parameters
    fit = replace(problem(), space=Space((*others, replace(E, high=0.9))))
    report = make_report(fit, LOWER, descents=descents(fit, LOWER, UPPER), profiles=True)
    row = report.parameters.loc[3]
    assert row["value"] == pytest.approx(0.9, rel=1e-9)
    assert np.isnan(row["standard error"])
    assert row["linearised low"] < 0
    assert row["linearised high"] == pytest.approx(0.9, rel=0.1)
    assert row["profile low"] < 0
    assert row["profile high"] == np.inf, "open, at the edge of the box"


def test_bootstrap_replicates_end_in_the_better_optimum() -> None:
    lower, upper = (fit.theta for fit in both())
    weighted = bootstrap(problem(), lower, 40, np.random.default_rng(0), others=[upper])
    alone = bootstrap(problem(), lower, 40, np.random.default_rng(0))
    between = (lower[0] + upper[0]) / 2
    assert 5 < np.count_nonzero(weighted[:, 0] > between) < 35  # half of 40, by 4 deviations
    assert np.ptp(alone[:, 0]) < np.ptp(weighted[:, 0])


def test_report_and_fit_tell_of_them() -> None:
    fit = Fit(problem(), best().theta, best().theta, descents(problem(), LOWER, UPPER))
    for one in (fit, pickle.loads(pickle.dumps(fit))):
        assert one.alternatives["B"].tolist() == pytest.approx([3.799, 5.329], abs=DIGITS)
    low, high = fit.parameters.loc["B", ["low", "high"]]
    assert low < 3.799
    assert high > 5.329
    assert "2 optima differ by less than the noise" in flat(fit)
    report = fit.report(replicates=20)
    assert "2 optima differ by less than the noise" in flat(report)
    assert "with several optima the estimates are biased" in flat(report)
    assert "bootstrap intervals" not in flat(fit.report())
    assert report.tables["optima"]["E"].tolist() == pytest.approx([0.907, 0.026], abs=DIGITS)
    for kind in ("linearised", "sandwich", "profile"):
        low, high = report.parameters.loc[0, [f"{kind} low", f"{kind} high"]]
        assert low < 3.799
        assert high > 5.329
    alone = replace(fit, descents=None)
    assert alone.alternatives.empty
    assert alone.parameters.loc["B", "high"] < 5.329
    assert "optima differ" not in str(alone)


def test_more_digits_of_an_optimum_need_no_new_descents(monkeypatch: pytest.MonkeyPatch) -> None:
    near = best().theta * (1 + 1e-7)
    fit = Fit(problem(), near, near, descents(problem(), LOWER, UPPER))
    before = fit.alternatives
    report = fit.report(profiles=False)
    assert not np.array_equal(fit.theta, near), "or this tests nothing"
    monkeypatch.setattr("miho.identification.alternatives.optima_within_noise", None)
    assert fit.alternatives["B"].tolist() == pytest.approx(before["B"], rel=1e-4)
    assert fit.alternatives["B"].tolist() == pytest.approx(report.optima["B"], rel=1e-4)


def test_a_declared_quantity_that_optima_share_is_named() -> None:
    alpha = np.linspace(-0.3, 0.3, 61)
    columns = {"alpha": alpha, "Fy": Pacejka().predict(np.array([[-10, 1.5, 1e3, 0, 0]]), alpha)[0]}
    data = Dataset("tire", columns, {"alpha": "rad", "Fy": "N"}, "Fy")
    ranges = {"B": (-30, -1), "C": (1, 2.5), "D": (1, 5e3), "Sx": (-1, 1), "Sy": (-500, 500)}
    units = Pacejka().parameters
    space = Space(tuple(Parameter(name, units[name], *ends) for name, ends in ranges.items()))
    noisy = replace(data, columns=columns | {"Fy": columns["Fy"] + np.tile([30, -30], 31)[:61]})
    fit = CurveFit(Pacejka(), noisy, space)
    theta = refit(fit, np.array([-10, 1.5, 1e3, 0, 0])).theta
    at = linearised(fit, theta)
    other = replace(at, theta=theta * [0.5, 2, 1, 1, 1])  # as an optimum with the same B C D
    (_, shared) = several_values(fit, [at, other])
    assert "cornering stiffness B C D (Eq. 14): -1.5e+04 ± 3.6e+02 N/rad" in shared


def test_a_parameter_that_the_data_determine_nowhere_has_no_several_values() -> None:
    t = np.linspace(0, 10, 60)
    y = 0.2 * np.random.default_rng(0).standard_normal(t.size)

    def peak(t: Array, a: float, m: float, s: float, c: float) -> Array:
        return c + a * np.exp(-(((t - m) / s) ** 2))

    bounds = {"a": (0, 5), "m": (0, 10), "s": (0.001, 5), "c": (0, 5)}
    start = {"a": 1.0, "m": 5.0, "s": 1.0, "c": 0.0}
    fit = miho.fit(peak, t, y, bounds, start=start, compiled=False).problem
    unseen = [(2.0, t[:2].mean(), 0.002, 0.0), (1.0, t[1:3].mean(), 0.003, 1e-12)]  # between rows
    optima = [linearised(fit, np.array(theta)) for theta in unseen]
    assert np.isinf(optima[0].standard_errors[:3]).all(), "or this tests nothing"
    (sentence,) = several_values(fit, optima)  # nothing is shared to an infinite error
    assert "they agree in all that the data determine" in sentence


def test_hulls() -> None:
    points = [np.array([1.0, 2.0, 3.0]), np.array([5.0, 2.5, 4.0])]
    none = [np.nan, np.nan]
    ends = [np.array([[0.0, 2.0], none, none]), np.array([[4.0, 6.0], [2.4, 2.6], none])]
    spans = hull(points, ends)
    assert spans[0].tolist() == [0, 6]
    assert spans[1].tolist() == [2.0, 2.6], "at a bound: from its value"
    assert np.isnan(spans[2]).all()
