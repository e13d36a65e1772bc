"""The posterior distribution of the parameters by Markov chains, on request."""

from __future__ import annotations

import json
import math
import sys
import warnings
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from miho.identification.curve_fit import CurveFit
from miho.identification.residuals import Square
from miho.identification.stated import reported_space, reported_values, tied_names
from miho.identification.uncertainty import Linearised, linearised
from miho.models.tied import Tied
from miho.optim import Budget
from miho.optim.pace import Pace
from miho.quantities import Array
from miho.validate import whole

WALKERS, WALKERS_PER_PARAMETER = 32, 4
FEWEST_WALKERS = 8
"""A move needs up to three other walkers, from the half that does not move."""
STEPS = 50_000
ENOUGH = 50.0
"""A chain is long enough after this many autocorrelation times, as the manual of emcee advises."""
FIRST_LOOK, FEWEST_STEPS = 500, 10
BURN_IN = 2
"""Autocorrelation times that are dropped: walkers begin with the covariance of the optimum."""
KEPT = 10_000
"""Largest number of stored samples, which are at least half an autocorrelation time apart."""
MOST_NUMBERS = 20_000_000
"""Largest number of stored likelihoods of rows, 160 MB."""
SPREAD, HALVINGS = 0.1, 50
"""Initial spread of walkers, as a share of the box, along directions that the data do not
determine; and largest number of steps that move walkers without a value towards the optimum."""
SECONDS = 2.0
"""Seconds before the first line of progress."""
SIGMA = "sigma"
PACKAGES = ("arviz", "emcee", "numpy", "scipy")


def sample_posterior(
    problem: CurveFit, theta: Array, steps: int = STEPS, seed: int = 0, walkers: int | None = None
) -> Any:
    """Sample the posterior distribution of the parameters of a problem with the square loss.

    Errors are normal and independent. An unknown sigma is integrated out under the Jeffreys prior
    1/sigma [1]_ and then drawn given the parameters. Parameters have their priors; the others are
    uniform within their bounds, in their logarithm on a logarithmic scale, as far as constraints
    allow. Dependent rows count as fewer rows, so that no standard error is smaller than the one of
    `linearised`.

    An ensemble of walkers moves along differences between other walkers [2]_, by emcee. Sampling
    ends after 50 autocorrelation times, after `steps`, or with Ctrl-C, which keeps the samples so
    far. It needs the extra `posterior`.

    Parameters
    ----------
    problem : CurveFit
        A problem with the loss `Square`.
    theta : ndarray of shape (d,)
        Its optimum, about which the walkers begin.
    steps : int, optional
        Largest number of steps of each walker, at least 10.
    seed : int, optional
        Seed of all random numbers.
    walkers : int, optional
        Number of walkers, at least 8 and 2 d; by default 32 or 4 d, whichever is larger.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree
        An `InferenceData` before ArviZ 1, a `DataTree` since. Groups: posterior (free and tied
        parameters, quantities, and an unknown sigma for rows of weight 1), sample_stats (`lp`),
        log_likelihood of the rows, and observed_data. The attributes describe the run; `notes`
        lists limits of the result.

    Raises
    ------
    ValueError
        If the loss is not `Square`, if the model reproduces the data to rounding and sigma is
        unknown, or if the model has hardly any finite value near the optimum.
    ImportError
        Without the extra `posterior`.

    References
    ----------
    .. [1] Box and Tiao, Bayesian Inference in Statistical Analysis, 1973, Ch. 2.7.
    .. [2] ter Braak and Vrugt, Differential Evolution Markov Chain with snooker updater and fewer
       chains, Statistics and Computing 18, 2008.
    """
    # Check the problem first; dependent rows widen the likelihood.
    emcee, arviz = _libraries()
    at = linearised(problem, theta, neighbours=True)
    density = _Density(problem, 1 / _widening(problem, at) ** 2)
    whole("steps", steps, FEWEST_STEPS)
    if density.sigma is None and float(problem.loss(theta[None])[0]) <= problem.rounding:
        raise ValueError(
            f"{problem.name}: the model reproduces the data to rounding, so they do not determine "
            "sigma; give sigma"
        )
    walkers = max(WALKERS, WALKERS_PER_PARAMETER * theta.size) if walkers is None else walkers
    whole("walkers", walkers, max(FEWEST_WALKERS, 2 * theta.size))
    # emcee has a separate random state; all other random numbers come from `rng`.
    rng = np.random.default_rng(seed)
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    sampler = emcee.EnsembleSampler(walkers, theta.size, density, moves=moves, vectorize=True)
    sampler.random_state = np.random.RandomState(seed).get_state()
    ended = _run(sampler, _walkers(density, at, walkers, rng), steps)
    return _result(arviz, density, sampler, ended, seed, rng)


