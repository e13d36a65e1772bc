"""Standard errors and intervals against published figures and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

import miho
from miho.data import Dataset
from miho.identification import CurveFit, Huber, linearised
from miho.identification.bootstrap import bootstrap, percentile_intervals
from miho.identification.refit import refit
from miho.identification.residuals import Square
from tests.identification.profiles import profile_of
from tests.identification.published import Line as LineModel
from tests.identification.published import line, misra1a, problem, puromycin


def straight_line(n: int = 40, b: tuple[float, float] = (-100, 100)) -> CurveFit:
    rng = np.random.default_rng(3)
    x = rng.uniform(0, 2, n)
    return line(1 + 2 * x + 0.3 * rng.standard_normal(n), x, b=b)


def test_nist_certified_standard_errors() -> None:
    """Certified to eleven digits; our optimum is found to about 1e-8 of the parameters."""
    fit = misra1a()
    at = linearised(fit, refit(fit, np.array([250.0, 5e-4])).theta)
    np.testing.assert_allclose(at.theta, [2.3894212918e02, 5.5015643181e-04], rtol=1e-7)
    np.testing.assert_allclose(at.standard_errors, [2.7070075241e00, 7.2668688436e-06], rtol=1e-6)
    assert at.noise == pytest.approx(1.0187876330e-01, rel=1e-8)
    assert at.freedom == 12


def test_profile_intervals_of_the_puromycin_example() -> None:
    """R's confint on this fit, as printed in its documentation; ends found to 0.005 in tau."""
    fit = puromycin()
    at = linearised(fit, refit(fit, np.array([200.0, 0.1])).theta)
    np.testing.assert_allclose(at.theta, [212.7, 0.06412], rtol=1e-3)
    Vm, K = (profile_of(fit, at, i) for i in range(2))
    assert (Vm.low, Vm.high) == pytest.approx((197.302, 229.290), rel=2e-4)
    assert (K.low, K.high) == pytest.approx((0.046925, 0.086160), rel=2e-3)


def test_linear_regression_in_closed_form() -> None:
    fit = straight_line()
    x, y = fit.dataset["x"], fit.dataset["y"]
    regression = scipy.stats.linregress(x, y)
    at = linearised(fit, refit(fit, np.zeros(2)).theta)
    np.testing.assert_allclose(at.theta, [regression.intercept, regression.slope], rtol=1e-8)
    np.testing.assert_allclose(
        at.standard_errors, [regression.intercept_stderr, regression.stderr], rtol=1e-8
    )
    X, e = np.stack([np.ones_like(x), x], axis=1), fit.errors(at.theta)
    bread = np.linalg.inv(X.T @ X)
    left = e / (1 - np.sum(X @ bread * X, axis=1))  # HC3
    white = bread @ (X.T * left**2) @ X @ bread
    np.testing.assert_allclose(at.sandwich, white, rtol=1e-8)
    for i in range(2):  # the profile of a linear model is the linearised interval
        curve = profile_of(fit, at, i)
        np.testing.assert_allclose([curve.low, curve.high], at.intervals()[i], rtol=5e-3)


def test_a_row_that_alone_determines_a_parameter_has_the_others_spread() -> None:
    """y = a + b x with x = 0 but for one row, which says nothing of its own spread."""
    y = np.append(np.random.default_rng(0).standard_normal(20), 3.0)
    fit = line(y, np.append(np.zeros(20), 1.0))
    at = linearised(fit, refit(fit, np.zeros(2)).theta)
    others = np.var(y[:20], ddof=1)
    left = (y[:20] - y[:20].mean()) * 20 / 19
    expected = [np.sum(left**2) / 400, np.sum(left**2) / 400 + others]
    np.testing.assert_allclose(np.diag(at.sandwich), expected, rtol=1e-8)


