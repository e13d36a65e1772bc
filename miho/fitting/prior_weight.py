"""The weight of priors if the standard deviation of the errors is unknown."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from miho.fitting.fit_result import Fit
from miho.fitting.search import spread
from miho.identification.refit import refit
from miho.identification.uncertainty import linearised
from miho.optim import Space

if TYPE_CHECKING:
    from miho.parallel import Evaluations

SETTLED, ROUNDS = 1e-6, 100
"""The estimate of the error's standard deviation has converged if it changes by less than this
share; `settled` makes at most this number of rounds."""


def settled(
    bounds: Space,
    solved: Callable[[Space, float | None], Fit],
    evaluations: Evaluations | None = None,
) -> Fit:
    """Fit with priors whose weight depends on the unknown standard deviation of the errors.

    `solved` fits within bounds, given the standard deviation that weighs the priors. The first
    estimate comes from a fit without priors [1]_, later ones from the residuals of the fit, with
    the degrees of freedom of `linearised`. Raises ValueError if they do not converge in ROUNDS
    rounds.

    References
    ----------
    .. [1] H. Theil, A. S. Goldberger, International Economic Review 2 (1961) 65-78.
    """

    def noise(fit: Fit) -> float:
        at = linearised(spread(fit.problem, evaluations), fit.theta)
        return max(at.noise, math.sqrt(fit.problem.rounding))

    fit = solved(bounds, noise(solved(bounds.without_priors, None)))
    for _ in range(ROUNDS):
        scale = noise(fit)
        before = fit.problem.prior_scale or scale
        if abs(scale - before) <= SETTLED * before:
            return replace(fit, run=fit.theta) if fit.descents is None else solved(bounds, scale)
        problem = replace(fit.problem, prior_scale=scale, expensive=True)
        descent = refit(spread(problem, evaluations), fit.theta)
        fit = replace(fit, problem=problem, theta=descent.theta, moving=descent.moving)
    raise ValueError("sigma: its estimate and the weight of the priors do not converge; give sigma")
