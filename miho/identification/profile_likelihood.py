"""Intervals by profile likelihood: the range of a parameter if the others compensate for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.identification.alternatives import error_variance
from miho.identification.curve_fit import CurveFit
from miho.identification.deadline import Deadline
from miho.identification.limits import Pin
from miho.identification.refit import OutOfTimeError, Refit, refit
from miho.identification.stated import reported_space
from miho.identification.uncertainty import Linearised
from miho.models.tied import Tied
from miho.quantities import Array

SIGNS = (-1, 1)
"""The signs of the lower and the upper side of a profile."""
EXPANSIONS = 20
"""Largest number of outward steps to a point beyond the end of the interval."""
WALL = 100.0
"""The signed root is this multiple of the quantile if the residuals are not finite."""
HALVINGS = 30
"""Largest number of root-finding steps between points inside and outside: enough for a jump."""
CLOSE = 0.005
"""The search for an end stops when the signed root is this close to the quantile."""
INSIDE = 1e-2
"""Parameters at a bound are also refitted from a start inside it by this share of their range."""
PINNED = 1e3
"""Weight of the residual that fixes a tied parameter: this many standard deviations of the errors
for each standard error of the parameter. The parameter yields by tau / PINNED^2 standard errors,
and tau^2 increases by (tau / PINNED)^2."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile likelihood of one parameter, and its interval.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Values of the parameter, in ascending order.
    tau : ndarray of shape (n,)
        Signed root of the likelihood ratio, in units of Student's t. It is a straight line for a
        linear model, so its curvature shows the error of the linearised interval.
    low, high : float
        Ends of the interval. An end is infinite (open) if the profile reached the bound of the box
        first: the data do not limit the parameter on that side within the box.
    best : Refit
        The refit with the smallest sum of squares; below the optimum it is another optimum.
    """

    values: Array
    tau: Array
    low: float
    high: float
    best: Refit

    @property
    def tried(self) -> tuple[float, float]:
        """The ends of the interval, and the last tried value for an open end."""
        low = self.low if np.isfinite(self.low) else float(self.values[0])
        high = self.high if np.isfinite(self.high) else float(self.values[-1])
        return low, high


class Side(NamedTuple):
    """One side of a profile: the end of the interval, tau by value, and the best refit."""

    end: float
    tau: dict[float, float]
    best: Refit


def profile_side(
    problem: CurveFit,
    optima: Sequence[Linearised],
    level: float,
    deadline: Deadline,
    side: tuple[int | str, int],
) -> Side | None:
    """A side of the profile likelihood of a parameter; None after the deadline.

    The interval contains the values v for which the smallest sum of squares with the parameter
    fixed at v exceeds the overall minimum by less than F(1, freedom) allows [1]_. Dependence of
    rows widens the linearised interval by a factor. tau is divided by this factor [2]_, so the
    profile keeps its shape. Every refit starts at the optimum of the linearised model.

    Parameters
    ----------
    problem : CurveFit
        The problem.
    optima : sequence of Linearised
        Its optimum, and further optima within the noise. The profile is the lower envelope of the
        profiles from all optima, and the interval is the hull of all values within.
    level : float
        Confidence level of the interval, between 0 and 1.
    deadline : Deadline
        The time limit.
    side : tuple of (int or str, int)
        Position of a free parameter or name of a tied one, and a sign of SIGNS.

    References
    ----------
    .. [1] Bates and Watts, Nonlinear Regression Analysis, 1988, Ch. 6.1.2.
    .. [2] Kent, Biometrika 69, 1982.
    """
    of, sign = side
    try:
        deadline.check()
        return _side(_SignedRoot(problem, optima, of, level, deadline), sign, level)
    except OutOfTimeError:
        return None


def joined(lower: Side, upper: Side) -> Profile:
    """The profile from its two sides."""
    tau = {**lower.tau, **upper.tau}
    values = np.array(sorted(tau))
    best = min(lower.best, upper.best, key=lambda refit: refit.cost)
    return Profile(values, np.array([tau[v] for v in values]), lower.end, upper.end, best)


def _side(tau: _SignedRoot, sign: int, level: float) -> Side:
    """The side of a profile with a sign, from the outermost optimum on this side.

    The search goes to the end for independent rows first, because a poor optimum correlates
    neighbours and a better one may lie closer. From there it continues to the end for dependent
    rows.
    """
    at, sized = tau.sized.at, tau.sized
    quantile, bound = at.quantile(level), sized.low if sign < 0 else sized.high
    first = at.independent.quantile(level) / sized.widening(level)
    within = [branch for branch in tau.branches if abs(tau(branch.centre)) < first]
    outermost = max(within, key=lambda branch: sign * branch.centre)
    error = outermost.error if outermost.has_error else sized.error
    step = at.independent.quantile(level) * error
    end = _end(tau, sign, bound, first, step, outermost.centre)
    if np.isfinite(end) and quantile > first + CLOSE:
        end = _end(tau, sign, bound, quantile, step * (quantile / first - 1), end)
    end = bound if np.isinf(end) and sized.limited else end
    return Side(end, tau.points.copy(), tau.best)


class _Branch:
    """An optimum as a start of refits, with the parameters (d,) of these refits by value.

    The profiled parameter is a free one at `position`, or a tied one. At the optimum it has the
    value `centre`, the standard error `error`, and the derivatives `gradient` (d,) with respect to
    the free parameters. `low` and `high` are its range, and limits of the interval as well if
    `limited`.
    """

    def __init__(self, problem: CurveFit, at: Linearised, of: int | str) -> None:
        model, space = problem.model, problem.space
        self.at, self.limited = at, False
        self.position = of if isinstance(of, int) else None
        if isinstance(of, int):
            p = space.parameters[of]
            self.centre, self.low, self.high = float(at.theta[of]), p.low, p.high
            self.gradient = np.eye(len(space))[of]
        elif isinstance(model, Tied):
            ties, place = model.ties, model.ties.names.index(of)
            self.centre = float(ties.values(at.theta[None])[0, place])
            self.gradient = ties.value_slopes(at.theta[None])[0, place]
            self.low, self.high = ties.limits.get(of, (-np.inf, np.inf))
            self.limited = of in ties.limits
            for p in reported_space(space).parameters:
                if p.name == of:
                    self.low, self.high = p.low, p.high
        else:
            raise ValueError(f"{of} is not a tied parameter of {problem.name}")
        self.error = self._error(at.independent)
        self.has_error = bool(np.isfinite(self.error) and self.error > 0)
        self._direction = _conditional_direction(at, self.gradient)
        low, high = space.bounds
        share = (space.encode(at.theta) - low) / (high - low)
        self.inside = space.decode(low + (high - low) * np.clip(share, INSIDE, 1 - INSIDE))
        self.thetas = {self.centre: at.theta}

    def _error(self, at: Linearised) -> float:
        if self.position is not None:
            return float(at.standard_errors[self.position])
        return float(at.spread(self.gradient[None])[0])

    def widening(self, level: float) -> float:
        """The widening factor of a profile for dependent rows, for tau up to `at.quantile`."""
        if self.at.dependence is None:
            return 1.0
        quantile = float(self.at.quantiles(self.gradient[None], level)[0])
        return quantile / self.at.quantile(level) * (self._error(self.at) / self.error)

    def nearest(self, value: float) -> tuple[Array, Array]:
        """Parameters (d,) of the nearest refit, moved along the linearised model and unmoved."""
        point = min(self.thetas, key=lambda known: abs(known - value))
        theta = self.thetas[point]
        return theta + self._direction * (value - point), theta.copy()


class _SignedRoot:
    """tau as a function of the value of the parameter, by refits with the parameter fixed there.

    A refit starts from each of the `branches`, the best optimum first, and the best refit counts.
    `sized` is the first branch with a standard error. `points` maps previous values to tau. The
    magnitude of tau is limited, and has this limit if no refit has finite residuals. `best` is the
    refit with the smallest sum of squares.
    """

    def __init__(
        self,
        problem: CurveFit,
        optima: Sequence[Linearised],
        of: int | str,
        level: float,
        deadline: Deadline,
    ) -> None:
        at = optima[0]
        self.branches = [_Branch(problem, each, of) for each in optima]
        first = self.branches[0]
        self._problem, self._of, self._deadline = problem, of, deadline
        self._largest = WALL * at.quantile(level)
        self._cost = float(np.sum(problem.residuals(at.theta) ** 2))
        variance = error_variance(problem, at)
        self.sized = next(filter(lambda branch: branch.has_error, self.branches), first)
        self._unit = variance * self.sized.widening(level) ** 2
        self._weight = PINNED * float(np.sqrt(variance) / self.sized.error)
        # A refit would waste many steps along directions that the data do not determine.
        self._fixed = {*_superfluous(at), *([of] if isinstance(of, int) else [])}
        self.centre = first.centre
        self.points = {self.centre: 0.0}
        self.best = Refit(at.theta, self._cost)

    def __call__(self, value: float) -> float:
        """The signed root at a value of the parameter; raises OutOfTimeError after the deadline."""
        if value not in self.points:
            fits = [self._on(branch, value) for branch in self.branches]
            fit = min(fits, key=lambda refit: refit.cost)
            self._deadline.check()
            self.best = min(self.best, fit, key=lambda refit: refit.cost)
            root = float(np.sqrt(max(fit.cost - self._cost, 0.0) / self._unit))
            root = min(root, self._largest)
            self.points[value] = root if value > self.centre else -root
        return self.points[value]

    def _on(self, branch: _Branch, value: float) -> Refit:
        """The refit at a value, from the nearest refit of a branch."""
        moved, unmoved = branch.nearest(value)
        fit = self._refit(moved, value)
        if not np.isfinite(fit.cost):  # the guess has no finite residuals
            fit = self._refit(unmoved, value)
        at_bound = branch.at.at_bound
        if at_bound.any():  # a descent hardly leaves a bound at which it starts
            inside = self._refit(np.where(at_bound, branch.inside, fit.theta), value)
            fit = min(fit, inside, key=lambda refit: refit.cost)
        branch.thetas[value] = fit.theta
        return fit

    def _refit(self, guess: Array, value: float) -> Refit:
        pin, model = None, self._problem.model
        if isinstance(self._of, int):
            guess[self._of] = value
        elif isinstance(model, Tied):
            pin = Pin(model.ties, self._of, value, self._weight)
        return refit(
            self._problem, guess, fixed=self._fixed, tolerance=1e-8, deadline=self._deadline,
            pin=pin,
        )  # fmt: skip


def _end(
    tau: _SignedRoot, sign: int, bound: float, quantile: float, step: float, inside: float
) -> float:
    """The value at which |tau| reaches the quantile on one side; infinite if it is outside the box.

    `sign` is -1 for the lower end and 1 for the upper one, `bound` the bound of the box there,
    `inside` a value that is not beyond the end, and `step` the distance from it at which a linear
    model would reach the quantile.
    """
    centre = tau.centre
    if inside + step == inside:  # the interval is narrower than rounding
        return inside

    # Outwards to a point beyond the end.
    for _ in range(EXPANSIONS):
        outside = sign * min(sign * (inside + sign * step), sign * bound)
        if abs(tau(outside)) >= quantile - CLOSE:
            break
        if outside == bound:
            return sign * np.inf
        # A step slightly larger than a straight line from the centre would need.
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


def _superfluous(at: Linearised) -> list[int]:
    """A parameter per null direction: with these fixed, the data determine all others."""
    if not len(at.null_directions):
        return []
    pivots = scipy.linalg.qr(at.null_directions, mode="r", pivoting=True)[1]
    return [int(k) for k in pivots[: len(at.null_directions)]]


def _conditional_direction(at: Linearised, gradient: Array) -> Array:
    """Change of the parameters (d,) per unit of the quantity, in the linearised model."""
    column = at.independent.covariance @ gradient
    variance = gradient @ column
    return np.asarray(column / variance) if variance > 0 else np.zeros_like(column)
