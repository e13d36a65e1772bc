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
"""A direction whose singular value is this fraction of the largest is not seen by the data."""
BLIND = 1e-6


@dataclass(frozen=True, eq=False)
class Linearised:
    """What the derivatives at `theta` (d,) tell of it; units are the parameters' own.

    `covariance` (d, d) assumes errors of equal spread, independent between rows; `sandwich` (d, d)
    allows a spread that changes from row to row (White, Econometrica 48, 1980), with the factor
    for few rows. If the data number `events`, both allow errors that belong together within an
    event (Liang and Zeger, Biometrika 73, 1986), with the factors for few events; 0 if they do
    not. Both are of what the data see: 0 along the directions of `unseen` (u, d), in which theta
    can move and every row is predicted the same, and for parameters `at_bound` (d,), which are
    held.

    `noise` is the standard deviation of the errors in the output's unit, `freedom` the degrees of
    freedom of Student's t. `blind` (d,) marks the parameters that an unseen direction moves.
    """

    theta: Array
    covariance: Array
    sandwich: Array
    noise: float
    freedom: int
    events: int
    at_bound: NDArray[np.bool_]
    unseen: Array
    blind: NDArray[np.bool_]

    @cached_property
    def standard_errors(self) -> Array:
        """Standard errors (d,): NaN for a parameter held at its bound, infinite for a blind one."""
        errors = np.sqrt(np.diag(self.covariance))
        errors[self.blind] = np.inf
        errors[self.at_bound] = np.nan
        return np.asarray(errors)

    @cached_property
    def correlation(self) -> Array:
        """Correlation of the estimates, (d, d); NaN where a standard error is not above 0."""
        errors = self.standard_errors
        known = np.where(np.isfinite(errors) & (errors > 0), errors, np.nan)
        return np.asarray(self.covariance / np.outer(known, known))

    def quantile(self, level: float = 0.95) -> float:
        """How many standard errors the two-sided interval reaches (Student's t)."""
        return float(scipy.special.stdtrit(self.freedom, (1 + level) / 2))

    def intervals(self, level: float = 0.95) -> Array:
        """Lower and upper ends, (d, 2)."""
        reach = self.quantile(level) * self.standard_errors
        return np.stack([self.theta - reach, self.theta + reach], axis=1)

    def spread(self, gradients: Array) -> Array:
        """Standard errors (n,) of quantities with these gradients (n, d) in the parameters.

        Infinite for a quantity that an unseen direction moves.
        """
        variance = np.einsum("ij,jk,ik->i", gradients, self.covariance, gradients)
        errors = np.sqrt(np.maximum(variance, 0.0))
        for direction in self.unseen:
            size = np.abs(gradients) @ np.abs(direction)
            errors[np.abs(gradients @ direction) > BLIND * size] = np.inf
        return np.asarray(errors)


def linearised(problem: CurveFit, theta: Array) -> Linearised:
    """Uncertainty of the optimum `theta` (d,) of a problem.

    With a robust loss the covariance is that of an M-estimator (Huber 1981, Ch. 7.6). Raises
    ValueError if there are not more rows than parameters, if a derivative is not finite, or if
    a robust loss sees little else than outliers.
    """
    errors = problem.errors(theta)
    J = problem.model.jacobian(theta, *problem.inputs)
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
    psi, stiffness = problem.rho.influence(errors)
    shrink = float(stiffness.mean())
    if shrink <= 0:
        raise ValueError(
            f"{problem.name}: most errors are beyond the scale of the loss; choose a larger scale"
        )
    variance = float(psi @ psi) / freedom / shrink**2
    scale = np.linalg.norm(J[:, free], axis=0)
    scale[scale == 0] = 1.0
    U, s, Vt = np.linalg.svd(J[:, free] / scale, full_matrices=False)
    seen = s > SINGULAR * s[0] if s.size else np.zeros(0, dtype=bool)
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=seen)
    half = Vt.T * inverse / scale[:, None]  # half @ half.T is the inverse of J.T J
    spread = U * (psi / shrink)[:, None]
    few = errors.size / freedom
    event = events_of(problem.dataset)
    events = 0
    if event is not None:
        spread = np.array([np.bincount(event, column) for column in spread.T]).T
        events = len(spread)
        few *= (errors.size - 1) / errors.size * events / (events - 1)
    sandwich = half @ (spread.T @ spread) @ half.T * few
    covariance = sandwich if events else variance * half @ half.T
    unseen = np.zeros((int((~seen).sum()), theta.size))
    unseen[:, free] = Vt[~seen] / scale
    blind = np.zeros(theta.size, dtype=bool)
    blind[free] = (np.abs(Vt[~seen]) > BLIND).any(axis=0)
    return Linearised(
        theta=theta,
        covariance=_square(theta.size, free, covariance),
        sandwich=_square(theta.size, free, sandwich),
        noise=float(np.sqrt(variance)),
        freedom=events - 1 if events else freedom,
        events=events,
        at_bound=at_bound,
        unseen=unseen,
        blind=blind,
    )


def events_of(dataset: Dataset) -> NDArray[np.intp] | None:
    """The event of each row (N,), from 0, if the data number enough events; else None."""
    if EVENT not in dataset.columns:
        return None
    events, index = np.unique(dataset[EVENT], return_inverse=True)
    return np.asarray(index) if events.size >= FEWEST_EVENTS else None


def _at_bound(space: Space, theta: Array) -> NDArray[np.bool_]:
    low, high = space.bounds
    slack = AT_BOUND * (high - low)
    at = space.encode(theta)
    return np.asarray((at - low <= slack) | (high - at <= slack))


def _square(d: int, free: NDArray[np.intp], block: Array) -> Array:
    matrix = np.zeros((d, d))
    matrix[np.ix_(free, free)] = block
    return matrix
