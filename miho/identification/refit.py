"""A local least-squares descent, which profiles, the bootstrap and validation repeat."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.deadline import Deadline
    from miho.identification.limits import Pin

EVALUATIONS = 200
"""Default limit on evaluations of the residuals: enough for a start near the optimum."""
STANDSTILL = 1e-8
"""A descent has converged if its second half gains less than this fraction of the sum of
squares."""
FINE = 1e5
"""A range is too wide as a scale if it changes the predictions by this multiple of the output."""
AT_BOUND = 1e-10
"""A parameter this close to a bound, as a fraction of its range, is moved to the bound."""
HARMLESS = 1e-6
"""Increase of the sum of squares, as a fraction, that such a move may cost: simulations have errors
of rounding, and a picofarad is not at a bound of 0."""
AT_OPTIMUM = 1e-16
"""A start is the optimum if the linear model predicts a gain of less than this fraction of the sum
of squares, which is a distance of 1e-8 sqrt(N) standard errors."""


class OutOfTimeError(Exception):
    """The time limit of a report is over."""


class Refit(NamedTuple):
    """The end of a descent: parameters (d,), and the sum of squared (transformed) residuals.

    It is a local optimum if `converged`. Otherwise the descent was still improving after
    `evaluations`, ran out of time, or met derivatives that are not finite.
    """

    theta: Array
    cost: float
    converged: bool = True
    evaluations: int = 1

    @property
    def moving(self) -> int:
        """Evaluations after which the descent was still improving; 0 if it converged."""
        return 0 if self.converged else self.evaluations


class _NoDerivatives(Exception):  # noqa: N818 -- ends a descent, no error
    """Some derivatives are not finite."""


class _Stationary(Exception):  # noqa: N818 -- ends a descent, no error
    """All derivatives with respect to the free parameters are 0."""


def refit(
    problem: CurveFit,
    start: Array,
    weights: Array | None = None,
    fixed: Collection[int] = (),
    tolerance: float = 1e-10,
    evaluations: int = EVALUATIONS,
    deadline: Deadline | None = None,
    pin: Pin | None = None,
    fine: bool = False,
) -> Refit:
    """Descend to the optimum of a problem near a start, within the box.

    Parameters
    ----------
    problem : CurveFit
        The problem.
    start : ndarray of shape (d,)
        The starting point. Points without finite residuals are rejected.
    weights : ndarray of shape (N,), optional
        Weights of the squared residuals of the rows.
    fixed : collection of int
        Positions of parameters that keep the values of the start.
    tolerance : float
        Relative tolerance of sum of squares and parameters.
    evaluations : int
        Limit on evaluations of the residuals.
    deadline : Deadline, optional
        The time limit.
    pin : Pin, optional
        A residual that fixes a tied parameter.
    fine : bool, optional
        Whether parameters in wide ranges are scaled by their effect. This suits the last descent,
        because it misses optima far from the start.

    Returns
    -------
    Refit
        The best point so far if a limit ends the descent.
    """
    objective = _Objective(problem, start, weights, fixed, deadline, pin)
    start_values = objective.residuals(objective.first)
    if not math.isfinite(objective.costs[-1]):  # beyond a limit, or the model fails
        theta = objective.along_limits(objective.best)
        if theta is objective.best:
            return Refit(theta, math.inf, converged=False)
        return Refit(theta, objective.cost(theta))
    if not objective.first.size or objective.costs[-1] == 0:
        return Refit(objective.best, objective.costs[-1])

    # The solver begins with a point that was evaluated already.
    def residuals(part: Array) -> Array:
        return start_values if objective.is_first(part) else objective.residuals(part)

    def jacobian(part: Array) -> Array:
        return start_slopes if objective.is_first(part) else objective.jacobian(part)

    try:
        start_slopes = objective.jacobian(objective.first)
        if at_optimum(start_slopes, start_values, objective.first):
            return objective.end(converged=True)
        with np.errstate(all="ignore"):  # SciPy divides by 0 for a parameter without an effect
            start_slopes = objective.rescaled(start_slopes, start_values, fine)
            solution = scipy.optimize.least_squares(
                residuals, objective.first, jac=jacobian, bounds=objective.bounds, x_scale="jac",
                ftol=tolerance, xtol=tolerance, gtol=None, max_nfev=evaluations,
            )  # fmt: skip
        # SciPy continues along directions that the data do not determine, and gains nothing.
        costs = objective.costs
        halfway = costs[(len(costs) + 1) // 2]
        converged = solution.status > 0 or costs[-1] >= (1 - STANDSTILL) * halfway
        objective.move_to_bounds()
    except _Stationary:
        converged = True
    except (_NoDerivatives, OutOfTimeError):
        converged = False
    end, left = objective.end(bool(converged)), evaluations - len(objective.costs) + 1
    coarse = not fine or end.cost < objective.costs[1] / FINE**2
    if left > 0 and objective.is_wide and coarse:  # the scale of the start is too coarse here
        again = refit(problem, end.theta, weights, fixed, tolerance, left, deadline, pin, fine=True)
        return again._replace(evaluations=evaluations - left + again.evaluations)
    return end


def at_optimum(J: Array, r: Array, part: Array) -> bool:
    """Whether no step inside the box reduces residuals r (N,) with derivatives J (N, f).

    `part` (f,) is 0 or 1 at a bound. A parameter stays there if a descent would leave the box.
    """
    with np.errstate(all="ignore"):
        slope = J.T @ r
        fixed = ((part == 0) & (slope >= 0)) | ((part == 1) & (slope <= 0))
        columns = np.column_stack([J[:, ~fixed], r])
        size = np.sqrt((columns**2).sum(axis=0))
        columns /= size
        if columns.shape[1] > r.size or not (np.isfinite(columns) & np.isfinite(size)).all():
            return False
    R = np.asarray(np.linalg.qr(columns, mode="r"))
    return bool(np.sum(R[:-1, -1] ** 2) <= AT_OPTIMUM)  # of which the last column has norm 1


class _Objective:
    """Residuals as a function of the free parameters, scaled to 0 to 1 between their bounds.

    The solver then works in any unit, as it has no absolute tolerance. `rescaled` chooses a finer
    scale, with the start at 1, for parameters whose range is too wide. `first` (f,) is the start in
    these coordinates, and `best` the best configuration (d,) so far. `costs` lists the smallest sum
    of squares so far: infinity at first, and one entry per evaluation.
    """

    def __init__(
        self,
        problem: CurveFit,
        start: Array,
        weights: Array | None,
        fixed: Collection[int],
        deadline: Deadline | None,
        pin: Pin | None,
    ) -> None:
        space = problem.space
        self._problem, self._deadline, self._pin = problem, deadline, pin
        self._limited = weights is None and problem.model.ties is not None
        self._low, self._high = space.bounds
        self._start = self.best = space.clip(start)
        self._fixed = list(fixed)
        self._free = np.array([i for i in range(self.best.size) if i not in fixed], dtype=int)
        self._root = None
        if weights is not None:  # residuals of priors, after the rows, have weight 1
            self._root = np.ones(problem.residual_count)
            self._root[: weights.size] = np.sqrt(weights)
        self._logarithmic = np.array([p.scale == "log" for p in space.parameters])
        self._origin, self._unit = self._low, self._high - self._low
        self._at_origin = np.zeros(self._low.size)
        share = (space.encode(self._start) - self._low) / self._unit
        self.first = np.clip(share[self._free], 0.0, 1.0)
        self.costs = [math.inf]
        self.is_wide = False

    def rescaled(self, slopes: Array, residuals: Array, fine: bool) -> Array:
        """Scale parameters in too wide a range by their effect at the start.

        Takes slopes (N, f) and residuals (N,) at the start, and returns the slopes in the new
        scale. Without `fine`, this only notes whether a range is too wide (`is_wide`).
        """
        problem, free = self._problem, self._free
        output = problem.dataset[problem.dataset.output]
        output = output if problem.weights is None else output * problem.weights
        size = max(np.linalg.norm(output), np.linalg.norm(residuals))
        effect = np.linalg.norm(slopes, axis=0)
        inside = (self.first > 0) & (self.first < 1)  # as at sqrt(0), slopes may be infinite there
        wide = inside & (effect > FINE * size)
        self.is_wide = bool(wide.any())
        if not (fine and self.is_wide):
            return slopes
        factor = np.where(wide, size / effect, 1.0)
        self.first = np.where(wide, 1.0, self.first)
        self._at_origin, self._unit = self._at_origin.copy(), self._unit.copy()
        self._origin = np.array(self._low)
        self._at_origin[free[wide]] = 1.0
        self._origin[free[wide]] = problem.space.encode(self._start)[free[wide]]
        self._unit[free] *= factor
        return slopes * factor

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The bounds (f,) of the free parameters in the coordinates of the solver."""
        ends = (np.stack(self._problem.space.bounds) - self._origin) / self._unit
        ends[np.abs(ends) > FINE / 10] *= math.inf  # so far that they would slow the solver down
        low, high = (ends + self._at_origin)[:, self._free]
        return low, high

    def is_first(self, part: Array) -> bool:
        """Whether `part` (f,) is the start."""
        return np.array_equal(part, self.first)

    def move_to_bounds(self) -> None:
        """Move the best point to bounds that it is at, which the solver only approaches."""
        space = self._problem.space
        shares = (space.encode(self.best) - self._low) / (self._high - self._low)
        near = np.abs(shares - shares.round()) <= AT_BOUND
        near[self._fixed] = False
        theta = np.where(near, np.where(shares < 0.5, space.low, space.high), self.best)
        if not np.array_equal(theta, self.best):
            with np.errstate(over="ignore"):
                cost = float(np.sum(self._residuals_at(theta) ** 2))
            if cost <= (1 + HARMLESS) * self.costs[-1]:
                self.best = theta

    def end(self, converged: bool) -> Refit:
        """The best point so far, moved along the limits of tied parameters."""
        end = Refit(self.best, self.costs[-1], converged, len(self.costs) - 1)
        theta = self.along_limits(end.theta)
        if self._limited and not (self._fixed or self._pin):
            from miho.identification.limits import along_sides

            theta = along_sides(self._problem, theta)
        if theta is end.theta:
            return end
        return Refit(theta, self.cost(theta), True, end.evaluations)

    def along_limits(self, theta: Array) -> Array:
        """A better point (d,) along limits of tied parameters, or `theta` itself."""
        if not self._limited:
            return theta
        from miho.identification.limits import along_limits

        return along_limits(self._problem, theta, self._fixed, self._pin)

    def cost(self, theta: Array) -> float:
        """The sum of squares without weights, including a pin."""
        pinned = 0.0 if self._pin is None else self._pin.residual(theta) ** 2
        return float(np.sum(self._problem.residuals(theta) ** 2)) + pinned

    def residuals(self, part: Array) -> Array:
        """Weighted residuals (N,); NaN if the model fails, as it may on a part of the box."""
        return self._residuals_at(self._configuration(part))

    def _residuals_at(self, theta: Array) -> Array:
        if self._deadline is not None and self.costs[-1] < math.inf:
            self._deadline.check()
        try:
            values = self._problem.residuals(theta)
        except ValueError:
            values = np.full(self._problem.residual_count, np.nan)
        values = values if self._root is None else values * self._root
        if self._pin is not None:
            values = np.append(values, self._pin.residual(theta))
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(values @ values)
        lowest = self.costs[-1]
        if cost < lowest:
            self.best = theta
        self.costs.append(min(lowest, cost) if math.isfinite(cost) else lowest)
        return values

    def jacobian(self, part: Array) -> Array:
        """Derivatives (N, f) of the residuals; raises _NoDerivatives or _Stationary."""
        theta = self._configuration(part)
        stretch = self._unit * np.where(self._logarithmic, theta, 1.0)
        whole = self._problem.jacobian(theta)
        if self._pin is not None:
            whole = np.vstack([whole, self._pin.slope(theta)])
        derivatives = whole[:, self._free] * stretch[self._free]
        if not np.isfinite(derivatives).all():
            raise _NoDerivatives
        if not derivatives.any():
            raise _Stationary  # SciPy would divide by 0
        return np.asarray(derivatives if self._root is None else derivatives * self._root[:, None])

    def _configuration(self, part: Array) -> Array:
        """The configuration (d,) with free parameters `part` (f,)."""
        if self.is_first(part):  # without rounding by the scale
            return self._start
        space, free = self._problem.space, self._free
        encoded = space.encode(self._start).copy()
        encoded[free] = self._origin[free] + self._unit[free] * (part - self._at_origin[free])
        theta = space.decode(encoded)
        theta[self._fixed] = self._start[self._fixed]
        return np.asarray(space.clip(theta))
