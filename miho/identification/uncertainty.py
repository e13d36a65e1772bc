"""Standard errors, correlations and intervals from the model linearised at its optimum."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.data.stacking import OUTPUT
from miho.identification.autocorrelation import (
    Autoregression,
    Likeness,
    autoregression,
    degrees_of_freedom,
    likeness,
)
from miho.identification.curve_fit import CurveFit
from miho.identification.inverse_root import INVOLVED, inverse_root
from miho.models.joint import PART
from miho.optim.space import Space
from miho.quantities import Array

EVENT = "event"
"""A column of this name numbers events, such as brakings, whose rows are not independent."""
FEWEST_EVENTS = 3
AT_BOUND = 1e-10
"""A parameter this close to a bound, as a fraction of its range, is at the bound: descents end
there to rounding, and the range of one without bounds is a million times its start."""
RESEMBLING = 0.1
"""Correlation of neighbouring rows' errors from which on they are not independent ..."""
SCORE = 2.33
"""... if it is this many standard deviations of independent ones, as chance makes it in 1 %."""
ALONE = 1e-8
"""A row that leaves so little of its error to the others is predicted by itself alone."""


@dataclass(frozen=True, eq=False)
class Dependence:
    """How the errors depend on those of neighbouring rows, in the order of the data.

    `correlation` is that of one row with the next, less what a fit brings about by itself, `model`
    what the covariance follows from, and `sides` (2 p, d, d) are the covariances of models at one
    standard error to either side of it. `errors` (N,) are those of the rows, as a robust loss takes
    them. `independent` is the uncertainty if rows were independent.
    """

    correlation: float
    model: Autoregression
    sides: Array
    errors: Array
    independent: Linearised

    def freedom(self, gradients: Array) -> Array:
        """Degrees of freedom (n,) of quantities with these gradients (n, d) in the parameters."""
        variances = np.einsum("ij,sjk,ik->si", gradients, self.sides, gradients)
        return degrees_of_freedom(variances, self.independent.freedom)


