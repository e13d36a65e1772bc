"""Intervals by profile likelihood: how far a parameter can go while the others make up for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize.elementwise import find_root

from miho.identification.curve_fit import CurveFit
from miho.identification.refit import refit
from miho.identification.uncertainty import Linearised

Array = NDArray[np.float64]

EXPANSIONS = 20
"""Steps outwards at most until an interval's end lies behind."""
CLOSE = 0.005
"""An end is found when the signed root is within this of the wanted quantile."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one parameter: (values, tau), ordered by value, and the interval's ends.

    tau is the signed root of the likelihood ratio, in the units of Student's t: a straight line
    for a linear model, so its bend shows how far the linearised interval is off. An end is
    infinite if the box was reached first: the data do not bound the parameter on that side.
    """

    values: Array
    tau: Array
    low: float
    high: float


def profile(problem: CurveFit, at: Linearised, index: int, level: float = 0.95) -> Profile:
    """Profile of the parameter at position `index` (Bates and Watts 1988, Ch. 6.1.2).

    The interval holds the values v for which the smallest sum of squares with the parameter fixed
    at v exceeds the smallest of all by less than F(1, freedom) allows. Every refit starts where
    the linearised model expects its optimum.
    """
    theta, wanted = at.theta, at.quantile(level)
    cost = float(np.sum(problem.residuals(theta) ** 2))
    psi, stiffness = problem.rho.influence(problem.errors(theta))
    unit = float(psi @ psi / at.freedom / stiffness.mean())  # cost / freedom for the square
    direction = _conditional_direction(at, index)
    centre = float(theta[index])
    known = {centre: (0.0, theta)}

    def tau(value: float) -> float:
        if value not in known:
            nearest = known[min(known, key=lambda other: abs(other - value))][1]
            guess = nearest + direction * (value - nearest[index])
            guess[index] = value
            found = refit(problem, guess, fixed=(index,), tolerance=1e-8)
            root = float(np.sqrt(max(found.cost - cost, 0.0) / unit))
            known[value] = (root if value > centre else -root, found.theta)
        return known[value][0]

    def end(sign: int, bound: float) -> float:
        """Where |tau| reaches the quantile; infinite if it does not within the box."""
        inside, step = centre, wanted * float(at.standard_errors[index])
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
        if abs(tau(outside)) <= wanted + CLOSE:
            return outside
        solution = find_root(
            np.vectorize(lambda value: abs(tau(float(value))) - wanted),
            (inside, outside),
            tolerances={"fatol": CLOSE},
        )
        return float(solution.x)

    low, high = (end(-1, problem.space.low[index]), end(1, problem.space.high[index]))
    values = np.array(sorted(known))
    return Profile(values, np.array([known[value][0] for value in values]), low, high)


def _conditional_direction(at: Linearised, index: int) -> Array:
    """How the other parameters follow when one moves by 1, in the linearised model, (d,)."""
    column = at.covariance[:, index]
    return column / column[index] if column[index] > 0 else np.zeros_like(column)
