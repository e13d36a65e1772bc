"""Standard errors, correlations and intervals from the model linearised at its optimum."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second
from numpy.typing import NDArray

from miho.identification.curve_fit import CurveFit
from miho.identification.dependence import Dependence, dependent, events_of, series_of
from miho.identification.inverse_root import EXACT, INVOLVED, SINGULAR, inverse_root
from miho.identification.line_wrapping import with_unit
from miho.models.model import Model
from miho.optim.space import Space
from miho.quantities import Array

ROUNDING = 1e-14
"""Rounding of a parameter at its bound, as a fraction of its range."""
ALONE = 1e-8
"""A row alone determines its prediction if at most this fraction of its error is left."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """The uncertainty of an optimum from the derivatives there; `linearised` computes it.

    Parameters
    ----------
    theta : ndarray of shape (d,)
        The optimum, in the units of the parameters, as are all standard errors.
    half : ndarray of shape (d, r)
        Maps sums of errors times an orthonormal basis of the derivatives to changes of parameters.
    sums : ndarray of shape (r, r)
        Covariance of these sums for errors of equal spread that are independent between rows.
    uneven_sums : ndarray of shape (r, r)
        The same for errors whose spread changes between rows [1]_, in the form HC3 for few rows
        [2]_.
    noise : float
        Standard deviation of the errors, in the unit of the output.
    freedom : int
        Degrees of freedom of Student's t. With `dependence`, the smallest of any parameter.
    events : int
        Number of events, or 0. With events both covariances allow for errors that are dependent
        within an event [3]_, with factors for few events.
    at_bound : bool ndarray of shape (d,)
        Parameters at a bound, which count as fixed: their covariances are 0.
    null_directions : ndarray of shape (k, d)
        Null space of the Jacobian: directions along which theta can move without changing any
        prediction. Both covariances are 0 along them.
    unidentifiable : bool ndarray of shape (d,)
        Parameters that a null direction moves.
    noise_known : bool
        Whether the noise is known, so that intervals use the normal distribution.
    dependence : Dependence, optional
        Dependence of the errors on neighbouring rows. Both covariances allow for it, the sandwich
        also for innovations of changing spread, and `intervals` and `reach` use separate degrees of
        freedom for each quantity.
    singular : float
        Largest fraction of the largest singular value that counts as 0.

    References
    ----------
    .. [1] White, Econometrica 48, 1980.
    .. [2] MacKinnon and White, Journal of Econometrics 29, 1985.
    .. [3] Liang and Zeger, Biometrika 73, 1986.
    """

    theta: Array
    half: Array
    sums: Array
    uneven_sums: Array
    noise: float
    freedom: int
    events: int
    at_bound: NDArray[np.bool_]
    null_directions: Array
    unidentifiable: NDArray[np.bool_]
    noise_known: bool = False
    dependence: Dependence | None = None
    singular: float = SINGULAR

    @cached_property
    def covariance(self) -> Array:
        """Covariance (d, d) of the parameters, by `sums`."""
        return np.asarray(self.half @ self.sums @ self.half.T)

    @cached_property
    def sandwich(self) -> Array:
        """Covariance (d, d) of the parameters, by `uneven_sums`."""
        return np.asarray(self.half @ self.uneven_sums @ self.half.T)

    @property
    def independent(self) -> Linearised:
        """The uncertainty for independent rows."""
        return self if self.dependence is None else self.dependence.independent

    @cached_property
    def by_sandwich(self) -> Linearised:
        """The uncertainty with the sandwich as covariance."""
        return replace(self, sums=self.uneven_sums)

    def mapped(
        self,
        values: Array,
        slopes: Array,
        at_bound: NDArray[np.bool_],
        unidentifiable: NDArray[np.bool_],
    ) -> Linearised:
        """The uncertainty of functions of the parameters, with slopes (q, d) at their values (q,).

        The marks (q,) say which functions are at a bound, or unidentifiable.
        """
        dependence = self.dependence
        if dependence is not None:
            independent = self.independent.mapped(values, slopes, at_bound, unidentifiable)
            dependence = replace(dependence, independent=independent)
        return replace(
            self,
            theta=values,
            half=slopes @ self.half,
            at_bound=at_bound,
            null_directions=self.null_directions @ slopes.T,
            unidentifiable=unidentifiable,
            dependence=dependence,
        )

    @cached_property
    def standard_errors(self) -> Array:
        """Standard errors (d,): NaN for a parameter at a bound, infinite if unidentifiable."""
        errors = np.sqrt(np.diag(self.covariance))
        errors[self.unidentifiable] = np.inf
        errors[self.at_bound] = np.nan
        return np.asarray(errors)

    @property
    def sandwich_ratios(self) -> Array:
        """Ratios (d,) of sandwich to usual standard errors; NaN without a usual one."""
        errors = self.standard_errors
        usable = np.where(np.isfinite(errors) & (errors > 0), errors, np.nan)
        return np.asarray(np.sqrt(np.diag(self.sandwich)) / usable)

    @cached_property
    def correlation(self) -> Array:
        """Correlation (d, d) of the estimates; NaN without a finite positive standard error."""
        errors = self.standard_errors
        usable = np.where(np.isfinite(errors) & (errors > 0), errors, np.nan)
        return np.asarray(self.covariance / np.outer(usable, usable))

    def quantile(self, level: float = 0.95) -> float:
        """Half width of the two-sided interval in standard errors (Student's t, or normal)."""
        if self.noise_known and self.dependence is None:
            return float(scipy.special.ndtri((1 + level) / 2))
        return float(scipy.special.stdtrit(self.freedom, (1 + level) / 2))

    def intervals(self, level: float = 0.95) -> Array:
        """Intervals of the parameters.

        Parameters
        ----------
        level : float, optional
            Confidence level.

        Returns
        -------
        ndarray of shape (d, 2)
            Lower and upper ends.
        """
        reach = self.quantiles(np.eye(self.theta.size), level) * self.standard_errors
        return np.stack([self.theta - reach, self.theta + reach], axis=1)

    def quantiles(self, gradients: Array, level: float = 0.95) -> Array:
        """`quantile` (n,) for quantities with gradients (n, d) with respect to the parameters."""
        if self.dependence is None:
            return np.full(len(gradients), self.quantile(level))
        freedom = self.dependence.freedom(gradients @ self.half)
        return np.asarray(scipy.special.stdtrit(freedom, (1 + level) / 2))

    def reach(self, gradients: Array, level: float = 0.95) -> Array:
        """Half widths of the intervals of functions of the parameters.

        Parameters
        ----------
        gradients : ndarray of shape (n, d)
            Derivatives of the functions with respect to the parameters.
        level : float, optional
            Confidence level.

        Returns
        -------
        ndarray of shape (n,)
            Half widths, in the units of the functions.
        """
        return self.quantiles(gradients, level) * self.spread(gradients)

    def band(self, model: Model, level: float, *inputs: Array) -> tuple[Array, Array]:
        """Prediction of a model with the interval of the curve.

        Parameters
        ----------
        model : Model
            A model with these parameters.
        level : float
            Confidence level.
        *inputs : ndarray of shape (N,)
            Input columns.

        Returns
        -------
        tuple of ndarray of shape (N,)
            Prediction, and half width of its interval.
        """
        value = model.predict(self.theta[None], *inputs)[0]
        return value, self.reach(model.jacobian(self.theta, *inputs), level)

    def spread(self, gradients: Array) -> Array:
        """Standard errors of functions of the parameters.

        Parameters
        ----------
        gradients : ndarray of shape (n, d)
            Derivatives of the functions with respect to the parameters.

        Returns
        -------
        ndarray of shape (n,)
            Standard errors: infinite for a function that a null direction moves, NaN for a function
            that depends only on parameters at a bound.
        """
        # By `half`: the covariance of nearly dependent parameters has too few digits.
        projected = gradients @ self.half
        variance = np.einsum("ij,jk,ik->i", projected, self.sums, projected)
        errors = np.sqrt(np.maximum(variance, 0.0))
        for direction in self.null_directions:
            size = np.abs(gradients) @ np.abs(direction)
            errors[np.abs(gradients @ direction) > INVOLVED * size] = np.inf
        moved = gradients != 0
        errors[moved[:, self.at_bound].any(axis=1) & ~moved[:, ~self.at_bound].any(axis=1)] = np.nan
        return np.asarray(errors)


def linearised(problem: CurveFit, theta: Array, neighbours: bool = False) -> Linearised:
    """Estimate the uncertainty of an optimum from the linearised model.

    With a robust loss the covariance is the one of an M-estimator [1]_. With priors, the estimate
    of an unknown variance counts only the parameters that the data determine [2]_.

    Parameters
    ----------
    problem : CurveFit
        The problem.
    theta : ndarray of shape (d,)
        Its optimum.
    neighbours : bool, optional
        Whether to allow for correlated errors of neighbouring rows. It has no effect if the errors
        are not significantly correlated, if the data number events, or with priors.

    Returns
    -------
    Linearised
        Covariance, standard errors and intervals.

    Raises
    ------
    ValueError
        If there are not more rows than parameters (with a known noise, fewer), if a derivative is
        not finite, or if a robust loss treats nearly all rows as outliers.

    References
    ----------
    .. [1] Huber, Robust Statistics, 1981, Ch. 7.6.
    .. [2] MacKay, Bayesian interpolation, Neural Computation 4, 1992, Sec. 2.4.
    """
    errors, J = _errors_and_slopes(problem, theta)
    # Parameters at a bound are fixed; the others cost a degree of freedom each.
    at_bound = at_bounds(problem.space, theta)
    count = int((~at_bound).sum())
    if errors.size < count + (not problem.noise_known):
        raise ValueError(
            f"{problem.name}: {errors.size} rows for {count} parameters; "
            "uncertainty needs more rows than parameters, or as many and their sigma"
        )
    exact = problem.model.jacobian_cost is None and set(problem.linear) == set(problem.space.names)
    singular = EXACT if exact else SINGULAR
    root = inverse_root(J, np.flatnonzero(~at_bound), singular)
    psi, stiffness = _influence(problem, errors)
    variance, freedom = _variance(problem, psi, stiffness, root.basis, count)
    spread, events = _spread(problem, root.basis, psi / stiffness, float(np.sqrt(variance)))
    uneven = spread.T @ spread
    if events:
        uneven *= (errors.size - 1) / (errors.size - count) * events / (events - 1)
    at = Linearised(
        theta=theta,
        half=root.half,
        sums=uneven if events else variance * np.eye(len(uneven)),
        uneven_sums=uneven,
        noise=float(np.sqrt(variance)),
        freedom=events - 1 if events else freedom,
        events=events,
        at_bound=at_bound,
        null_directions=root.null,
        unidentifiable=np.asarray(root.moved.any(axis=0)),
        noise_known=problem.noise_known,
        singular=singular,
    )
    if not neighbours or events or problem.prior is not None:
        return at
    return dependent(at, psi / stiffness, root.basis, series_of(problem))


def with_rows(at: Linearised, J: Array, more: int) -> Linearised:
    """The uncertainty of an optimum from derivatives J (N, d) of all rows, with `more` new ones.

    Errors are independent and have the standard deviation of `at`.
    """
    root = inverse_root(J, np.flatnonzero(~at.at_bound), at.singular)
    sums = at.noise**2 * np.eye(root.half.shape[1])
    return replace(
        at,
        half=root.half,
        sums=sums,
        uneven_sums=sums,
        freedom=at.freedom if at.events else at.freedom + more,
        null_directions=root.null,
        unidentifiable=np.asarray(root.moved.any(axis=0)),
        dependence=None,
    )


def _errors_and_slopes(problem: CurveFit, theta: Array) -> tuple[Array, Array]:
    """Errors (m,) and their derivatives (m, d), with priors after the rows of the data."""
    errors, J = problem.errors(theta), problem.error_slopes(theta)
    if problem.prior is not None:
        errors = np.append(errors, problem.prior.residuals(theta[None])[0])
        J = np.vstack([J, problem.prior.slopes(theta)])
    if not (np.isfinite(J).all() and np.isfinite(errors).all()):
        raise ValueError(f"{problem.name}: the derivatives at the optimum are not all finite")
    return errors, J


def _influence(problem: CurveFit, errors: Array) -> tuple[Array, float]:
    """The influence (m,) of the errors, and the mean of its derivative."""
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
    """The variance of the errors and its degrees of freedom, for `count` free parameters."""
    freedom = psi.size - count
    if problem.noise_known and problem.scale is not None:
        return problem.scale**2, freedom
    if problem.prior is None:
        return float(psi @ psi) / freedom / stiffness**2, freedom
    rows = len(problem.dataset)
    known_from_data = float(np.sum(basis[:rows] ** 2))  # number of parameters, MacKay's gamma
    left = max(rows - known_from_data, 1.0)
    return float(psi[:rows] @ psi[:rows]) / left, int(left)


def _spread(problem: CurveFit, basis: Array, errors: Array, noise: float) -> tuple[Array, int]:
    """Contributions of rows, or events, to the sandwich estimate, and the number of events or 0."""
    event = events_of(problem.dataset)
    if event is not None and problem.prior is None:
        # Rows of one event add up before the square.
        spread = basis * errors[:, None]
        spread = np.array([np.bincount(event, column) for column in spread.T]).T
        return spread, len(spread)
    # The error of a row in a fit without it; undefined if the row alone determines a parameter.
    left = 1 - np.sum(basis**2, axis=1)
    alone = left <= ALONE
    spread = basis * np.where(alone, noise, errors / np.where(alone, 1.0, left))[:, None]
    if problem.prior is not None:  # a single deviation does not determine the spread of a prior
        rows = len(problem.dataset)
        spread[rows:] = basis[rows:] * problem.prior.scale
    return spread, 0


def parameters_at_bounds(
    space: Space, theta: Array, at_bound: NDArray[np.bool_]
) -> list[tuple[str, str, str]]:
    """Name, "lower" or "upper", and bound with unit of each parameter at a bound."""
    parameters = []
    for i in np.flatnonzero(at_bound):
        p = space.parameters[i]
        low = theta[i] - p.low < p.high - theta[i]
        value = with_unit(f"{p.low if low else p.high:g}", p.unit)
        parameters.append((p.name, "lower" if low else "upper", value))
    return parameters


def at_bounds(space: Space, theta: Array) -> NDArray[np.bool_]:
    """Marks (d,) of parameters at a bound, where `refit` ends to rounding."""
    low, high = space.bounds
    slack = ROUNDING * (high - low)
    at = space.encode(theta)
    return np.asarray((at - low <= slack) | (high - at <= slack))