@dataclass(frozen=True)
class _Density:
    """Logarithm of the posterior density at search coordinates (n, d), up to a constant.

    `share` is the number of independent rows with the information of one row, at most 1.
    """

    problem: CurveFit
    share: float

    def __post_init__(self) -> None:
        if not isinstance(self.problem.rho, Square):
            raise ValueError(
                f"{self.problem.name}: expected the loss Square, got "
                f"{type(self.problem.rho).__name__}; a posterior needs the likelihood of normal "
                "errors, so fit with Square"
            )

    @property
    def sigma(self) -> float | None:
        """The standard deviation of the weighted errors; None if it is unknown."""
        return self.problem.scale if self.problem.sigma_known else None

    @property
    def rows(self) -> float:
        """The number of independent rows with the information of the data."""
        d = len(self.problem.space)
        return self.share * (len(self.problem.dataset) - d) + d

    def __call__(self, coordinates: Array) -> Array:
        low, high = self.problem.space.bounds
        inside = ((coordinates >= low) & (coordinates <= high)).all(axis=1)
        values = np.full(len(coordinates), -math.inf)
        thetas = self.problem.space.decode(coordinates[inside])
        squares = self.squares(thetas)
        with np.errstate(divide="ignore"):
            if self.sigma is None:
                logarithms = -self.rows / 2 * np.log(squares)
            else:
                logarithms = -self.share / 2 * squares / self.sigma**2
            logarithms += _log_volumes(self.problem, thetas)
        if self.problem.prior is not None:  # dependence of rows does not change its weight
            logarithms -= np.sum(self.problem.prior.deviations(thetas) ** 2, axis=1) / 2
        values[inside] = np.where(np.isfinite(logarithms), logarithms, -math.inf)
        return values

    def squares(self, thetas: Array) -> Array:
        """Sums of squared residuals of the rows, (n,), without priors; NaN without a value."""
        prior = self.problem.prior
        try:
            squares = self.problem.loss(thetas) * self.problem.residual_count
            if prior is not None:
                squares = np.maximum(squares - np.sum(prior.residuals(thetas) ** 2, axis=1), 0.0)
            return np.asarray(squares)
        except ValueError:
            if len(thetas) == 1:
                return np.array([np.nan])
        return np.concatenate([self.squares(theta[None]) for theta in thetas])


def _log_volumes(problem: CurveFit, thetas: Array) -> Array:
    """Logarithms (n,) of the volume that a unit of the shares of constraints covers.

    A uniform density of the shares would give parameters the density 1 / |det| of the derivatives
    with respect to the shares. Multiplied by |det|, the density is uniform in the parameters. A
    constant is omitted.
    """
    logarithms, model = np.zeros(len(thetas)), problem.model
    shares = [(k, p.stands_for) for k, p in enumerate(problem.space.parameters) if p.stands_for]
    if not isinstance(model, Tied) or not shares:
        return logarithms
    values, slopes = model.ties.values(thetas), model.ties.value_slopes(thetas)
    places = [model.ties.names.index(parameter.name) for _, parameter in shares]
    logarithms += np.linalg.slogdet(slopes[:, places][:, :, [k for k, _ in shares]])[1]
    for place, (_, parameter) in zip(places, shares, strict=True):
        if parameter.scale == "log":
            logarithms -= np.log(values[:, place])
    return logarithms


