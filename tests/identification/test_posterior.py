"""The posterior by Markov chains, against closed forms."""

import json
import math
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats

import miho
from miho.identification import CurveFit, Huber, linearised, sample_posterior
from miho.models import Model

if find_spec("emcee") is None or find_spec("arviz") is None:
    pytest.skip("the extra `posterior` is not installed", allow_module_level=True)

T = np.linspace(0.0, 1.0, 12)
E = 1 + 0.3 * np.random.default_rng(1).standard_normal(12)
Y = E + 2 * T
BOX = {"a": (-50, 50), "b": (-50, 50)}
QUANTILES = np.array([0.025, 0.16, 0.5, 0.84, 0.975])
DEVIATIONS = 5.0
"""Monte-Carlo errors that a quantile may be off, of an autocorrelation time that is estimated."""


def line(t: Any, a: Any, b: Any) -> Any:
    return a + b * t


def samples(posterior: Any, name: str) -> np.ndarray:
    return np.asarray(posterior["posterior"][name]).ravel()


def assert_follows(posterior: Any, name: str, law: Any) -> None:
    """Quantiles within their Monte-Carlo error, sqrt(q (1 - q) / n) over the density."""
    about = posterior.attrs
    sampled = (about["steps"] - about["dropped_steps"]) * posterior["posterior"].sizes["chain"]
    effective = sampled / about["autocorrelation_time"]
    exact = law.ppf(QUANTILES)
    error = np.sqrt(QUANTILES * (1 - QUANTILES) / effective) / law.pdf(exact)
    off = np.abs(np.quantile(samples(posterior, name), QUANTILES) - exact) / error
    assert (off < DEVIATIONS).all(), (name, off)


def test_a_line_with_unknown_sigma_follows_student() -> None:
    """Box and Tiao (1973), Ch. 2.7: Student's t about least squares; sigma^2 is RSS / chi^2."""
    fit = miho.fit(line, T, Y, BOX, compiled=False)
    posterior = fit.posterior(seed=0)
    assert (posterior.attrs["ended"], posterior.attrs["notes"]) == ("enough", "")
    X = np.column_stack([np.ones(12), T])
    theta, (rss,), *_ = np.linalg.lstsq(X, Y, rcond=None)
    errors = np.sqrt(rss / 10 * np.diag(np.linalg.inv(X.T @ X)))
    for name, at, error in zip("ab", theta, errors, strict=True):
        assert_follows(posterior, name, scipy.stats.t(10, at, error))
    precision = 1 / samples(posterior, "sigma") ** 2
    drawn = np.quantile(precision, QUANTILES) * rss
    np.testing.assert_allclose(drawn, scipy.stats.chi2(10).ppf(QUANTILES), rtol=0.15)


def test_the_groups_are_those_of_arviz(tmp_path: Path) -> None:
    """The likelihood of each row is SciPy's normal density; what is written can be read again."""
    import xarray

    sigma = np.linspace(0.2, 0.5, 12)
    fit = miho.fit(line, T, Y, BOX, sigma=sigma, compiled=False)
    posterior = fit.posterior(steps=600, seed=3)
    a, b = samples(posterior, "a")[:, None], samples(posterior, "b")[:, None]
    likelihood = np.asarray(posterior["log_likelihood"]["y"]).reshape(-1, 12)
    np.testing.assert_allclose(likelihood, scipy.stats.norm.logpdf(Y, a + b * T, sigma), atol=1e-9)
    lp = np.asarray(posterior["sample_stats"]["lp"]).ravel()
    np.testing.assert_allclose(np.ptp(lp - likelihood.sum(axis=1)), 0.0, atol=1e-9)
    np.testing.assert_array_equal(posterior["observed_data"]["y"], Y)
    assert "sigma" not in posterior["posterior"]
    about = posterior.attrs
    assert (about["seed"], about["data"]) == (3, fit.problem.dataset.digest)
    assert set(json.loads(about["packages"])) == {"arviz", "emcee", "numpy", "scipy"}
    posterior.to_netcdf(tmp_path / "posterior.nc")
    with xarray.open_dataset(tmp_path / "posterior.nc", group="posterior") as again:
        np.testing.assert_array_equal(np.ravel(again["a"]), a[:, 0])