@dataclass(frozen=True, eq=False)
class Linearised:
    """The uncertainty of `theta` (d,) by the derivatives there; units are the parameters' own.

    `covariance` (d, d) assumes errors of equal spread, independent between rows; `sandwich` (d, d)
    allows a spread that changes from row to row (White, Econometrica 48, 1980), in the form HC3 for
    few rows (MacKinnon and White, Journal of Econometrics 29, 1985). If the data number `events`,
    both allow errors that belong together within an event (Liang and Zeger, Biometrika 73, 1986),
    with the factors for few events; 0 if they do not. Both are 0 along `null_directions` (k, d), in
    which theta can move while every row is predicted the same (the null space of the Jacobian), and
    for parameters `at_bound` (d,), which are held.

    `noise` is the standard deviation of the errors in the output's unit, `freedom` the degrees of
    freedom of Student's t, which is the normal distribution if the noise is known and no estimate
    (`noise_known`). `unidentifiable` (d,) marks the parameters that a null direction moves.

    With `dependence` both allow errors that depend on those of neighbouring rows, as an
    autoregressive model of the errors says, and the sandwich innovations of any spread; `freedom`
    is then the smallest of any parameter, and `intervals` and `reach` take for each quantity its
    own.
    """

    theta: Array
    covariance: Array
    sandwich: Array
    noise: float
    freedom: int
    events: int
    at_bound: NDArray[np.bool_]
    null_directions: Array
    unidentifiable: NDArray[np.bool_]
    noise_known: bool = False
    dependence: Dependence | None = None

    @property
    def independent(self) -> Linearised:
        """The same as if rows were independent."""
        return self if self.dependence is None else self.dependence.independent

    @cached_property
    def by_sandwich(self) -> Linearised:
        """The same with the sandwich as its covariance."""
        return replace(self, covariance=self.sandwich)

    def mapped(
        self,
        values: Array,
        slopes: Array,
        at_bound: NDArray[np.bool_],
        unidentifiable: NDArray[np.bool_],
    ) -> Linearised:
        """The same of functions of the parameters, with these values (q,) and derivatives (q, d).

        `at_bound` (q,) and `unidentifiable` (q,) mark those of them that are.
        """
        dependence = self.dependence
        if dependence is not None:
            dependence = replace(
                dependence,
                sides=slopes @ dependence.sides @ slopes.T,
                independent=self.independent.mapped(values, slopes, at_bound, unidentifiable),
            )
        return replace(
            self,
            theta=values,
            covariance=slopes @ self.covariance @ slopes.T,
            sandwich=slopes @ self.sandwich @ slopes.T,
            at_bound=at_bound,
            null_directions=self.null_directions @ slopes.T,
            unidentifiable=unidentifiable,
            dependence=dependence,
        )

    @cached_property
    def standard_errors(self) -> Array:
        """Standard errors (d,): NaN for a parameter at its bound, infinite if unidentifiable."""
        errors = np.sqrt(np.diag(self.covariance))
        errors[self.unidentifiable] = np.inf
        errors[self.at_bound] = np.nan
        return np.asarray(errors)

    @cached_property
    def correlation(self) -> Array:
        """Correlation of the estimates, (d, d); NaN where a standard error is not above 0."""
        errors = self.standard_errors
        usable = np.where(np.isfinite(errors) & (errors > 0), errors, np.nan)
        return np.asarray(self.covariance / np.outer(usable, usable))

    def quantile(self, level: float = 0.95) -> float:
        """How many standard errors the two-sided interval reaches (Student's t, or normal)."""
        if self.noise_known and self.dependence is None:
            return float(scipy.special.ndtri((1 + level) / 2))
        return float(scipy.special.stdtrit(self.freedom, (1 + level) / 2))

    def intervals(self, level: float = 0.95) -> Array:
        """Lower and upper ends, (d, 2)."""
        reach = self.quantiles(np.eye(self.theta.size), level) * self.standard_errors
        return np.stack([self.theta - reach, self.theta + reach], axis=1)

    def quantiles(self, gradients: Array, level: float = 0.95) -> Array:
        """`quantile` (n,) for quantities with these gradients (n, d) in the parameters."""
        if self.dependence is None:
            return np.full(len(gradients), self.quantile(level))
        freedom = self.dependence.freedom(gradients)
        return np.asarray(scipy.special.stdtrit(freedom, (1 + level) / 2))

    def reach(self, gradients: Array, level: float = 0.95) -> Array:
        """Half widths (n,) of the intervals of quantities with these gradients (n, d)."""
        return self.quantiles(gradients, level) * self.spread(gradients)

    def spread(self, gradients: Array) -> Array:
        """Standard errors (n,) of quantities with these gradients (n, d) in the parameters.

        Infinite for a quantity that a null direction moves, NaN for one that depends only on
        parameters at a bound.
        """
        variance = np.einsum("ij,jk,ik->i", gradients, self.covariance, gradients)
        errors = np.sqrt(np.maximum(variance, 0.0))
        for direction in self.null_directions:
            size = np.abs(gradients) @ np.abs(direction)
            errors[np.abs(gradients @ direction) > INVOLVED * size] = np.inf
        moved = gradients != 0
        errors[moved[:, self.at_bound].any(axis=1) & ~moved[:, ~self.at_bound].any(axis=1)] = np.nan
        return np.asarray(errors)


