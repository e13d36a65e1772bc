"""Priors as residuals, against the closed form of Bayesian linear regression, and by coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import miho
from miho.identification import make_report
from tests.printed import flat

t = np.linspace(0, 1, 40)
rng = np.random.default_rng(3)
SIGMA = 0.2


def line(t, a, b):
    return a + b * t


def decay(t, a, b):
    return a * np.exp(-b * t)


def test_a_line_with_priors_is_bayesian_linear_regression() -> None:
    """Posterior mean and covariance (Gelman et al. 2013, Ch. 14.8)."""
    y = 1 + 2 * t + SIGMA * rng.standard_normal(40)
    mean, std = np.array([1.2, 1.5]), np.array([0.1, 0.3])
    X = np.stack([np.ones(40), t], axis=1)
    precision = X.T @ X / SIGMA**2 + np.diag(1 / std**2)
    covariance = np.linalg.inv(precision)
    expected = covariance @ (X.T @ y / SIGMA**2 + mean / std**2)
    space = {
        "a": {"low": -5, "high": 5, "prior": (1.2, 0.1)},
        "b": {"low": -5, "high": 5, "prior": (1.5, 0.3)},
    }
    fit = miho.fit(line, t, y, space, sigma=SIGMA, compiled=False)
    assert list(fit.values.values()) == pytest.approx(expected, rel=1e-6)
    assert fit.uncertainty.covariance == pytest.approx(covariance, rel=1e-6)
    report = fit.report()
    row = report.parameters.iloc[1]
    half = 1.959964 * np.sqrt(covariance[1, 1])
    assert (row["profile high"] - row["profile low"]) / 2 == pytest.approx(half, rel=2e-3)
    alone = np.sqrt(np.diag(np.linalg.inv(X.T @ X / SIGMA**2)))
    table = report.priors.set_index("parameter")
    assert table["error from the data alone"].tolist() == pytest.approx(alone, rel=1e-6)
    share = 100 * (1 - np.diag(covariance) / alone**2)
    assert table["of the priors [%]"].tolist() == pytest.approx(share, rel=1e-4)
    assert any("% of the information on a:" in note for note in report.notes)


def test_nothing_is_said_of_a_prior_whose_parameter_is_at_its_bound() -> None:
    """Its standard error is unknown, and so is the prior's share."""
    y = 1 - 0.5 * t + SIGMA * rng.standard_normal(40)
    space = {"a": (-5, 5), "b": {"low": 0, "high": 5, "prior": (0.2, 0.3)}}
    report = miho.fit(line, t, y, space, sigma=SIGMA, compiled=False).report(profiles=False)
    assert np.isnan(report.priors["of the priors [%]"]).all()
    assert not any("nan" in note for note in report.notes)


def test_a_prior_on_the_log_scale_is_log_normal() -> None:
    """Where the data say nothing of b, it stays at the median with the prior's spread."""
    y = np.full(40, 2.0) + SIGMA * rng.standard_normal(40)
    space = {"a": (0, 5), "b": {"low": 0.01, "high": 100, "scale": "log", "prior": (3.0, 0.2)}}
    fit = miho.fit(lambda t, a, b: a + 0 * b * t, t, y, space, sigma=SIGMA, compiled=False)
    assert fit.values["b"] == pytest.approx(3.0, rel=1e-6)
    assert fit.parameters.loc["b", "standard_error"] == pytest.approx(0.2 * 3.0, rel=1e-6)
    assert fit.report().priors["of the priors [%]"].tolist() == pytest.approx([100.0])


