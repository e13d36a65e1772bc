"""Errors that depend on their neighbours: against dense matrices, closed forms and simulation."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import scipy.signal
import scipy.special

import miho
from miho.data import Dataset
from miho.identification import make_report
from miho.identification.autocorrelation import (
    Autoregression,
    autoregression,
    chance_of_trend,
    serial_correlation,
)
from miho.identification.bootstrap import block_length, bootstrap, stretched
from miho.identification.refit import refit
from miho.identification.uncertainty import Linearised, linearised
from miho.identification.validation import in_a_sweep
from miho.models.layout import PART
from miho.optim import Space
from miho.vehicle.data import simulated_axle_drive
from miho.vehicle.models import Pacejka
from tests.identification.published import Line, line

Array = np.ndarray

MODEL = Autoregression(np.tanh(np.array([0.9, -0.5, 0.3])), 2.0)


def covariance(model: Autoregression, rows: int) -> Array:
    """Of the errors, (rows, rows), from how long an innovation is felt."""
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    felt = scipy.signal.lfilter([1.0], np.append(1.0, -model.coefficients), impulse)
    values = [felt[k:] @ felt[: felt.size - k] for k in range(rows)]
    return np.asarray(model.variance * scipy.linalg.toeplitz(values))


def fitted(rows: int, columns: int, seed: int = 0) -> tuple[Array, Array]:
    """What a fit of some columns leaves of autoregressive errors, and the columns' basis."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.standard_normal((rows, columns)))[0]
    errors = rng.multivariate_normal(np.zeros(rows), covariance(MODEL, rows))
    return errors - basis @ (basis.T @ errors), basis


def drive(rho: float, rows: int, seed: int = 0) -> Array:
    """A first-order process of standard deviation 1, (rows,)."""
    shocks = np.sqrt(1 - rho**2) * np.random.default_rng(seed).standard_normal(rows + 500)
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -rho], shocks)[500:])


def test_the_variance_of_sums_is_that_of_the_dense_matrix() -> None:
    """Rounding of some thousand products; a wrong start shows in the third digit."""
    dense = covariance(MODEL, 80)
    X = np.random.default_rng(0).standard_normal((80, 4))
    np.testing.assert_allclose(MODEL.autocovariances, dense[0, :3], rtol=1e-10)
    np.testing.assert_allclose(MODEL.variance_of_sums(X), X.T @ dense @ X, rtol=1e-9, atol=1e-9)


def test_innovations_are_what_the_errors_were_made_of() -> None:
    shocks = np.random.default_rng(0).standard_normal(50)
    errors = scipy.signal.lfilter([1.0], np.append(1.0, -MODEL.coefficients), shocks)
    np.testing.assert_allclose(MODEL.innovations(errors), shocks[3:], atol=1e-12)


def test_the_model_has_the_largest_restricted_likelihood() -> None:
    """Of dense matrices, searched by Nelder and Mead, to the roots of their tolerances."""
    errors, basis = fitted(70, 3)
    model, sides = autoregression(errors, basis)

    def criterion(z: Array) -> float:
        V = covariance(Autoregression(np.tanh(z), 1.0), 70)
        W = np.linalg.inv(V)
        A = basis.T @ W @ basis
        rest = errors - basis @ np.linalg.solve(A, basis.T @ W @ errors)
        logs = np.linalg.slogdet(A)[1] + np.linalg.slogdet(V)[1]
        return float(67 * np.log(rest @ W @ rest) + logs)

    z = np.arctanh(model.partial)
    best = scipy.optimize.minimize(criterion, z, method="Nelder-Mead", options={"xatol": 1e-6})
    np.testing.assert_allclose(z, best.x, atol=1e-3)
    # At one standard error to either side -2 log is larger by 1, but for what is not a parabola.
    assert len(sides) == 2 * z.size
    higher = [criterion(np.arctanh(side.partial)) - best.fun for side in sides]
    assert np.mean(higher) == pytest.approx(1.0, rel=0.3)


