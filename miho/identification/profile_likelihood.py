"""Intervals by profile likelihood: how far a parameter can go while the others make up for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.identification.curve_fit import CurveFit
from miho.identification.refit import Deadline, Refit, refit
from miho.identification.uncertainty import Linearised
from miho.quantities import Array

EXPANSIONS = 20
"""Steps outwards at most until an interval's end lies behind."""
WALL = 100.0
"""Where the residuals are not finite, the signed root is this many times the quantile sought."""
HALVINGS = 30
"""Steps at most of the root finding between a point inside and one outside: enough for a jump."""
CLOSE = 0.005
"""The search for an end stops when the signed root is within this of the quantile."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one parameter: (values, tau), ordered by value, and the interval's ends.

    tau is the signed root of the likelihood ratio, in the units of Student's t: a straight line
    for a linear model, so its bend shows how far the linearised interval is off. An end is
    infinite if the box was reached first: the data do not bound the parameter on that side. `best`
    is the smallest sum of squares of all refits: below that of the centre it is another optimum.
    """

    values: Array
    tau: Array
    low: float
    high: float
    best: Refit


def likelihood_profile(
    problem: CurveFit,
    at: Linearised,
    index: int,
    level: float = 0.95,
    deadline: Deadline | None = None,
) -> Profile:
    """Profile of the parameter at position `index` (Bates and Watts 1988, Ch. 6.1.2).

    The interval holds the values v for which the smallest sum of squares with the parameter fixed
    at v exceeds the smallest of all by less than F(1, freedom) allows. Where rows depend on each
    other, tau is divided by how many times wider that makes the parameter's linearised interval
    (Kent, Biometrika 69, 1982), so that the profile keeps its shape. Every refit starts where the
    linearised model expects its optimum; where the residuals are not finite there is a wall.
    Raises OutOfTimeError after the deadline.
    """
    quantile = at.quantile(level)
    tau = _SignedRoot(problem, at, index, level, deadline)
    # First to the ends of independent rows: where a poor optimum makes neighbours alike, a better
    # one may lie between. From there to those of rows that depend on each other.
    first = at.independent.quantile(level) / _widening(at, index, level)
    step = at.independent.quantile(level) * float(at.independent.standard_errors[index])
    ends = []
    for sign, bound in ((-1, problem.space.low[index]), (1, problem.space.high[index])):
        end = _end(tau, sign, bound, first, step, tau.centre)
        if np.isfinite(end) and quantile > first + CLOSE:
            end = _end(tau, sign, bound, quantile, step * (quantile / first - 1), end)
        ends.append(end)
    values = np.array(sorted(tau.points))
    low, high = ends
    return Profile(values, np.array([tau.points[v][0] for v in values]), low, high, tau.best)