@pytest.mark.slow
def test_intervals_hold_truths_that_are_drawn_from_the_prior() -> None:
    """Of 400 truths 95 % +- 1.1 % (one standard error): within four of those."""
    inside = 0
    space = {
        "a": (0, 10),
        "b": {"low": 0.01, "high": 20, "scale": "log", "prior": (1.5, 0.2)},
    }
    for _ in range(400):
        b = 1.5 * np.exp(0.2 * rng.standard_normal())
        y = decay(t, 2.0, b) + SIGMA * rng.standard_normal(40)
        fit = miho.fit(decay, t, y, start={"a": 2.0, "b": 1.5}, space=space, sigma=SIGMA,
                       compiled=False)  # fmt: skip
        reach = 1.959964 * fit.parameters.loc["b", "standard_error"] / fit.values["b"]
        inside += abs(np.log(b / fit.values["b"])) <= reach
    assert 0.905 <= inside / 400 <= 0.994


def test_a_bootstrap_beside_priors_is_refused_and_the_sandwich_is_like_the_covariance() -> None:
    y = decay(t, 2.0, 1.5) + SIGMA * rng.standard_normal(40)
    space = {"a": (0, 5), "b": {"low": 0, "high": 10, "prior": (1.5, 1e-2)}}
    fit = miho.fit(decay, t, y, space, sigma=SIGMA, compiled=False)
    with pytest.raises(ValueError, match="expected 0 for a problem with priors"):
        make_report(fit.problem, fit.theta, replicates=50)
    at = fit.uncertainty
    assert np.sqrt(at.sandwich[1, 1]) == pytest.approx(at.standard_errors[1], rel=0.1)


def test_a_prior_on_a_sum_is_bayesian_linear_regression() -> None:
    """An observation of a + b beside the data (Theil and Goldberger 1961)."""
    y = 1 + 2 * t + SIGMA * rng.standard_normal(40)
    X, R = np.stack([np.ones(40), t], axis=1), np.ones((1, 2))
    covariance = np.linalg.inv(X.T @ X / SIGMA**2 + R.T @ R / 0.01**2)
    expected = covariance @ (X.T @ y / SIGMA**2 + R[0] * 3.3 / 0.01**2)
    fit = miho.fit(
        line, t, y, {"a": (-5, 5), "b": (-5, 5), "sum": {"prior": (3.3, 0.01)}},
        tied={"sum": "a + b"}, sigma=SIGMA, compiled=False,
    )  # fmt: skip
    assert [fit.values["a"], fit.values["b"]] == pytest.approx(expected, rel=1e-6)
    assert fit.uncertainty.covariance == pytest.approx(covariance, rel=1e-5)
    spread = np.sqrt(covariance.sum())
    assert fit.parameters.loc["sum", "standard_error"] == pytest.approx(spread, rel=1e-5)
    report = fit.report()
    alone = np.sqrt(np.linalg.inv(X.T @ X / SIGMA**2).sum())
    row = report.priors.iloc[0]
    assert row["error from the data alone"] == pytest.approx(alone, rel=1e-5)
    assert row["of the priors [%]"] == pytest.approx(100 * (1 - (spread / alone) ** 2), rel=1e-4)
    profile = report.tied_profiles["sum"]
    assert (profile.high - profile.low) / 2 == pytest.approx(1.959964 * spread, rel=3e-3)


@pytest.mark.parametrize("sigma", [None, "relative"])
def test_beside_priors_errors_are_estimated_from_what_the_data_determine(sigma: object) -> None:
    """MacKay's fixed point (Neural Computation 4, 1992), iterated here for a line: the variance is
    the sum of squares by the rows less gamma, the trace of what the data know."""
    relative = np.ones(40) if sigma is None else np.where(t < 0.5, 1.0, 3.0)
    y = 1 + 2 * t + SIGMA * relative * rng.standard_normal(40)
    mean, std = np.array([1.2, 1.5]), np.array([0.1, 0.3])
    X, z = np.stack([np.ones(40), t], axis=1) / relative[:, None], y / relative
    variance = 1.0
    for _ in range(500):
        precision = X.T @ X / variance + np.diag(1 / std**2)
        expected = np.linalg.solve(precision, X.T @ z / variance + mean / std**2)
        gamma = np.trace(np.linalg.solve(precision, X.T @ X / variance))
        variance = float(np.sum((z - X @ expected) ** 2)) / (40 - gamma)
    space = {
        "a": {"low": -5, "high": 5, "prior": (1.2, 0.1)},
        "b": {"low": -5, "high": 5, "prior": (1.5, 0.3)},
    }
    known = {} if sigma is None else {"sigma": relative, "sigma_known": False}
    fit = miho.fit(line, t, y, space, compiled=False, **known)
    assert list(fit.values.values()) == pytest.approx(expected, rel=1e-5)
    errors = np.sqrt(np.diag(np.linalg.inv(precision)))
    assert fit.uncertainty.standard_errors == pytest.approx(errors, rel=1e-5)
    assert fit.uncertainty.freedom == int(40 - gamma)
    report = fit.report()
    assert report.priors["of the priors [%]"].between(5, 90).all()
    half = fit.uncertainty.quantile() * errors
    row = report.parameters.iloc[1]
    assert (row["profile high"] - row["profile low"]) / 2 == pytest.approx(half[1], rel=3e-3)


