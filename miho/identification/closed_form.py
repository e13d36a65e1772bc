"""The exact optimum of a problem that is linear in all its parameters."""

from __future__ import annotations

from miho.identification.curve_fit import CurveFit
from miho.optim.linear_part import solve_linear_part
from miho.quantities import Array


def linear_optimum(problem: CurveFit) -> tuple[Array, float] | None:
    """Parameters (d,) and loss of the global optimum in the box, by linear algebra.

    It is that of ordinary least squares, and of bounded-variable least squares if the box does not
    hold that one. None if the problem is not linear in all its parameters.
    """
    space = problem.space
    if set(problem.linear) != set(space.names):
        return None
    start = (space.low + space.high) / 2
    optimum = solve_linear_part(problem.residuals, start, range(len(space)), space)
    if optimum is None:
        return None
    return optimum.theta, float(problem.loss(optimum.theta[None])[0])
