"""The exact optimum of a problem that is linear in all its parameters."""

from __future__ import annotations

from miho.identification.curve_fit import CurveFit
from miho.optim.linear_part import solve_linear_part
from miho.quantities import Array


def linear_optimum(problem: CurveFit) -> tuple[Array, float] | None:
    """Solve a problem that is linear in all its parameters.

    Ordinary least squares gives the optimum, or bounded-variable least squares if the box does not
    contain it.

    Parameters
    ----------
    problem : CurveFit
        The problem.

    Returns
    -------
    tuple of (ndarray of shape (d,), float), or None
        The global optimum in the box, in the units of the parameters, and its loss, in the squared
        unit of the output. None if the problem is not linear in all its parameters.
    """
    space = problem.space
    if set(problem.linear) != set(space.names):
        return None
    start = (space.low + space.high) / 2
    optimum = solve_linear_part(problem.residuals, start, range(len(space)), space)
    if optimum is None:
        return None
    return optimum.theta, float(problem.loss(optimum.theta[None])[0])