def test_searches_are_counted_at_the_errors_that_were_settled_on() -> None:
    y = decay(t, 2.0, 1.5) + SIGMA * rng.standard_normal(40)
    space = {"a": (0, 5), "b": {"low": 0, "high": 10, "prior": (1.5, 0.1)}}
    fit = miho.fit(decay, t, y, space, compiled=False)
    assert "7 of 7 independent searches" in fit.optimum


def test_beside_data_without_errors_a_prior_counts_nothing() -> None:
    space = {"a": (0, 5), "b": {"low": 0, "high": 5, "prior": (1.4, 0.1)}}
    fit = miho.fit(decay, t, decay(t, 2.0, 1.5), space, compiled=False)
    assert list(fit.values.values()) == pytest.approx([2.0, 1.5], rel=1e-9)


def test_data_that_contradict_a_prior_are_named() -> None:
    y = 1 + 2 * t + SIGMA * rng.standard_normal(40)
    for mean, contradict in ((2.0, False), (3.0, True)):
        space = {"a": (-5, 5), "b": {"low": -5, "high": 5, "prior": (mean, 0.1)}}
        notes = miho.fit(line, t, y, space, sigma=SIGMA / 10, compiled=False).notes
        assert any("data and prior contradict each other" in note for note in notes) == contradict


@pytest.mark.parametrize(
    ("prior", "sigma", "message"),
    [
        ((9.0, 1.0), 0.2, "prior is \\(9.0, 1.0\\), 4 deviations outside of 0 to 5; correct one"),
        ((-0.31, 0.1), 0.2, "3.1 deviations outside of 0 to 5"),
        ((1.0, 0.0), 0.2, "prior is \\(1.0, 0.0\\); expected a finite mean"),
        ((1.0,), 0.2, "expected mean and standard deviation"),
        (("x", 1), 0.2, "expected mean and standard deviation"),
    ],
)
def test_a_prior_that_cannot_count_is_refused(prior: object, sigma: object, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        miho.fit(
            decay, t, t, {"a": (0, 5), "b": {"low": 0, "high": 5, "prior": prior}}, sigma=sigma,
            compiled=False,
        )  # fmt: skip
    assert "\n" not in str(caught.value)


def test_errors_that_are_alike_beside_a_prior_are_told_of() -> None:
    """Which intervals do not allow for; independent ones are not told of."""
    x, rng = np.linspace(0, 5, 120), np.random.default_rng(0)
    white = 0.05 * rng.standard_normal(x.size)
    alike = lfilter([1.0], [1.0, -0.9], white)
    space = {"a": {"low": 0, "high": 10, "prior": (1, 0.02)}, "b": (0, 10)}
    told, words = [], "intervals do not allow for them together with priors"
    for errors in (white, alike):
        y = np.exp(-x) + 2 * x + errors
        fit = miho.fit(lambda x, a, b: a * np.exp(-x) + b * x, x, y, space, compiled=False)
        told.append(
            (words in flat(fit), any("with priors, standard errors" in n for n in fit.notes))
        )
    assert told == [(False, False), (True, True)]