def test_the_test_of_neighbours_has_its_moments() -> None:
    """Those of e.T A e / e.T e for e = M u and normal u, from dense traces."""
    errors, basis = fitted(40, 3)
    A = (np.eye(40, k=1) + np.eye(40, k=-1)) / 2
    M = np.eye(40) - basis @ basis.T
    mean = np.trace(M @ A) / 37
    variance = 2 * (np.trace(M @ A @ M @ A) - 37 * mean**2) / (37 * 39)
    r = errors @ A @ errors / (errors @ errors)
    expected = (r - mean, (r - mean) / np.sqrt(variance))
    np.testing.assert_allclose(serial_correlation(errors, basis), expected, rtol=1e-10)


def line_through(noise: Array, x: Array) -> tuple[Linearised, Array]:
    """The uncertainty of a line through noise, for rows that may be dependent; its columns."""
    problem = line(1 + 2 * x + noise, x)
    at = linearised(problem, refit(problem, np.zeros(2)).theta, neighbours=True)
    return at, np.stack([np.ones_like(x), x], axis=1)


@pytest.mark.parametrize("along", ["in order", "at random"])
def test_standard_errors_are_those_of_the_true_covariance(along: str) -> None:
    """4000 rows know the sum of autocovariances to (2 / 0.2) sqrt(0.36 / 4000) = 9 %, so a standard
    error to 5 %: three of these."""
    x = np.linspace(-1, 1, 4000)
    x = x if along == "in order" else np.random.default_rng(1).permutation(x)
    at, X = line_through(drive(0.8, 4000), x)
    pinv = np.linalg.pinv(X)
    dense = scipy.linalg.toeplitz(0.8 ** np.arange(4000))
    known = np.sqrt(np.diag(pinv @ dense @ pinv.T))
    np.testing.assert_allclose(at.standard_errors, known, rtol=0.15)
    np.testing.assert_allclose(np.sqrt(np.diag(at.sandwich)), known, rtol=0.15)
    assert at.dependence is not None
    assert at.dependence.correlation == pytest.approx(0.8, abs=0.03)


def test_the_degrees_of_freedom_of_a_mean() -> None:
    """The log of the variance of a mean, 1 / (1 - phi)^2 innovation variances, varies by
    (2 / (1 - phi))^2 (1 - phi^2) / N + 2 / N; estimated at another phi, so to a third."""
    at, _ = line_through(drive(0.8, 600), np.linspace(-1, 1, 600))
    assert at.dependence is not None
    phi = float(at.dependence.model.coefficients.sum())
    spread = (2 / (1 - phi)) ** 2 * (1 - phi**2) / 600 + 2 / 600
    freedom = at.dependence.freedom(at.half[:1])[0]
    assert scipy.special.polygamma(1, freedom / 2) == pytest.approx(spread, rel=1 / 3)
    assert at.freedom <= freedom < at.independent.freedom


def test_independent_rows_keep_their_numbers_to_the_last_bit() -> None:
    x = np.linspace(-1, 1, 300)
    problem = line(1 + 2 * x + np.random.default_rng(0).standard_normal(300), x)
    plain = linearised(problem, refit(problem, np.zeros(2)).theta)
    at = linearised(problem, plain.theta, neighbours=True)
    assert at.dependence is None
    assert at.independent is at
    np.testing.assert_array_equal(at.covariance, plain.covariance)
    reach = plain.quantile() * plain.standard_errors
    np.testing.assert_array_equal(
        at.intervals(), np.stack([at.theta - reach, at.theta + reach], axis=1)
    )


def test_errors_in_a_wave_do_not_narrow_intervals() -> None:
    """Over whole periods they cancel, which another shape of the model would not do."""
    x = np.linspace(-1, 1, 300)
    wave = np.cos(2 * np.pi * 10 * np.arange(300) / 300)
    at, _ = line_through(wave + 0.1 * np.random.default_rng(0).standard_normal(300), x)
    assert at.dependence is not None
    ratio = at.standard_errors / at.independent.standard_errors
    assert (ratio >= 1 - 1e-12).all()  # sums of 300 products