def test_the_bootstrap_spreads_as_the_standard_error_does() -> None:
    """400 replicates know a standard error to 4 %; three of those, plus the small sample's 5 %."""
    fit = straight_line(200)
    theta = refit(fit, np.zeros(2)).theta
    replicates = bootstrap(fit, theta, 400, np.random.default_rng(0))
    expected = np.sqrt(np.diag(linearised(fit, theta).sandwich))
    np.testing.assert_allclose(replicates.std(axis=0), expected, rtol=0.17)
    low, high = percentile_intervals(replicates, 200, 198).T
    plain = np.quantile(replicates, [0.025, 0.975], axis=0)
    assert ((low <= plain[0]) & (plain[0] < theta) & (theta < plain[1]) & (plain[1] <= high)).all()
    again = bootstrap(fit, theta, 2, np.random.default_rng(0))
    np.testing.assert_array_equal(again, replicates[:2])


def test_a_parameter_at_its_bound_is_held() -> None:
    fit = straight_line(b=(-100, 1.5))
    at = linearised(fit, refit(fit, np.zeros(2)).theta)
    assert at.at_bound.tolist() == [False, True]
    assert np.isnan(at.standard_errors[1])
    e = fit.errors(at.theta)
    expected = np.sqrt(e @ e / (e.size - 1) / e.size)  # the error of a mean
    assert at.standard_errors[0] == pytest.approx(expected, rel=1e-8)


def test_what_the_data_do_not_see_has_no_finite_error() -> None:
    fit = line(np.array([1.0, 1.2, 0.9]), np.full(3, 2.0))
    at = linearised(fit, np.array([1.0, 0.0]))
    assert np.isinf(at.standard_errors).all()
    assert at.null_directions.shape == (1, 2)
    assert np.isnan(at.correlation).all()


def test_rounding_of_a_null_direction_moves_no_other_parameter() -> None:
    """The data know c + 1e-20 d only, and a and b alone."""
    x = np.linspace(-1, 1, 30)
    y = 1 + x + x**2 + 0.1 * np.random.default_rng(0).standard_normal(30)
    box = dict.fromkeys("abcd", (-9, 9))
    at = miho.fit(lambda x, a, b, c, d: a + b * x + (c + 1e-20 * d) * x**2, x, y, box).uncertainty
    np.testing.assert_array_equal(at.unidentifiable, [False, False, True, True])
    np.testing.assert_allclose(at.spread(np.eye(4)), at.standard_errors)


def test_an_effect_whose_inverse_square_overflows_counts_as_none() -> None:
    """The slope of a peak far beyond the rows is 1e-160: its variance would be 1e320."""
    x = np.array([0.0, 1.0, 2.0, 3.0])
    at = linearised(line(1 + 0.1 * np.cos(x), 1e-160 * x), np.array([1.0, 0.0]))
    alone = linearised(line(1 + 0.1 * np.cos(x), 0 * x), np.array([1.0, 0.0]))
    np.testing.assert_array_equal(at.standard_errors, [alone.standard_errors[0], np.inf])
    assert at.unidentifiable.tolist() == [False, True]


def test_an_open_profile_is_infinite() -> None:
    """Saturated data: only a lower bound on the rate of rise can be given."""
    fit = misra1a()
    x = fit.dataset["x"]
    noise = 0.05 * np.cos(np.arange(x.size))
    flat = problem(fit.model, x, 50.0 + noise, [(10, 1000), (1e-3, 1.0)])
    at = linearised(flat, refit(flat, np.array([50.0, 0.08])).theta)
    found = profile_of(flat, at, 1)
    assert np.isinf(found.high)
    assert np.isfinite(found.low)


def test_uncertainty_needs_more_rows_than_parameters() -> None:
    fit = line(np.array([1.0, 2.0]), np.array([0.0, 1.0]))
    with pytest.raises(ValueError, match="2 rows for 2 parameters"):
        linearised(fit, np.array([1.0, 1.0]))


