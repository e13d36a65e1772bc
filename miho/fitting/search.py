"""The search of a problem, and the descent to the optimum that it has found."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

from miho.fitting.confirmed import by_calls, check_repeats, compared_at
from miho.fitting.dear_fit import interrupted, pace_line, spread, title
from miho.fitting.fit_result import Fit
from miho.fitting.named import check_budget, method_of
from miho.identification.alternatives import optima_within_noise
from miho.identification.curve_fit import CurveFit
from miho.identification.refit import Refit, refit
from miho.optim import (
    MIHOGN,
    Budget,
    Minimum,
    Optimizer,
    Outcome,
    RunRecord,
    minimize,
)
from miho.optim.usable_values import NOT_FINITE
from miho.parallel import Evaluations

DEFAULT = MIHOGN()


def searched(
    problem: CurveFit,
    method: Optimizer | str | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    evaluations: Evaluations | None = None,
) -> Fit:
    """The optimum of a problem, by `MIHOGN()` unless another method is given.

    `evaluations` make those of search and descent. Raises KeyboardInterrupt after a Ctrl-C.
    """
    method = DEFAULT if method is None else method_of(method)
    check_budget(budget)
    budget = budget or Budget()
    called = by_calls(problem, compared_at(problem), evaluations)
    if called is not None:
        problem, evaluations = called, None
    run = minimize(
        method, problem, budget, seed,
        workers=evaluations, observer=pace_line(problem, method, budget),
    )  # fmt: skip
    if run.outcome is Outcome.INTERRUPTED:
        raise interrupted(run)
    name = title(problem)
    # A small budget may end before any look at all rows of the data.
    theta = run.provisional if run.theta is None else run.theta
    if theta is None and not run.rejected and run.error is None:
        raise ValueError(f"{name}: the budget ended before the first value; give a larger one")
    if theta is None:
        raise ValueError(f"{name}: no finite value was found: {run.error or run.rejected}")
    raised = {why: n for why, n in run.rejected.items() if not why.startswith(NOT_FINITE)}
    if raised:
        why = "; ".join(f"{n:,} x {reason}" for reason, n in raised.items())
        sys.stderr.write(f"miho: {name}: evaluations without a value: {why}\n")
    if run.error is not None:
        reason = run.error.strip().splitlines()[-1]
        sys.stderr.write(f"miho: {name}: its best is taken, the search failed: {reason}\n")
    descent = refit(spread(problem, evaluations), theta)
    if not math.isfinite(descent.cost):  # as it may be on rows that the search did not look at
        raise ValueError(f"{name}: no finite value was found on all rows; give a larger budget")
    called = by_calls(problem, descent.theta[None], evaluations)
    if called is not None:
        left = _left(budget, run)
        if left is not None:
            return searched(called, method, left, seed)
        problem, descent = called, refit(called, descent.theta)
        if not math.isfinite(descent.cost):
            raise ValueError(f"{name}: no finite value was found; give a larger budget")
        return Fit(problem, descent.theta, descent.theta, moving=descent.moving)
    check_repeats(problem, descent.theta, descent.cost, evaluations)
    fit = Fit(problem, descent.theta, theta, run.descents, moving=descent.moving)
    return _with_others(fit, descent, evaluations)


def _with_others(fit: Fit, optimum: Refit, evaluations: Evaluations | None) -> Fit:
    """The fit at the best of its optima; its descents keep those within the noise to all digits.

    So nothing has to be descended to again, where an evaluation may take long.
    """
    if fit.descents is None:
        return fit
    minima = fit.descents.minima
    problem = spread(fit.problem, evaluations)
    optima = optima_within_noise(problem, optimum, minima, fit.level)
    if len(optima) == 1:
        return fit
    count = problem.residual_count
    exact = tuple(Minimum(each.cost / count, tuple(map(float, each.theta))) for each in optima)
    descents = replace(fit.descents, minima=(*exact, *minima))
    return replace(fit, theta=optima[0].theta, descents=descents, moving=optima[0].moving)


def _left(budget: Budget, run: RunRecord) -> Budget | None:
    """What a run has left of its budget; None if that is less than it has spent."""
    evaluations, seconds = budget.evaluations, budget.seconds
    if evaluations is not None:
        evaluations -= math.ceil(run.evaluations)
    if seconds is not None:
        seconds -= run.seconds
    few = evaluations is not None and evaluations < run.evaluations
    late = seconds is not None and seconds < run.seconds
    return None if few or late else replace(budget, evaluations=evaluations, seconds=seconds)
