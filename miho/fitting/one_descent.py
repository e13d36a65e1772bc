"""A fit by one descent from a starting point."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from miho.fitting.fit_result import Fit
from miho.fitting.search import by_calls, check_repeats, closed_form, spread, title
from miho.identification.curve_fit import CurveFit
from miho.identification.refit import refit
from miho.parallel import Evaluations
from miho.quantities import Array


def descended(
    problem: CurveFit, start: Mapping[str, float], evaluations: Evaluations | None = None
) -> Fit:
    """Fit at the end of one descent from a start of every free parameter."""
    model = problem.model
    theta = np.array([float(start.get(name, 0.0)) for name in problem.space.names])
    if model.ties is not None:
        from miho.identification.constraints import free_values

        theta = free_values(problem.space, model.ties, start)
    rows = problem.machine_rows
    if rows is not None:
        from miho.optim.gauss_newton_descent import descended as descended_by_machine

        theta = _better(problem, descended_by_machine(rows, problem.space, theta), theta)
    descent = refit(spread(problem, evaluations), closed_form(problem, theta))
    if not math.isfinite(descent.cost):
        raise ValueError(f"{title(problem)}: the loss at the start is not finite; give another one")
    called = by_calls(problem, descent.theta[None], evaluations)
    if called is not None:
        return descended(called, start)
    check_repeats(problem, descent.theta, descent.cost, evaluations)
    return Fit(problem, descent.theta, descent.theta, moving=descent.moving)


def _better(problem: CurveFit, end: Array, start: Array) -> Array:
    """The end of a descent by the machine, or its start if the end is no better by NumPy.

    A formula may give other values for arrays than on the machine.
    """
    with np.errstate(all="ignore"):
        squares = (problem.residual_rows(np.array([end, start])) ** 2).sum(axis=1)
    return end if squares[0] <= squares[1] or math.isnan(squares[1]) else start