def linearised(problem: CurveFit, theta: Array, neighbours: bool = False) -> Linearised:
    """Uncertainty of the optimum `theta` (d,) of a problem.

    With a robust loss the covariance is that of an M-estimator (Huber 1981, Ch. 7.6). With
    `neighbours` it is one that allows errors to depend on those of neighbouring rows, where they
    are alike and no events are numbered. Beside priors an unknown variance is estimated with the
    degrees of freedom that the data's share in the parameters leaves (MacKay, Neural Computation 4,
    1992, Bayesian interpolation, Sec. 2.4). Raises ValueError if there are not more rows than
    parameters, if a derivative is not finite, or if a robust loss sees little else than outliers.
    """
    errors, J = _errors_and_slopes(problem, theta)
    # Parameters at a bound are held; the others cost a degree of freedom each.
    at_bound = at_bounds(problem.space, theta)
    count = int((~at_bound).sum())
    if errors.size <= count:
        raise ValueError(
            f"{problem.name}: {errors.size} rows for {count} parameters; "
            "uncertainty needs more rows than parameters"
        )
    root = inverse_root(J, np.flatnonzero(~at_bound))
    psi, stiffness = _influence(problem, errors)
    variance, freedom = _variance(problem, psi, stiffness, root.basis, count)
    spread, events = _spread(problem, root.basis, psi / stiffness, float(np.sqrt(variance)))
    sandwich = root.half @ (spread.T @ spread) @ root.half.T
    if events:
        sandwich *= (errors.size - 1) / (errors.size - count) * events / (events - 1)
    at = Linearised(
        theta=theta,
        covariance=sandwich if events else variance * root.half @ root.half.T,
        sandwich=sandwich,
        noise=float(np.sqrt(variance)),
        freedom=events - 1 if events else freedom,
        events=events,
        at_bound=at_bound,
        null_directions=root.null,
        unidentifiable=np.asarray(root.moved.any(axis=0)),
        noise_known=problem.scale is not None and problem.sigma_known,
    )
    if not neighbours or events or problem.prior is not None:
        return at
    return _dependent(at, psi / stiffness, root.basis, root.half, series_of(problem))


def _errors_and_slopes(problem: CurveFit, theta: Array) -> tuple[Array, Array]:
    """The errors (m,) and their derivatives (m, d), those of priors behind the data's."""
    errors, J = problem.errors(theta), problem.error_slopes(theta)
    if problem.prior is not None:
        errors = np.append(errors, problem.prior.residuals(theta[None])[0])
        J = np.vstack([J, problem.prior.slopes(theta)])
    if not (np.isfinite(J).all() and np.isfinite(errors).all()):
        raise ValueError(f"{problem.name}: the derivatives at the optimum are not all finite")
    return errors, J


def _influence(problem: CurveFit, errors: Array) -> tuple[Array, float]:
    """How much each error counts, (m,), and how many of the rows count, from 0 to 1."""
    psi, stiffness = problem.rho.influence(errors)
    share = float(stiffness.mean())
    if share <= 0:
        raise ValueError(
            f"{problem.name}: most errors are beyond the scale of the loss; choose a larger scale"
        )
    return psi, share


def _variance(
    problem: CurveFit, psi: Array, stiffness: float, basis: Array, count: int
) -> tuple[float, int]:
    """The variance of the errors and its degrees of freedom, for `count` parameters not held."""
    freedom = psi.size - count
    if problem.scale is not None and problem.sigma_known:
        return problem.scale**2, freedom
    if problem.prior is None:
        return float(psi @ psi) / freedom / stiffness**2, freedom
    rows = len(problem.dataset)
    known_from_data = float(np.sum(basis[:rows] ** 2))  # so many parameters, MacKay's gamma
    left = max(rows - known_from_data, 1.0)
    return float(psi[:rows] @ psi[:rows]) / left, int(left)


def _spread(problem: CurveFit, basis: Array, errors: Array, noise: float) -> tuple[Array, int]:
    """What rows, or events, add to the sandwich estimate, and the number of events, or 0."""
    event = events_of(problem.dataset)
    if event is not None and problem.prior is None:
        # Rows of one event add up before the square.
        spread = basis * errors[:, None]
        spread = np.array([np.bincount(event, column) for column in spread.T]).T
        return spread, len(spread)
    # What a row would err without itself in the fit; one that alone determines something has none.
    left = 1 - np.sum(basis**2, axis=1)
    alone = left <= ALONE
    spread = basis * np.where(alone, noise, errors / np.where(alone, 1.0, left))[:, None]
    if problem.prior is not None:  # one draw of each prior says nothing of its spread
        rows = len(problem.dataset)
        spread[rows:] = basis[rows:] * problem.prior.scale
    return spread, 0