class _SignedRoot:
    """tau as a function of the parameter's value, by a refit with the parameter fixed there.

    `points` maps the values so far to tau and the parameters (d,) of the refit. tau is at most
    `largest` in size, and is that where no refit has finite residuals. `best` is the refit with the
    smallest sum of squares.
    """

    def __init__(
        self,
        problem: CurveFit,
        at: Linearised,
        index: int,
        level: float,
        deadline: Deadline | None,
    ) -> None:
        self._problem, self._index, self._deadline = problem, index, deadline
        self._largest = WALL * at.quantile(level)
        self._cost = float(np.sum(problem.residuals(at.theta) ** 2))
        psi, stiffness = problem.rho.influence(problem.errors(at.theta))
        # The variance of the errors, cost / freedom for the square loss.
        variance = float(psi @ psi / at.independent.freedom / stiffness.mean())
        if at.noise_known:
            variance = at.noise**2
        self._unit = variance * _widening(at, index, level) ** 2
        self._direction = _conditional_direction(at, index)
        # Along directions that the data do not see a refit would take many steps, in vain.
        self._fixed = {index, *_superfluous(at)}
        self.centre = float(at.theta[index])
        self.points = {self.centre: (0.0, at.theta)}
        self.best = Refit(at.theta, self._cost)

    def __call__(self, value: float) -> float:
        """tau at a value of the parameter; raises OutOfTimeError after the deadline."""
        if value not in self.points:
            # From the nearest refit, moved as the linearised model says ...
            near = self.points[min(self.points, key=lambda point: abs(point - value))][1]
            guess = near + self._direction * (value - near[self._index])
            fit = self._refit(guess, value)
            if not np.isfinite(fit.cost):  # ... or unmoved, if the guess is behind a wall
                fit = self._refit(near.copy(), value)
            if self._deadline is not None:
                self._deadline.check()
            self.best = min(self.best, fit, key=lambda refit: refit.cost)
            root = float(np.sqrt(max(fit.cost - self._cost, 0.0) / self._unit))
            root = min(root, self._largest)
            self.points[value] = (root if value > self.centre else -root, fit.theta)
        return self.points[value][0]

    def _refit(self, guess: Array, value: float) -> Refit:
        guess[self._index] = value
        return refit(
            self._problem, guess, fixed=self._fixed, tolerance=1e-8, deadline=self._deadline
        )


def _end(
    tau: _SignedRoot, sign: int, bound: float, quantile: float, step: float, inside: float
) -> float:
    """Where |tau| reaches the quantile on one side; infinite if it does not within the box.

    `sign` is -1 for the lower end and 1 for the upper, `bound` that of the box there, `inside` a
    value that is not beyond the end, and `step` the distance from it at which a linear model would
    reach the quantile.
    """
    centre = tau.centre
    if inside + step == inside:  # known better than it can be written
        return inside

    # Outwards until a point lies beyond the end.
    for _ in range(EXPANSIONS):
        outside = sign * min(sign * (inside + sign * step), sign * bound)
        if abs(tau(outside)) >= quantile - CLOSE:
            break
        if outside == bound:
            return sign * np.inf
        # By what a straight line from the centre would need, and a little more.
        slope = abs(tau(outside)) / abs(outside - centre)
        missing = 1.05 * (quantile - abs(tau(outside))) / slope if slope > 0 else np.inf
        inside, step = outside, min(missing, 3 * step)
    else:
        return sign * np.inf
    if abs(tau(outside)) <= quantile + CLOSE:
        return outside

    # Between the last point inside and the first outside.
    from scipy.optimize.elementwise import find_root

    solution = find_root(
        np.vectorize(lambda value: abs(tau(float(value))) - quantile),
        (inside, outside),
        tolerances={"fatol": CLOSE},
        maxiter=HALVINGS,
    )
    return float(solution.x)


def _quantile(at: Linearised, index: int, level: float) -> float:
    """How many standard errors the linearised interval of a parameter reaches."""
    return float(at.quantiles(np.eye(at.theta.size)[index : index + 1], level)[0])


def _widening(at: Linearised, index: int, level: float) -> float:
    """How many times wider than for independent rows a profile is, for tau up to `at.quantile`."""
    if at.dependence is None:
        return 1.0
    errors, independent = at.standard_errors[index], at.independent.standard_errors[index]
    return float(_quantile(at, index, level) / at.quantile(level) * (errors / independent))


def _superfluous(at: Linearised) -> list[int]:
    """As many parameters as there are null directions: with these fixed, all others are seen."""
    if not len(at.null_directions):
        return []
    pivots = scipy.linalg.qr(at.null_directions, mode="r", pivoting=True)[1]
    return [int(k) for k in pivots[: len(at.null_directions)]]


def _conditional_direction(at: Linearised, index: int) -> Array:
    """How the other parameters follow when one moves by 1, in the linearised model, (d,)."""
    column = at.independent.covariance[:, index]
    return column / column[index] if column[index] > 0 else np.zeros_like(column)
