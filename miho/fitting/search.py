"""Global search of a problem, and the descent from its result to the optimum."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from miho.fitting.confirmed import by_calls, check_repeats, compared_at
from miho.fitting.fit_result import Fit
from miho.identification.curve_fit import CurveFit
from miho.identification.refit import Refit, refit
from miho.optim import (
    MIHOGN,
    Budget,
    Minimum,
    Optimizer,
    Oracle,
    Outcome,
    RunRecord,
    minimize,
)
from miho.optim.trace import in_place
from miho.optim.usable_values import NOT_FINITE

if TYPE_CHECKING:
    from miho.parallel import Evaluations

DEFAULT = MIHOGN()
QUIET = 1.0
"""Seconds of a search without any output."""


def searched(
    problem: CurveFit,
    method: Optimizer | str | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    evaluations: Evaluations | None = None,
) -> Fit:
    """Fit a problem by a search, with `MIHOGN()` unless a method is given.

    `evaluations` runs the search and the descent on workers. Raises KeyboardInterrupt after Ctrl-C,
    and ValueError if no finite value was found.
    """
    if not (method is None and budget is None):
        from miho.fitting.named import check_budget, method_of

        method = None if method is None else method_of(method)
        check_budget(budget)
    method, budget = method or DEFAULT, budget or Budget()
    called = by_calls(problem, compared_at(problem), evaluations)
    if called is not None:
        problem, evaluations = called, None
    run = minimize(
        method, problem, budget, seed,
        workers=evaluations, observer=_observer(problem, method, budget),
    )  # fmt: skip
    if run.outcome is Outcome.INTERRUPTED:
        from miho.fitting.progress import interrupted

        raise interrupted(run)
    name = title(problem)
    # A small budget may end before any look at all rows of the data.
    theta = run.provisional if run.theta is None else run.theta
    if theta is None and not run.rejected and run.error is None:
        raise ValueError(f"{name}: the budget ended before the first value; increase it")
    if theta is None:
        why = run.error or _counted(run.rejected)
        raise ValueError(f"{name}: no finite value was found: {why}")
    raised = {why: n for why, n in run.rejected.items() if not why.startswith(NOT_FINITE)}
    if raised:
        why = _counted(raised)
        sys.stderr.write(f"miho: {name}: evaluations without a value: {why}\n")
    if run.error is not None:
        reason = run.error.strip().splitlines()[-1]
        sys.stderr.write(f"miho: {name}: the search failed, its best is taken: {reason}\n")
    descent = refit(spread(problem, evaluations), theta)
    if not math.isfinite(descent.cost):  # possible on rows that the search did not evaluate
        raise ValueError(f"{name}: no finite value was found on all rows; increase the budget")
    called = by_calls(problem, descent.theta[None], evaluations)
    if called is not None:
        left = _left(budget, run)
        if left is not None:
            return searched(called, method, left, seed)
        problem, descent = called, refit(called, descent.theta)
        if not math.isfinite(descent.cost):
            raise ValueError(f"{name}: no finite value was found; increase the budget")
        return Fit(problem, descent.theta, descent.theta, moving=descent.moving)
    check_repeats(problem, descent.theta, descent.cost, evaluations)
    fit = Fit(problem, descent.theta, theta, run.descents, moving=descent.moving)
    return _with_others(fit, descent, evaluations)


def _observer(problem: CurveFit, method: Optimizer, budget: Budget) -> Callable[[Oracle], None]:
    """An observer that reports a long search on stderr."""
    began, lines = time.monotonic(), list[Callable[[Oracle], None]]()

    def observe(oracle: Oracle) -> None:
        if not lines and time.monotonic() - began >= QUIET:
            from miho.fitting.progress import pace_line

            lines.append(pace_line(problem, method, budget, began))
        for line in lines:
            line(oracle)

    return observe


def _counted(rejected: Mapping[str, int]) -> str:
    """The reasons for which evaluations have no value, each with its count."""
    return "; ".join(f"{n:,} x {reason}" for reason, n in rejected.items())


def _with_others(fit: Fit, optimum: Refit, evaluations: Evaluations | None) -> Fit:
    """Fit at the best of its optima, which its descents then store to all digits.

    Later steps do not have to descend to them again, which matters for expensive models.
    """
    if fit.descents is None:
        return fit
    minima = fit.descents.minima
    if all(in_place(each.theta, optimum.theta) for each in minima):
        return fit
    from miho.identification.within_noise import optima_within_noise

    problem = spread(fit.problem, evaluations)
    optima = optima_within_noise(problem, optimum, minima, fit.level)
    if len(optima) == 1:
        return fit
    count = problem.residual_count
    exact = tuple(Minimum(each.cost / count, tuple(map(float, each.theta))) for each in optima)
    descents = replace(fit.descents, minima=(*exact, *minima))
    return replace(fit, theta=optima[0].theta, descents=descents, moving=optima[0].moving)


def _left(budget: Budget, run: RunRecord) -> Budget | None:
    """Budget that a run has left; None if it is less than the run has used."""
    evaluations, seconds = budget.evaluations, budget.seconds
    if evaluations is not None:
        evaluations -= math.ceil(run.evaluations)
    if seconds is not None:
        seconds -= run.seconds
    few = evaluations is not None and evaluations < run.evaluations
    late = seconds is not None and seconds < run.seconds
    return None if few or late else replace(budget, evaluations=evaluations, seconds=seconds)


def spread(problem: CurveFit, evaluations: Evaluations | None) -> CurveFit:
    """The problem with its evaluations made by `evaluations`, if given."""
    return problem if evaluations is None else problem.spread(evaluations)


def title(problem: CurveFit) -> str:
    """The name of a problem in lines on stderr: the name of its model, "model" for a lambda."""
    name = problem.model.name or "model"
    return "model" if name == "<lambda>" else name