def _dependent(
    at: Linearised, errors: Array, basis: Array, half: Array, series: Sequence[slice]
) -> Linearised:
    """The same for errors (N,) that depend on those of neighbouring rows, if these are alike.

    `basis` (N, r) is orthonormal and spans the derivatives, and `half` (d, r) turns sums of errors
    times it into changes of the parameters. Rows are neighbours within a `series`.
    """
    alike = likeness(errors, basis, series)
    if not _resemble(alike) or not basis.shape[1]:
        return at
    model, sides = autoregression(errors, basis, series)
    few_rows = errors.size / at.freedom

    def covariance(model: Autoregression, squares: Array | None = None) -> Array:
        # Never below that of independent rows, as errors that swing in a wave may seem to allow.
        rows = np.full(errors.size, at.noise**2) if squares is None else errors**2 * few_rows
        least = (basis.T * rows) @ basis
        sums = model.variance_of_sums(basis, squares, series)
        excess, axes = np.linalg.eigh(sums - least)
        total = least + axes * np.maximum(excess, 0.0) @ axes.T
        return np.asarray(half @ total @ half.T)

    # White's estimate of the innovations, with the factor for few rows; the first have no own.
    squares = np.full(errors.size, model.variance)
    for own in series:
        squares[own][model.partial.size :] = model.innovations(errors[own]) ** 2 * few_rows
    dependence = Dependence(
        correlation=alike.correlation,
        model=model,
        sides=np.array([covariance(side) for side in sides]),
        errors=errors,
        independent=at,
    )
    freedom = dependence.freedom(np.eye(at.theta.size)[np.isfinite(at.standard_errors)])
    return replace(
        at,
        covariance=covariance(model),
        sandwich=covariance(model, squares),
        freedom=int(freedom.min(initial=at.freedom)),
        dependence=dependence,
    )


def alike_beside_priors(problem: CurveFit, theta: Array) -> float:
    """The correlation of neighbouring errors, if they are alike and priors keep it out; else 0."""
    if problem.prior is None or events_of(problem.dataset) is not None:
        return 0.0
    basis = np.linalg.qr(problem.error_slopes(theta))[0]
    errors = problem.errors(theta)
    # What priors hold back is left in the errors, though the data would have it taken out.
    alike = likeness(errors - basis @ (basis.T @ errors), basis, series_of(problem))
    return alike.correlation if _resemble(alike) else 0.0


def _resemble(alike: Likeness) -> bool:
    return alike.correlation > RESEMBLING and alike.score > SCORE


def series_of(problem: CurveFit) -> list[slice]:
    """The rows that follow each other: those of one part or output, where there are several."""
    inputs = problem.model.inputs
    columns = [problem.dataset[name] for name in (PART, OUTPUT) if name in inputs]
    moved = np.zeros(len(problem.dataset) - 1, dtype=bool)
    for column in columns:
        moved |= np.diff(column) != 0
    ends = (np.flatnonzero(moved) + 1).tolist()
    return [slice(a, b) for a, b in itertools.pairwise([0, *ends, len(problem.dataset)])]


def events_of(dataset: Dataset) -> NDArray[np.intp] | None:
    """The event of each row (N,), from 0, if the data number enough events; else None."""
    if EVENT not in dataset.columns:
        return None
    events, index = np.unique(dataset[EVENT], return_inverse=True)
    return np.asarray(index) if events.size >= FEWEST_EVENTS else None


def parameters_at_bounds(at: Linearised, space: Space) -> list[tuple[str, str, str]]:
    """The names of parameters at a bound, which of the two it is, and its value with the unit."""
    parameters = []
    for i in np.flatnonzero(at.at_bound):
        p = space.parameters[i]
        low = at.theta[i] - p.low < p.high - at.theta[i]
        value = f"{p.low if low else p.high:g} {p.unit}".rstrip()
        parameters.append((p.name, "lower" if low else "upper", value))
    return parameters


def at_bounds(space: Space, theta: Array) -> NDArray[np.bool_]:
    """Which parameters (d,) are at a bound, in the space's own scales."""
    low, high = space.bounds
    slack = AT_BOUND * (high - low)
    at = space.encode(theta)
    return np.asarray((at - low <= slack) | (high - at <= slack))