def test_a_report_allows_for_neighbours() -> None:
    """Of a line the profile is the linearised interval, and the band at 0 that of the intercept."""
    x = np.linspace(-1, 1, 400)
    problem = line(1 + 2 * x + 0.1 * drive(0.8, 400), x)
    report = make_report(problem, refit(problem, np.zeros(2)).theta, replicates=200)
    table = report.parameters
    ends = report.at.intervals()
    np.testing.assert_array_equal(table[["linearised low", "linearised high"]], ends)
    np.testing.assert_allclose(
        table[["profile low", "profile high"]], ends, rtol=0, atol=5e-3 * np.ptp(ends)
    )
    curve, half = report.band(np.array([0.0]))
    np.testing.assert_allclose([curve[0] - half[0], curve[0] + half[0]], ends[0], rtol=1e-12)
    assert report.replicates is not None
    spread = np.sqrt(np.diag(report.at.sandwich))
    np.testing.assert_allclose(report.replicates.std(axis=0), spread, rtol=0.3)
    factor = np.ptp(ends, axis=1) / np.ptp(report.at.independent.intervals(), axis=1)
    (note,) = [note for note in report.notes if "neighbouring rows are correlated" in note]
    assert f"{factor.min():.1f}" in note
    assert f"{factor.max():.1f} times as wide" in note


def test_the_length_of_blocks_is_the_best_one() -> None:
    """Of a first-order process, 2 rho / (1 - rho^2) of G over g, in the limit of long data:
    (1.5 G^2 N)^(1/3); from 100,000 rows it is known to some percent."""
    for rho in (0.5, 0.8):
        ratio = 2 * rho / (1 - rho**2)
        best = (1.5 * ratio**2 * 1e5) ** (1 / 3)
        assert block_length(drive(rho, 100_000)) == pytest.approx(best, rel=0.15)
    assert block_length(drive(0.0, 2000)) <= 3


def test_blocks_are_stretched_to_the_sandwich() -> None:
    """400 replicates know a standard deviation to 4 %; three of these, and 5 % for what is not
    linear in the weights."""
    x = np.linspace(-1, 1, 500)
    problem = line(1 + 2 * x + drive(0.8, 500), x)
    at = linearised(problem, refit(problem, np.zeros(2)).theta, neighbours=True)
    assert at.dependence is not None
    block = block_length(at.dependence.errors)
    drawn = bootstrap(problem, at.theta, 400, np.random.default_rng(0), block=block)
    expected = np.sqrt(np.diag(at.sandwich))
    replicates = stretched(drawn, at, problem.space)
    np.testing.assert_allclose(replicates.std(axis=0), expected, rtol=0.17)
    assert (drawn.std(axis=0) < expected).all()
    rows = bootstrap(problem, at.theta, 400, np.random.default_rng(0))
    assert (2 * rows.std(axis=0) < expected).all()


def test_noise_that_drifts_is_no_wrong_shape() -> None:
    """In one sweep noise follows x by itself; with a large parabola the model may.

    As if rows were independent, each of the first three would be a wrong shape. The third verdict
    is flat, since in random order drift does not follow x.
    """
    x = np.linspace(-1, 1, 300)
    shuffled = np.random.default_rng(1).permutation(x)
    verdicts = []
    for along, bend, rho in ((x, 0, 0.8), (x, 3, 0.3), (shuffled, 3, 0.8), (shuffled, 0, 0.8)):
        problem = line(1 + 2 * along + bend * along**2 + drive(rho, 300), along)
        report = make_report(problem, refit(problem, np.zeros(2)).theta, profiles=False)
        assert report.at.dependence is not None
        notes = "\n".join(report.notes)
        told = ("wrong shape, or the measurement drifts", "wrong shape.", "cannot distinguish it")
        verdicts.append([words in notes for words in told])
        assert report.trends.loc[0, "p"] >= report.trends.loc[0, "p of independent rows"]
    sweep, flat, cannot_tell = np.eye(3, dtype=bool).tolist()
    assert verdicts == [cannot_tell, sweep, flat, [False] * 3]
    # A prior says nothing of the shape either.
    problem = line(1 + 2 * x + drive(0.8, 300), x)
    a, b = problem.space.parameters
    known = Space((replace(a, prior=(1.0, 0.5)), b))
    problem = replace(problem, space=known, prior_scale=1.0)
    report = make_report(problem, refit(problem, np.zeros(2)).theta, profiles=False)
    assert report.at.dependence is None
    assert any("cannot distinguish it" in note for note in report.notes)