def test_priors_and_ties_are_kept() -> None:
    """Known sigma: a normal prior gives a normal posterior, and what no row tells its prior back.

    c is log-normal about 2, and the mean of y is a with a tied d.
    """
    space = {
        "a": {"low": -50, "high": 50, "prior": (0.0, 0.5)},
        "c": {"low": 0.02, "high": 200, "scale": "log", "prior": (2.0, 0.3)},
        "d": {"tied": "2 * a"},
    }
    flat = miho.fit(
        lambda t, a, c, d: d / 2 + 0 * t + 0 * c, T, Y, space, sigma=0.3, start={"a": 1, "c": 2}
    )
    posterior = flat.posterior(seed=1)
    precision = 12 / 0.3**2 + 1 / 0.5**2
    law = scipy.stats.norm(Y.sum() / 0.3**2 / precision, precision**-0.5)
    assert_follows(posterior, "a", law)
    assert_follows(posterior, "c", scipy.stats.lognorm(0.3, scale=2.0))
    np.testing.assert_allclose(samples(posterior, "d"), 2 * samples(posterior, "a"))


def test_bounds_truncate() -> None:
    """b is at most 1.5, below most of what the rows tell of it; a known sigma makes it normal."""
    fit = miho.fit(lambda t, b: b * t, T, Y - 1, {"b": (0, 1.5)}, sigma=0.3, compiled=False)
    error, at = 0.3 / np.linalg.norm(T), T @ (Y - 1) / (T @ T)
    law = scipy.stats.truncnorm((0 - at) / error, (1.5 - at) / error, at, error)
    assert_follows(fit.posterior(seed=0), "b", law)


def test_rows_that_depend_on_each_other_count_as_fewer() -> None:
    """AR(1) noise of 0.8: no narrower than the report's intervals, far wider than plain ones."""
    rng, noise = np.random.default_rng(4), np.zeros(400)
    for k in range(1, 400):
        noise[k] = 0.8 * noise[k - 1] + 0.1 * rng.standard_normal()
    t = np.linspace(0, 1, 400)
    fit = miho.fit(line, t, 1 + 2 * t + noise, BOX, compiled=False)
    posterior = fit.posterior(seed=0)
    at = linearised(fit.problem, fit.theta, neighbours=True)
    deviations = np.array([samples(posterior, name).std() for name in "ab"])
    assert (deviations > 0.9 * at.standard_errors).all()
    assert (deviations > 2 * at.independent.standard_errors).all()
    assert posterior.attrs["rows"] < 100
    assert "400 rows count as" in posterior.attrs["notes"]


