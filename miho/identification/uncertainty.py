"""Standard errors, correlations and intervals from the model linearised at its optimum."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from miho.identification.curve_fit import CurveFit

Array = NDArray[np.float64]

EVENT = "event"
"""A column of this name numbers events, such as brakings, whose rows are not independent."""
AT_BOUND = 1e-6
"""A parameter this close to a bound, as a fraction of its range, is at the bound."""
SINGULAR = 1e-10
"""A direction whose singular value is this fraction of the largest is not seen by the data."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """What the derivatives at `theta` (d,) tell of it; units are the parameters' own.

    `covariance` (d, d) assumes errors of equal spread, independent between rows; `sandwich` (d, d)
    allows a spread that changes from row to row (White, Econometrica 48, 1980), and errors that
    belong together within an event if the data have a column of that name (Liang and Zeger,
    Biometrika 73, 1986), with the usual factors for few rows and few events.

    `noise` is the standard deviation of the errors in the output's unit, `freedom` the rows
    beyond the parameters. A parameter `at_bound` (d,) is held there: its variance is NaN.
    `unseen` lists directions of parameter space (rows, scaled to parameters of their own size)
    that the data do not see; the parameters in them have infinite variance.
    """

    theta: Array
    covariance: Array
    sandwich: Array
    noise: float
    freedom: int
    at_bound: NDArray[np.bool_]
    unseen: Array

    @cached_property
    def standard_errors(self) -> Array:
        """Square roots of the variances, (d,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def correlation(self) -> Array:
        """Correlation of the estimates, (d, d); NaN where a standard error is not finite."""
        finite = np.where(np.isfinite(self.standard_errors), self.standard_errors, np.nan)
        return np.asarray(self.covariance / np.outer(finite, finite))

    def quantile(self, level: float = 0.95) -> float:
        """How many standard errors the two-sided interval reaches (Student's t)."""
        return float(scipy.stats.t.ppf((1 + level) / 2, self.freedom))

    def intervals(self, level: float = 0.95) -> Array:
        """Lower and upper ends, (d, 2)."""
        reach = self.quantile(level) * self.standard_errors
        return np.stack([self.theta - reach, self.theta + reach], axis=1)


def linearised(problem: CurveFit, theta: Array) -> Linearised:
    """Uncertainty of the optimum `theta` (d,) of a problem.

    With a robust loss the covariance is that of an M-estimator (Huber 1981, Ch. 7.6). Raises
    ValueError if there are not more rows than parameters, or if a derivative is not finite.
    """
    errors = problem.errors(theta)
    J = problem.model.jacobian(theta, *problem.inputs)
    if not (np.isfinite(J).all() and np.isfinite(errors).all()):
        raise ValueError(f"{problem.name}: the derivatives at the optimum are not all finite")
    space = problem.space
    span = AT_BOUND * (space.high - space.low)
    at_bound = (theta - space.low <= span) | (space.high - theta <= span)
    free = np.flatnonzero(~at_bound)
    freedom = errors.size - free.size
    if freedom < 1:
        raise ValueError(
            f"{problem.name}: {errors.size} rows for {free.size} parameters; "
            "uncertainty needs more rows than parameters"
        )
    psi, stiffness = problem.rho.influence(errors)
    shrink = float(stiffness.mean())
    variance = float(psi @ psi) / freedom / shrink**2
    scale = np.linalg.norm(J[:, free], axis=0)
    scale[scale == 0] = 1.0
    U, s, Vt = np.linalg.svd(J[:, free] / scale, full_matrices=False)
    seen = s > SINGULAR * s[0] if s.size else np.zeros(0, dtype=bool)
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=seen)
    half = Vt.T * inverse / scale[:, None]  # half @ half.T is the inverse of J.T J
    covariance = _square(theta.size, free, variance * half @ half.T)
    spread = U * (psi / shrink)[:, None]
    few = errors.size / freedom
    if EVENT in problem.dataset.columns:
        _, event = np.unique(problem.dataset[EVENT], return_inverse=True)
        spread = np.array([np.bincount(event, column) for column in spread.T]).T
        events = len(spread)
        few *= (errors.size - 1) / errors.size * events / (events - 1) if events > 1 else np.nan
    meat = half @ (spread.T @ spread) @ half.T * few
    sandwich = _square(theta.size, free, meat)
    unseen = np.zeros((int((~seen).sum()), theta.size))
    unseen[:, free] = Vt[~seen]
    for direction in unseen:
        touched = np.abs(direction) > 1e-6
        covariance[touched, touched] = sandwich[touched, touched] = np.inf
    return Linearised(
        theta, covariance, sandwich, float(np.sqrt(variance)), freedom, at_bound, unseen
    )


def _square(d: int, free: NDArray[np.intp], block: Array) -> Array:
    matrix = np.full((d, d), np.nan)
    matrix[np.ix_(free, free)] = block
    return matrix