def _widening(problem: CurveFit, at: Linearised) -> float:
    """The largest ratio of a standard error to its value for independent rows."""
    if at.dependence is None and not at.events:
        return 1.0
    free = ~at.at_bound
    J = problem.error_slopes(at.theta)[:, free]
    size = np.linalg.norm(J, axis=0)
    size[size == 0] = 1.0
    plain = at.noise * np.linalg.norm(np.linalg.pinv(J / size), axis=1) / size
    errors = at.standard_errors[free]
    return float(np.max(errors[np.isfinite(errors)] / plain[np.isfinite(errors)], initial=1.0))


def _walkers(density: _Density, at: Linearised, count: int, rng: np.random.Generator) -> Array:
    """Search coordinates (n, d) from the normal distribution of the optimum, within the box."""
    space = density.problem.space
    low, high = space.bounds
    width, centre = high - low, space.encode(at.theta)
    log = np.array([parameter.scale == "log" for parameter in space.parameters])
    stretch = np.where(log, 1 / at.theta, 1.0)
    loose = np.where(np.isfinite(at.standard_errors), np.finfo(float).eps, SPREAD) * width
    size, axes = np.linalg.eigh(at.covariance * np.outer(stretch, stretch) + np.diag(loose**2))
    draws = rng.standard_normal((count, at.theta.size)) * np.sqrt(np.maximum(size, 0.0))
    turns = (centre + draws @ axes.T - low) % (2 * width)  # reflect draws outside the box
    coordinates = low + np.minimum(turns, 2 * width - turns)
    for _ in range(HALVINGS):
        outside = ~np.isfinite(density(coordinates))
        if not outside.any():
            return np.asarray(coordinates)
        coordinates[outside] = (3 * centre - coordinates[outside]) / 2
    raise ValueError(
        f"{density.problem.name}: the model has hardly any finite value near the optimum, so its "
        "posterior cannot be sampled; widen the bounds or correct the model"
    )


def _run(sampler: Any, start: Array, steps: int) -> str:
    """Sample, and return the reason for the end: "enough", "steps" or "interrupted"."""
    look, times, pace = min(FIRST_LOOK, steps), 0.0, Pace(Budget(), SECONDS)
    state: Any = start
    try:
        while True:
            for now in sampler.sample(state, iterations=look - sampler.iteration):
                state = now
                if pace.line_due():
                    sys.stderr.write(
                        f"posterior: step {sampler.iteration:,}, {times:.0f} of {ENOUGH:.0f} "
                        "autocorrelation times\n"
                    )
            times = sampler.iteration / _autocorrelation(sampler)
            if times >= ENOUGH or sampler.iteration >= steps:
                return "enough" if times >= ENOUGH else "steps"
            look = math.ceil(min(look * min(max(ENOUGH / max(times, 1.0), 1.2), 2.0), steps))
    except KeyboardInterrupt:
        if sampler.iteration < FEWEST_STEPS:
            raise
        return "interrupted"


def _autocorrelation(sampler: Any) -> float:
    """The longest integrated autocorrelation time of a parameter, in steps, at least 1."""
    times = sampler.get_autocorr_time(tol=0)
    return max(1.0, float(np.max(times))) if np.isfinite(times).all() else math.inf