def test_a_seed_is_a_chain_and_its_end_is_said() -> None:
    fit = miho.fit(line, T, Y, BOX, compiled=False)
    first, same, other = (fit.posterior(steps=60, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(samples(first, "a"), samples(same, "a"))
    assert not np.array_equal(samples(first, "a"), samples(other, "a"))
    assert first.attrs["ended"] == "steps"
    assert "ended at its limit after 60 steps" in first.attrs["notes"]


class Interrupted(Model):
    """A constant that raises beyond a wall, and is interrupted after some batches."""

    inputs, parameters, output = {"t": ""}, {"a": ""}, ""

    def __init__(self, batches: float) -> None:
        self.left, self.wall = batches, math.inf

    def predict(self, thetas: np.ndarray, *inputs: np.ndarray) -> np.ndarray:
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt
        if (thetas > self.wall).any():
            raise ValueError("beyond")
        return np.repeat(thetas, inputs[0].size, axis=1)

    def jacobian(self, theta: np.ndarray, *inputs: np.ndarray) -> np.ndarray:
        return np.ones((inputs[0].size, 1))


def constant(batches: float, wall: float = math.inf) -> CurveFit:
    data, model = miho.Dataset("d", {"t": T, "y": E}, {"t": "", "y": ""}, "y"), Interrupted(batches)
    problem = CurveFit(model, data, miho.Space((miho.Parameter("a", "", 0, 9),)))
    model.wall = wall
    return problem


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_what_constraints_leave_is_filled_evenly(scale: str) -> None:
    """The smaller and the larger of two uniform numbers, of data that tell nothing."""
    box = {name: {"low": 1.0, "high": 2.0, "scale": scale} for name in "ab"}
    bounds = {**box, "gap": {}}
    fit = miho.fit(
        lambda t, a, b: 1e-9 * (a + b) * t, T, Y, bounds, tied={"gap": "b - a"},
        constraints="a < b", sigma=1.0, compiled=False, start={"a": 1.3, "b": 1.6},
    )  # fmt: skip
    posterior = fit.posterior(steps=4000, seed=0)
    assert set(posterior["posterior"].data_vars) == {"a", "b", "gap"}
    for name, law in (("a", scipy.stats.beta(1, 2)), ("b", scipy.stats.beta(2, 1))):
        values = samples(posterior, name)
        shares = np.log2(values) if scale == "log" else values - 1
        np.testing.assert_allclose(np.quantile(shares, QUANTILES), law.ppf(QUANTILES), atol=0.05)
    gap = samples(posterior, "b") - samples(posterior, "a")
    np.testing.assert_allclose(samples(posterior, "gap"), gap, rtol=1e-12)


def test_a_prior_counts_beside_errors_that_are_not_known() -> None:
    """Student's t of the data times the normal one of the prior, which contradict each other."""
    mean, deviation, a = 0.5, 0.1, np.linspace(0.2, 1.5, 5001)
    prior = {"a": {"low": -50, "high": 50, "prior": (mean, deviation)}}
    fit = miho.fit(line, T, Y, prior, fixed={"b": 2.0}, compiled=False)
    squares = np.sum((Y - 2 * T - a[:, None]) ** 2, axis=1)
    density = squares**-6 * np.exp(-(((a - mean) / deviation) ** 2) / 2)
    steps = a[1] - a[0]
    law = scipy.stats.rv_histogram((density, np.append(a, a[-1] + steps) - steps / 2))
    posterior = fit.posterior(seed=0)
    assert_follows(posterior, "a", law)
    drawn = np.mean(1 / samples(posterior, "sigma") ** 2)
    assert drawn == pytest.approx(np.sum(density * 12 / squares) / density.sum(), rel=0.05)


def test_an_interrupted_chain_is_kept() -> None:
    kept = sample_posterior(constant(300), np.array([E.mean()]))
    assert kept.attrs["ended"] == "interrupted"
    assert 10 <= kept.attrs["steps"] < 300
    assert "ended by Ctrl-C" in kept.attrs["notes"]
    with pytest.raises(KeyboardInterrupt):
        sample_posterior(constant(12), np.array([E.mean()]))


def test_where_the_model_fails_there_is_no_posterior() -> None:
    """It raises beyond the mean, so the others of its batch are asked for one by one: half of a
    Student's t is left."""
    mean = float(E.mean())
    posterior = sample_posterior(constant(math.inf, mean), np.array([mean]), steps=1500)
    assert samples(posterior, "a").max() <= mean
    error = E.std(ddof=1) / np.sqrt(12)
    below = np.quantile((mean - samples(posterior, "a")) / error, 0.5)
    assert below == pytest.approx(scipy.stats.t(11).ppf(0.75), rel=0.1)


def test_progress_is_shown_after_some_time(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = miho.fit(line, T, Y, BOX, compiled=False)
    fit.posterior(steps=20)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("miho.identification.posterior.SECONDS", 0.0)
    fit.posterior(steps=20)
    assert "posterior: step 1, 0 of 50 autocorrelation times" in capsys.readouterr().err


def test_bad_input_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    fit = miho.fit(line, T, Y, BOX, loss=Huber(0.5), compiled=False)
    with pytest.raises(ValueError, match="expected the loss Square, got Huber"):
        fit.posterior()
    fit = miho.fit(line, T, Y, BOX, compiled=False)
    assert fit.posterior(steps=20, walkers=8)["posterior"].sizes["chain"] == 8
    with pytest.raises(ValueError, match="walkers is 3; expected a whole number of at least 8"):
        fit.posterior(walkers=3)
    exact = miho.fit(line, T, 1 + 2 * T, BOX, compiled=False)
    with pytest.raises(ValueError, match="so they do not determine sigma; give sigma"):
        exact.posterior()
    monkeypatch.setitem(sys.modules, "emcee", None)
    with pytest.raises(ImportError, match=r"missing \(emcee\); pip install 'miho\[posterior\]'"):
        fit.posterior()
