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
"""Where the residuals are not finite, the signed root is this many times the wanted quantile."""
HALVINGS = 30
"""Steps at most between two ends of which one lies inside: enough for a jump."""
CLOSE = 0.005
"""An end is found when the signed root is within this of the wanted quantile."""


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


def profile(
    problem: CurveFit,
    at: Linearised,
    index: int,
    level: float = 0.95,
    deadline: Deadline | None = None,
) -> Profile:
    """Profile of the parameter at position `index` (Bates and Watts 1988, Ch. 6.1.2).

    The interval holds the values v for which the smallest sum of squares with the parameter fixed
    at v exceeds the smallest of all by less than F(1, freedom) allows. Every refit starts where
    the linearised model expects its optimum; where the residuals are not finite there is a wall.
    Raises OutOfTimeError after the deadline.
    """
    theta, wanted = at.theta, at.quantile(level)
    cost = float(np.sum(problem.residuals(theta) ** 2))
    psi, stiffness = problem.rho.influence(problem.errors(theta))
    unit = float(psi @ psi / at.freedom / stiffness.mean())  # cost / freedom for the square
    direction = _conditional_direction(at, index)
    centre = float(theta[index])
    # What only moves along directions that the data do not see would cost many steps, in vain.
    fixed = {index, *_superfluous(at)}
    known = {centre: (0.0, theta)}
    best = Refit(theta, cost)

    def tau(value: float) -> float:
        nonlocal best
        if value not in known:
            nearest = known[min(known, key=lambda other: abs(other - value))][1]
            guess = nearest + direction * (value - nearest[index])
            guess[index] = value
            end = refit(problem, guess, fixed=fixed, tolerance=1e-8, deadline=deadline)
            if not np.isfinite(
                end.cost
            ):  # the guess is behind a wall, which the known point is not
                guess = nearest.copy()
                guess[index] = value
                end = refit(problem, guess, fixed=fixed, tolerance=1e-8, deadline=deadline)
            if deadline is not None:
                deadline.check()
            best = min(best, end, key=lambda each: each.cost)
            root = min(float(np.sqrt(max(end.cost - cost, 0.0) / unit)), WALL * wanted)
            known[value] = (root if value > centre else -root, end.theta)
        return known[value][0]

    from scipy.optimize.elementwise import find_root

    def limit(sign: int, bound: float) -> float:
        """Where |tau| reaches the quantile; infinite if it does not within the box."""
        inside, step = centre, wanted * float(at.standard_errors[index])
        if centre + step == centre:  # known better than it can be written
            return centre
        for _ in range(EXPANSIONS):
            outside = sign * min(sign * (inside + sign * step), sign * bound)
            if abs(tau(outside)) >= wanted - CLOSE:
                break
            if outside == bound:
                return sign * np.inf
            # Outwards by what a straight line to here would need, and a little more.
            slope = abs(tau(outside)) / abs(outside - centre)
            lacking = 1.05 * (wanted - abs(tau(outside))) / slope if slope > 0 else np.inf
            inside, step = outside, min(lacking, 3 * step)
        else:
            return sign * np.inf
        if abs(tau(outside)) <= wanted + CLOSE:
            return outside
        solution = find_root(
            np.vectorize(lambda value: abs(tau(float(value))) - wanted),
            (inside, outside),
            tolerances={"fatol": CLOSE},
            maxiter=HALVINGS,
        )
        return float(solution.x)

    low, high = (limit(-1, problem.space.low[index]), limit(1, problem.space.high[index]))
    values = np.array(sorted(known))
    return Profile(values, np.array([known[value][0] for value in values]), low, high, best)


def _superfluous(at: Linearised) -> list[int]:
    """As many parameters as there are unseen directions, without which the others are seen."""
    if not len(at.unseen):
        return []
    pivots = scipy.linalg.qr(at.unseen, mode="r", pivoting=True)[1]
    return [int(k) for k in pivots[: len(at.unseen)]]


def _conditional_direction(at: Linearised, index: int) -> Array:
    """How the other parameters follow when one moves by 1, in the linearised model, (d,)."""
    column = at.covariance[:, index]
    return column / column[index] if column[index] > 0 else np.zeros_like(column)