def _result(
    arviz: Any, density: _Density, sampler: Any, ended: str, seed: int, rng: np.random.Generator
) -> Any:
    """The ArviZ object with all samples."""
    problem, tau = density.problem, _autocorrelation(sampler)
    steps = sampler.iteration
    # Drop the burn-in, and thin the rest.
    first = min(int(BURN_IN * tau), steps // 2) if math.isfinite(tau) else steps // 2
    total = (steps - first) * sampler.nwalkers
    every = max(1, math.ceil(total / KEPT), int(tau / 2) if math.isfinite(tau) else 1)
    chain = sampler.get_chain(discard=first, thin=every).swapaxes(0, 1)  # (walkers, draws, d)
    shape, rows = chain.shape[:2], len(problem.dataset)
    thetas = problem.space.clip(problem.space.decode(chain.reshape(-1, chain.shape[2])))
    parameters = _parameters(problem, thetas)
    sigma: Array | float | None = density.sigma
    if sigma is None:  # sigma^2 given the parameters is a scaled inverse chi^2
        deviates = rng.chisquare(density.rows, len(thetas))
        drawn = np.sqrt(density.share * density.squares(thetas) / deviates)
        parameters[SIGMA + "_" * (SIGMA in parameters)] = drawn
        sigma = drawn[:, None]
    # The groups of ArviZ; the likelihood of rows only if it is small enough.
    output = problem.dataset.output
    groups = {
        "posterior": {name: values.reshape(shape) for name, values in parameters.items()},
        "sample_stats": {"lp": sampler.get_log_prob(discard=first, thin=every).T},
        "observed_data": {output: problem.dataset[output]},
    }
    notes = _notes(density, ended, steps, tau)
    if thetas.shape[0] * rows <= MOST_NUMBERS:
        likelihood = _log_likelihood(problem, thetas, sigma)
        groups["log_likelihood"] = {output: likelihood.reshape(*shape, rows)}
    else:
        notes.append(f"likelihoods of {rows:,} rows are omitted: they would need too much memory.")
    attributes = {
        "problem": problem.name, "data": problem.dataset.digest, "seed": seed, "ended": ended,
        "steps": steps, "dropped_steps": first, "thinned_by": every, "autocorrelation_time": tau,
        "accepted": float(np.mean(sampler.acceptance_fraction)), "rows": density.rows,
        "sigma": "known" if density.sigma is not None else "unknown, with the prior 1/sigma",
        "packages": json.dumps({name: version(name) for name in PACKAGES}),
        "notes": "\n".join(notes),
    }  # fmt: skip
    return _as_arviz(arviz, groups, {output: ["row"]}, attributes)


def _log_likelihood(problem: CurveFit, thetas: Array, sigma: Array | float) -> Array:
    """Log-likelihoods (n, N) of rows at configurations (n, d), with one sigma or (n, 1)."""
    rows = len(problem.dataset)
    weights = np.ones(rows) if problem.weights is None else problem.weights
    scaled = problem.residual_rows(thetas)[:, :rows] / sigma
    return np.asarray(np.log(weights / sigma) - (scaled**2 + math.log(2 * math.pi)) / 2)


def _parameters(problem: CurveFit, thetas: Array) -> dict[str, Array]:
    """Free and tied parameters and quantities, (n,) each, by name, at configurations (n, d)."""
    model, names = problem.model, reported_space(problem.space).names
    values = dict(zip(names, reported_values(problem, thetas).T, strict=True))
    if isinstance(model, Tied):
        columns = dict(zip(model.ties.names, model.ties.values(thetas).T, strict=True))
        values |= {name: columns[name] for name in tied_names(problem)}
    return values


def _notes(density: _Density, ended: str, steps: int, tau: float) -> list[str]:
    """Sentences on limits of the result."""
    notes = []
    if density.share < 1:
        notes.append(
            "the errors of different rows are correlated, but the likelihood assumes independent "
            f"errors: {len(density.problem.dataset):,} rows count as {density.rows:.0f}, so no "
            "interval is narrower than in the report."
        )
    if ended != "enough":
        why = "by Ctrl-C" if ended == "interrupted" else "at its limit"
        notes.append(
            f"sampling ended {why} after {steps:,} steps, {steps / tau:.0f} autocorrelation times "
            f"instead of {ENOUGH:.0f}: quantiles are imprecise; allow more steps."
        )
    return notes


def _as_arviz(
    arviz: Any, groups: dict[str, Any], dims: dict[str, list[str]], attributes: dict[str, Any]
) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about more chains than draws
        if int(arviz.__version__.partition(".")[0]) < 1:
            return arviz.from_dict(**groups, dims=dims, attrs=attributes)
        return arviz.from_dict(groups, dims=dims, attrs={"/": attributes})


def _libraries() -> tuple[Any, Any]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # ArviZ 0 announces ArviZ 1
            import arviz
            import emcee
    except ModuleNotFoundError as error:
        raise ImportError(
            f"a posterior needs a library that is missing ({error.name}); "
            "pip install 'miho[posterior]'"
        ) from None
    return emcee, arviz
