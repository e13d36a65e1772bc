"""The search for optima that are as good as the best one within the noise."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.identification.deadline import Deadline
from miho.identification.refit import Refit, refit
from miho.optim.trace import Minimum, in_place
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.uncertainty import Linearised

GENEROUS = 10.0
"""Minima are examined if their excess of squares is at most this multiple of the excess that an
interval of independent rows allows: dependent rows widen intervals about 3 times."""
UNFINISHED = 2.0
"""A descent starts at minima whose excess is at most this multiple of the allowed excess, because a
search ends slightly above its minima."""
REPEATED = 0.1
"""Optima closer than this number of standard errors count as one: their intervals are the same."""
SAME_CURVE = 1e-8
"""Optima give the same curve if their residuals differ by less than this share of the sum of
squares; descents leave 1e-10. A symmetry of the model repeats such an optimum."""


def optima_within_noise(
    problem: CurveFit,
    optimum: Refit,
    minima: Sequence[Minimum],
    level: float = 0.95,
    deadline: Deadline | None = None,
) -> tuple[Refit, ...]:
    """The distinct optima that are as good as the best within the noise, the best first.

    The sum of squares of these optima exceeds the smallest one by no more than a profile interval
    of this `level` allows. Optima that give the same curve count once.

    A new descent from each of the `minima`, the ends of a search, that may be within the noise
    leads to its optimum, which replaces the best one if it is better. No minimum is examined after
    the deadline. The result is `optimum` alone if the data number events or have no noise, because
    there is no likelihood ratio then.
    """
    count, known = problem.residual_count, [_Known(problem, optimum)]
    highest = _loosely(problem, optimum, level)
    near = [m for m in sorted(minima) if m.loss * count <= highest]
    near = [m for m in near if not known[0].is_at(np.array(m.theta))]
    if not near or optimum.cost <= problem.resolution * count:
        return (optimum,)
    from miho.identification.uncertainty import linearised

    try:
        at = linearised(problem, optimum.theta, neighbours=True)
    except ValueError:
        return (optimum,)
    if at.events:
        return (optimum,)
    allowed = excess(problem, at, level)
    for minimum in near:
        theta, above = np.array(minimum.theta), minimum.loss * count - optimum.cost
        if above > UNFINISHED * allowed or (deadline is not None and deadline.over):
            break
        if any(each.is_at(theta) for each in known):
            continue
        fit = refit(problem, theta, deadline=deadline)
        other = _Known(problem, fit)
        if (
            not any(each.gives(fit.theta) for each in known)
            and fit.cost <= optimum.cost + allowed
            and np.isfinite(other.slopes).all()
        ):
            known.append(other)
    fits = sorted((each.fit for each in known), key=lambda fit: fit.cost)
    return tuple(fit for fit in fits if fit.cost <= fits[0].cost + allowed)


class _Known:
    """A known optimum, with derivatives that are computed on demand."""

    def __init__(self, problem: CurveFit, fit: Refit) -> None:
        self.fit, self._problem = fit, problem

    @cached_property
    def slopes(self) -> Array:
        """Derivatives (m, d) of the residuals."""
        return self._problem.jacobian(self.fit.theta)

    def is_at(self, theta: Array) -> bool:
        """Whether parameters (d,) are within REPEATED standard errors of the optimum."""
        if in_place(theta, self.fit.theta):
            return True
        step = self.slopes @ (theta - self.fit.theta)
        return bool(step @ step <= REPEATED**2 * _roughly(self._problem, self.fit)[0])

    def gives(self, theta: Array) -> bool:
        """Whether parameters (d,) are this optimum, or have the same residuals."""
        if self.is_at(theta):
            return True
        change = self._problem.residuals(theta) - self._problem.residuals(self.fit.theta)
        return bool(change @ change <= SAME_CURVE * self.fit.cost)


def error_variance(problem: CurveFit, at: Linearised) -> float:
    """The variance of the errors in a likelihood ratio: cost / freedom for the square loss."""
    if at.noise_known or problem.prior is not None:
        return at.noise**2
    psi, stiffness = problem.rho.influence(problem.errors(at.theta))
    return float(psi @ psi / at.independent.freedom / stiffness.mean())


def excess(problem: CurveFit, at: Linearised, level: float) -> float:
    """The largest excess of the sum of squares, over the smallest, within intervals of a level.

    If rows depend on each other, the parameter with the widest interval decides.
    """
    reach = at.quantile(level)
    if at.dependence is not None:
        with np.errstate(invalid="ignore", divide="ignore"):
            wider = at.standard_errors / at.independent.standard_errors
        reach *= max(1.0, float(np.max(wider, initial=1.0, where=np.isfinite(wider))))
    return reach**2 * error_variance(problem, at)


def _roughly(problem: CurveFit, optimum: Refit) -> tuple[float, int]:
    """The variance of the errors and its degrees of freedom, without derivatives."""
    freedom = max(len(problem.dataset) - len(problem.space), 1)
    if problem.scale is not None and problem.sigma_known:
        return problem.scale**2, freedom
    return optimum.cost / freedom, freedom


def _loosely(problem: CurveFit, optimum: Refit, level: float) -> float:
    """The largest sum of squares of a minimum that may belong to an optimum within the noise."""
    variance, freedom = _roughly(problem, optimum)
    reach = float(scipy.special.stdtrit(freedom, (1 + level) / 2))
    return optimum.cost + GENEROUS * reach**2 * variance