@pytest.mark.parametrize(("triangular", "seed"), [(False, 7), (True, 16)])
def test_drift_under_the_noise_of_a_sensor_may_be_the_reason(triangular: bool, seed: int) -> None:
    """A right model in one sweep, also up and down: no autoregression has white noise added."""
    x = np.linspace(-1, 1, 300)
    if triangular:
        x = 1 - 2 * np.abs(x)
    noise = drive(0.98, 300, seed=seed) + np.random.default_rng(100 + seed).standard_normal(300)
    problem = line(1 + 2 * x + noise, x)
    report = make_report(problem, refit(problem, np.zeros(2)).theta, profiles=False)
    assert any(
        "wrong shape, or the measurement drifts in addition to its noise; repeat the measurement"
        in note
        for note in report.notes
    )


class InParts(Line):
    """A line whose rows are of several parts."""

    inputs = MappingProxyType({"x": "-", PART: "-"})


def test_a_sweep_is_told_from_random_order() -> None:
    """Also downwards, in steps, and down and up, but not in many turns.

    Nor where only the parts differ, or two levels alternate.
    """
    x, part = np.linspace(0, 1, 60), np.repeat([0.0, 1.0], 30)
    random = np.random.default_rng(0).permutation(x)
    columns = {
        "up": x, "down": -x, "steps": np.round(3 * x), "random": random, "flat": 0 * x,
        "down and up": np.abs(4 * x % 2 - 1), "turns": np.abs(20 * x % 2 - 1),
        "levels": np.tile([0.0, 1.0], 30), "of the part": part + np.tile([0.0, 0.1], 30),
    }  # fmt: skip
    tried = list(columns)
    columns |= {"x": x, PART: part, "y": x}
    data = Dataset("d", columns, dict.fromkeys(columns, "-"), "y")
    problem = replace(line(x, x), model=InParts(), dataset=data)
    assert [name for name in tried if in_a_sweep(problem, name)] == [
        "up", "down", "steps", "down and up"
    ]  # fmt: skip


@pytest.mark.slow
def test_the_chance_of_a_trend_is_its_share_of_data_sets() -> None:
    """Of 400 sets with a correlation of 0.7 and no trend, 5 % are below 0.05, to 3 deviations."""
    columns = np.repeat(np.eye(8), 25, axis=0)
    chances = []
    for seed in range(400):
        errors = drive(0.7, 200, seed)
        basis = np.full((200, 1), 200**-0.5)
        chances.append(chance_of_trend(errors - errors.mean(), basis, columns, order=1))
    assert np.mean(np.array(chances) < 0.05) == pytest.approx(0.05, abs=0.033)
    assert np.mean(np.array(chances) < 0.5) == pytest.approx(0.5, abs=0.075)


def test_a_held_parameter_is_no_obstacle() -> None:
    """One parameter at its bound, and both: the other's intervals allow for neighbours."""
    x = np.linspace(-1, 1, 200)
    noise = 0.1 * drive(0.8, 200)
    held = make_report(line(1 + 2 * x + noise, x, b=(-1, 1.9)), np.array([1.0, 1.9]))
    assert held.at.at_bound.tolist() == [False, True]
    assert held.at.dependence is not None
    factor = held.at.reach(np.eye(2))[0] / held.at.independent.reach(np.eye(2))[0]
    (note,) = [note for note in held.notes if "neighbouring rows are correlated" in note]
    assert f"are {factor:.1f} times as wide" in note
    both = make_report(line(200 + 2 * x + noise, x, b=(-1, 1.9)), np.array([100.0, 1.9]))
    assert both.at.at_bound.all()
    assert both.at.dependence is None


SERIES = [slice(0, 30), slice(30, 31), slice(31, 70)]
"""Three records below each other, one of a single row."""


def of_series(dense: Array) -> Array:
    """A covariance (70, 70) without what records have in common."""
    blocks = [dense[own, own] for own in SERIES]
    return np.asarray(scipy.linalg.block_diag(*blocks))