def test_a_known_sigma_needs_no_more_rows_than_parameters() -> None:
    def decay(t, a, b):
        return a * np.exp(-b * t)

    t, y, sigma = np.array([0.0, 1.0]), np.array([3.0, 1.0]), np.array([0.1, 0.05])
    _, expected = scipy.optimize.curve_fit(decay, t, y, [2, 1], sigma=sigma, absolute_sigma=True)
    fit = miho.fit(decay, t, y, {"a": (0, 10), "b": (0, 5)}, sigma=sigma)
    assert fit.covariance.to_numpy() == pytest.approx(expected, rel=1e-6)
    report = fit.report(replicates=5)
    assert report.parameters["profile high"].tolist() == pytest.approx([3.196, 1.2195], rel=1e-4)
    assert report.parameters["bootstrap low"].isna().all()
    assert report.notes == []


@pytest.mark.slow
def test_the_robust_optimum_and_its_standard_error() -> None:
    """The optimum is scipy's; the asymptotic error holds over 300 data sets to 4 standard errors
    of a standard deviation, 4 / sqrt(2 * 300) = 16 %."""
    rng = np.random.default_rng(0)
    x = np.linspace(0, 1, 100)
    estimates, errors = [], []
    for _ in range(300):
        noise = 0.1 * rng.standard_normal(100)
        noise[rng.random(100) < 0.1] *= 30
        fit = line(1 + x + noise, x, Huber(0.13))
        theta = refit(fit, np.ones(2)).theta
        estimates.append(theta[1])
        errors.append(linearised(fit, theta).standard_errors[1])
    scipys = scipy.optimize.least_squares(
        lambda t: LineModel().predict(t[None], x)[0] - fit.dataset["y"],
        np.ones(2), loss="huber", f_scale=0.13, xtol=1e-12, ftol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(theta, scipys.x, rtol=1e-5)
    assert np.std(estimates) == pytest.approx(np.mean(errors), rel=0.16)


def test_intervals_of_a_robust_loss_follow_from_the_errors_if_sigma_is_known() -> None:
    """Sigma belongs to the good rows alone; outliers add to the spread of the estimates."""
    rng = np.random.default_rng(0)
    x = np.linspace(0, 1, 100)
    noise = 0.1 * rng.standard_normal(100) * np.where(np.arange(100) % 10, 1, 30)
    robust = line(1 + x + noise, x, Huber(0.13))
    theta = refit(robust, np.ones(2)).theta
    known = linearised(replace(robust, sigma=0.1), theta)
    np.testing.assert_allclose(known.covariance, linearised(robust, theta).covariance)
    clean = linearised(replace(robust, rho=Square(), sigma=0.1), theta)
    assert np.all(known.standard_errors > 1.1 * clean.standard_errors)


def test_rows_of_one_event_are_not_independent() -> None:
    """The mean of 30 events of 20 equal rows is as sure as that of 30 rows: in closed form."""
    values = np.random.default_rng(0).standard_normal(30)
    event = np.repeat(np.arange(30.0), 20)
    y, x = np.repeat(values, 20), np.tile(np.linspace(-1, 1, 20), 30)
    columns = {"x": x, "event": event, "y": y}
    data = Dataset("d", columns, dict.fromkeys(columns, "-"), "y")
    fit = replace(line(y, x), dataset=data)
    theta = refit(fit, np.zeros(2)).theta
    at = linearised(fit, theta)
    known = values.std(ddof=1) / np.sqrt(30)
    assert np.sqrt(at.sandwich[0, 0]) == pytest.approx(known * np.sqrt(599 / 598), rel=1e-9)
    assert at.standard_errors[0] == np.sqrt(at.sandwich[0, 0])
    assert (at.events, at.freedom) == (30, 29)
    alone = linearised(line(y, x), theta).standard_errors
    assert alone[0] == pytest.approx(known / np.sqrt(20), rel=0.05)
    drawn = bootstrap(fit, theta, 300, np.random.default_rng(1))
    assert drawn[:, 0].std() == pytest.approx(known, rel=0.16)  # 4 / sqrt(600)
