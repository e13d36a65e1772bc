"""Standard errors, correlations and intervals from the model linearised at its optimum."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.identification.curve_fit import CurveFit
from miho.optim.space import Space
from miho.quantities import Array

EVENT = "event"
"""A column of this name numbers events, such as brakings, whose rows are not independent."""
FEWEST_EVENTS = 3
AT_BOUND = 1e-6
"""A parameter this close to a bound, as a fraction of its range, is at the bound."""
SINGULAR = 1e-10
"""A direction whose singular value is at most this fraction of the largest does not change the
predictions."""
INVOLVED = 1e-6
"""A component of a null direction above this fraction makes a parameter unidentifiable."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """The uncertainty of `theta` (d,) by the derivatives there; units are the parameters' own.

    `covariance` (d, d) assumes errors of equal spread, independent between rows; `sandwich` (d, d)
    allows a spread that changes from row to row (White, Econometrica 48, 1980), with the factor
    for few rows. If the data number `events`, both allow errors that belong together within an
    event (Liang and Zeger, Biometrika 73, 1986), with the factors for few events; 0 if they do
    not. Both are 0 along `null_directions` (k, d), in which theta can move while every row is
    predicted the same (the null space of the Jacobian), and for parameters `at_bound` (d,), which
    are held.

    `noise` is the standard deviation of the errors in the output's unit, `freedom` the degrees of
    freedom of Student's t, which is the normal distribution if the noise is known and no estimate
    (`noise_known`). `unidentifiable` (d,) marks the parameters that a null direction moves.
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
        if self.noise_known:
            return float(scipy.special.ndtri((1 + level) / 2))
        return float(scipy.special.stdtrit(self.freedom, (1 + level) / 2))

    def intervals(self, level: float = 0.95) -> Array:
        """Lower and upper ends, (d, 2)."""
        reach = self.quantile(level) * self.standard_errors
        return np.stack([self.theta - reach, self.theta + reach], axis=1)

    def spread(self, gradients: Array) -> Array:
        """Standard errors (n,) of quantities with these gradients (n, d) in the parameters.

        Infinite for a quantity that a null direction moves.
        """
        variance = np.einsum("ij,jk,ik->i", gradients, self.covariance, gradients)
        errors = np.sqrt(np.maximum(variance, 0.0))
        for direction in self.null_directions:
            size = np.abs(gradients) @ np.abs(direction)
            errors[np.abs(gradients @ direction) > INVOLVED * size] = np.inf
        return np.asarray(errors)


def linearised(problem: CurveFit, theta: Array) -> Linearised:
    """Uncertainty of the optimum `theta` (d,) of a problem.

    With a robust loss the covariance is that of an M-estimator (Huber 1981, Ch. 7.6). Raises
    ValueError if there are not more rows than parameters, if a derivative is not finite, or if
    a robust loss sees little else than outliers.
    """
    # Parameters at a bound are held; the others cost a degree of freedom each.
    errors = problem.errors(theta)
    J = problem.error_slopes(theta)
    if not (np.isfinite(J).all() and np.isfinite(errors).all()):
        raise ValueError(f"{problem.name}: the derivatives at the optimum are not all finite")
    at_bound = _at_bound(problem.space, theta)
    free = np.flatnonzero(~at_bound)
    freedom = errors.size - free.size
    if freedom < 1:
        raise ValueError(
            f"{problem.name}: {errors.size} rows for {free.size} parameters; "
            "uncertainty needs more rows than parameters"
        )
    # Variance of the errors; that of an M-estimator for a robust loss.
    psi, stiffness = problem.rho.influence(errors)
    shrink = float(stiffness.mean())
    if shrink <= 0:
        raise ValueError(
            f"{problem.name}: most errors are beyond the scale of the loss; choose a larger scale"
        )
    variance = float(psi @ psi) / freedom / shrink**2
    noise_known = problem.scale is not None and problem.sigma_known
    if noise_known:
        variance = float(problem.scale or 0.0) ** 2
    # Pseudo-inverse of J.T J by singular values, with each column scaled to unit length.
    scale = np.linalg.norm(J[:, free], axis=0)
    scale[scale == 0] = 1.0
    U, s, Vt = np.linalg.svd(J[:, free] / scale, full_matrices=False)
    determined = s > SINGULAR * s[0] if s.size else np.zeros(0, dtype=bool)
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=determined)
    half = Vt.T * inverse / scale[:, None]  # half @ half.T is the inverse of J.T J

    # Sandwich estimate, with its factor for few rows; rows of one event add up before the square.
    spread = U * (psi / shrink)[:, None]
    few_rows = errors.size / freedom
    event = events_of(problem.dataset)
    events = 0
    if event is not None:
        spread = np.array([np.bincount(event, column) for column in spread.T]).T
        events = len(spread)
        few_rows *= (errors.size - 1) / errors.size * events / (events - 1)
    sandwich = half @ (spread.T @ spread) @ half.T * few_rows
    covariance = sandwich if events else variance * half @ half.T

    # The null space, and the parameters that it moves.
    null_directions = np.zeros((int((~determined).sum()), theta.size))
    null_directions[:, free] = Vt[~determined] / scale
    unidentifiable = np.zeros(theta.size, dtype=bool)
    unidentifiable[free] = (np.abs(Vt[~determined]) > INVOLVED).any(axis=0)
    return Linearised(
        theta=theta,
        covariance=_square(theta.size, free, covariance),
        sandwich=_square(theta.size, free, sandwich),
        noise=float(np.sqrt(variance)),
        freedom=events - 1 if events else freedom,
        events=events,
        at_bound=at_bound,
        null_directions=null_directions,
        unidentifiable=unidentifiable,
        noise_known=noise_known,
    )


def events_of(dataset: Dataset) -> NDArray[np.intp] | None:
    """The event of each row (N,), from 0, if the data number enough events; else None."""
    if EVENT not in dataset.columns:
        return None
    events, index = np.unique(dataset[EVENT], return_inverse=True)
    return np.asarray(index) if events.size >= FEWEST_EVENTS else None


def _at_bound(space: Space, theta: Array) -> NDArray[np.bool_]:
    """Which parameters (d,) are at a bound, in the space's own scales."""
    low, high = space.bounds
    slack = AT_BOUND * (high - low)
    at = space.encode(theta)
    return np.asarray((at - low <= slack) | (high - at <= slack))


def _square(d: int, free: NDArray[np.intp], block: Array) -> Array:
    """The block of the free parameters within zeros for all, (d, d)."""
    matrix = np.zeros((d, d))
    matrix[np.ix_(free, free)] = block
    return matrix