def test_rows_of_different_records_are_no_neighbours() -> None:
    """As above, with dense matrices in blocks: the test, the model and the covariance of sums."""
    errors, basis = fitted(70, 3)
    A = of_series((np.eye(70, k=1) + np.eye(70, k=-1)) / 2)
    M = np.eye(70) - basis @ basis.T
    mean = np.trace(M @ A) / 67
    variance = 2 * (np.trace(M @ A @ M @ A) - 67 * mean**2) / (67 * 69)
    r = errors @ A @ errors / (errors @ errors)
    expected = (r - mean, (r - mean) / np.sqrt(variance))
    np.testing.assert_allclose(serial_correlation(errors, basis, SERIES), expected, rtol=1e-10)

    def criterion(z: Array) -> float:
        V = of_series(covariance(Autoregression(np.tanh(z), 1.0), 70))
        W = np.linalg.inv(V)
        inner = basis.T @ W @ basis
        rest = errors - basis @ np.linalg.solve(inner, basis.T @ W @ errors)
        logs = np.linalg.slogdet(inner)[1] + np.linalg.slogdet(V)[1]
        return float(67 * np.log(rest @ W @ rest) + logs)

    model, _ = autoregression(errors, basis, SERIES)
    assert model.partial.size == 1  # the shortest record has a row, and knows no longer memory
    best = scipy.optimize.minimize_scalar(lambda z: criterion(np.array([z])), (0.0, 1.0))
    np.testing.assert_allclose(np.arctanh(model.partial), best.x, atol=1e-4)
    dense = of_series(covariance(model, 70))
    sums = model.variance_of_sums(basis, None, SERIES)
    np.testing.assert_allclose(sums, basis.T @ dense @ basis, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_very_smooth_errors_do_not_widen_intervals_without_limit(seed: int) -> None:
    """Over eight seeds B varies by 0.45; a root next to 1 made its standard error 8 to 24.

    The likelihood has several maxima, and one of a descent is not always the highest: on some BLAS
    kernels the standard error was 0.87.
    """
    fit = fit_of_drive(seed, noise=2.0)
    assert fit.uncertainty.dependence is not None
    assert 0.4 < fit.parameters.loc["B", "standard_error"] < 0.65


def test_a_drift_of_unknown_length_is_told_with_its_effect_on_intervals() -> None:
    """With one degree of freedom the quantile is tan(0.475 pi) = 12.706, in place of 1.968."""
    t = np.linspace(0, 3, 300)
    drift = np.cumsum(0.02 * np.random.default_rng(3).standard_normal(300))
    fit = miho.fit(lambda t, a, b: a + b * t, t, 1 + t + drift, {"a": (-9, 9), "b": (-9, 9)})
    assert fit.uncertainty.freedom == 1
    note = next(note for note in fit.report(profiles=False).notes if "neighbouring rows" in note)
    assert "(1 degree of freedom), which alone makes intervals up to 6.5 times as wide" in note


def test_rounding_of_smooth_errors_hardly_moves_standard_errors() -> None:
    """The likelihood is rounded by 1e-4, which made standard errors differ by up to 1 %."""
    problem, theta = (fit := fit_of_drive(0)).problem, fit.theta
    errors = problem.errors(theta)
    basis = np.linalg.qr(problem.jacobian(theta))[0]
    models = [autoregression(errors * (1 + k * 1e-13), basis)[0] for k in range(4)]
    assert models[0].partial.size == 20
    sums = [np.sqrt(np.diag(model.variance_of_sums(basis))) for model in models]
    np.testing.assert_allclose(sums, np.broadcast_to(sums[0], (4, 5)), rtol=5e-4)


def fit_of_drive(seed: int, **settings: float) -> miho.Fit:
    """Fit of the front axle of a simulated drive, whose errors are smooth."""
    car = {"mass": 800.0, "lf": 1.7, "lr": 1.271, "Izz": 850.0}
    data = simulated_axle_drive(car, "front", seed=seed, **settings)
    box = {"B": (2, 40), "C": (1, 2.5), "D": (1000, 9000), "Sx": (-0.05, 0.05), "Sy": (-900, 900)}
    return miho.fit(Pacejka(), dict(data.columns), data.output, box)
