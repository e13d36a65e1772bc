"""Global search of a problem, and checks that it evaluates the function of the user correctly.

A search may replace calls with numbers by a traced formula, or by calls with arrays of parameters.
Some configurations before the search, and the optimum after it, must give the same values.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from miho.fitting.fit_result import Fit
from miho.identification.curve_fit import CurveFit
from miho.identification.refit import Refit, refit
from miho.models.function_model import FunctionFormula, alike
from miho.models.model import Model, expensive_leaves
from miho.optim import MIHOGN, Budget, Minimum, Optimizer, Oracle, Outcome, RunRecord, minimize
from miho.optim.trace import in_place
from miho.optim.usable_values import NOT_FINITE
from miho.parallel.worth import is_expensive
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.parallel import Evaluations

DEFAULT = MIHOGN()
QUIET = 1.0
"""Seconds of a search without any output."""
CONFIGURATIONS, VALUES = 30, 1_000_000
"""Largest numbers of configurations, and of their values, that are compared before a search."""
REPEATED = 1e-9
"""The errors of two calls differ if the difference exceeds this share of the norm of the output."""


def searched(
    problem: CurveFit,
    method: Optimizer | str | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    evaluations: Evaluations | None = None,
    hints: bool = True,
) -> Fit:
    """Fit a problem by a search, with `MIHOGN()` unless a method is given.

    `evaluations` runs the search and the descent on workers. With `hints`, messages name arguments
    of `miho.fit`. Raises KeyboardInterrupt after Ctrl-C, and ValueError if no finite value was
    found.
    """
    if not (method is None and budget is None):
        from miho.fitting.named import method_of

        method = method_of(method, budget)
    method, budget = method or DEFAULT, budget or Budget()
    called = by_calls(problem, compared_at(problem), evaluations)
    if called is not None:
        problem, evaluations = called, None
    run = minimize(
        method, problem, budget, seed,
        workers=evaluations, observer=_observer(problem, method, budget, hints),
    )  # fmt: skip
    if run.outcome is Outcome.INTERRUPTED:
        from miho.fitting.progress import interrupted

        raise interrupted(run, hints)
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
    descent = refit(spread(problem, evaluations), closed_form(problem, theta))
    if not math.isfinite(descent.cost):  # possible on rows that the search did not evaluate
        raise ValueError(
            f"{name}: no finite value was found on all rows; narrow the bounds or increase a budget"
        )
    called = by_calls(problem, descent.theta[None], evaluations)
    if called is not None:
        left = _left(budget, run)
        if left is not None:
            return searched(called, method, left, seed, hints=hints)
        problem, descent = called, refit(called, descent.theta)
        if not math.isfinite(descent.cost):
            raise ValueError(f"{name}: no finite value was found; increase the budget")
        return Fit(problem, descent.theta, descent.theta, moving=descent.moving)
    check_repeats(problem, descent.theta, descent.cost, evaluations)
    fit = Fit(problem, descent.theta, theta, run.descents, moving=descent.moving)
    return _with_others(fit, descent, evaluations)


def closed_form(problem: CurveFit, theta: Array) -> Array:
    """The optimum of a formula that is linear in all parameters, or `theta` if it is no worse."""
    if set(problem.linear) != set(problem.space.names) or expensive_leaves(problem.model):
        return theta
    from miho.identification.conclusion import linear_optimum

    optimum = linear_optimum(problem)
    if optimum is None or optimum[1] >= problem.loss(theta[None])[0]:
        return theta
    return optimum[0]


def _observer(
    problem: CurveFit, method: Optimizer, budget: Budget, hints: bool
) -> Callable[[Oracle], None]:
    """An observer that reports a long search on stderr."""
    began, lines = time.monotonic(), list[Callable[[Oracle], None]]()

    def observe(oracle: Oracle) -> None:
        if not lines and time.monotonic() - began >= QUIET:
            from miho.fitting.progress import pace_line

            lines.append(pace_line(problem, method, budget, began, hints))
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
    from miho.identification.alternatives import optima_within_noise

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


def by_calls(
    problem: CurveFit, thetas: Array, evaluations: Evaluations | None = None
) -> CurveFit | None:
    """The problem with functions called with numbers, if that gives other values; else None.

    Values at parameter rows (n, d) are compared; at the first row only for a slow function. The
    result is None too if evaluations may not be repeated.
    """
    called = problem.model.with_numbers()
    if called is problem.model or _is_final(problem, evaluations):
        return None
    model, inputs = problem.model, problem.inputs

    def agree() -> bool:
        started = time.perf_counter()
        same = _same(model, called, thetas[:1], inputs)
        if same and len(thetas) > 1 and not is_expensive(time.perf_counter() - started):
            same = _same(model, called, thetas[1:], inputs)
        return same

    formula = model if isinstance(model, FunctionFormula) and len(thetas) > 1 else None
    if agree() if formula is None else formula.passed("agrees", agree, thetas, *inputs):
        return None
    sys.stderr.write(
        f"miho: {problem.name}: the function gives other values for numbers than for arrays, so it "
        "is called with numbers, one configuration at a time\n"
    )
    return replace(problem, model=called, expensive=True)


def compared_at(problem: CurveFit) -> Array:
    """Configurations (n, d) in the box for the comparison before a search."""
    count = min(CONFIGURATIONS, max(1, VALUES // max(1, len(problem.dataset))))
    return problem.space.decode(problem.space.initial(count))


def check_repeats(
    problem: CurveFit, theta: Array, cost: float, evaluations: Evaluations | None = None
) -> None:
    """Warn if a second call of the function at `theta` (d,) gives another sum of squares."""
    if not expensive_leaves(problem.model) or _is_final(problem, evaluations):
        return
    try:
        again = float(np.sum(problem.residuals(theta) ** 2))
    except ValueError:
        again = math.inf
    size = float(np.linalg.norm(problem.dataset[problem.dataset.output]))
    if abs(math.sqrt(again) - math.sqrt(cost)) > REPEATED * max(size, math.sqrt(cost)):
        first, second = (math.sqrt(value / problem.residual_count) for value in (cost, again))
        warnings.warn(
            f"{problem.name}: two calls with the same parameters give the errors {first:.6g} and "
            f"{second:.6g} {problem.unit}".rstrip()
            + "; a model with random numbers or an internal state has no optimum: reset them in "
            "each call",
            UserWarning,
            stacklevel=5,
        )


def _is_final(problem: CurveFit, evaluations: Evaluations | None) -> bool:
    """Whether evaluations may not be repeated: a journal records them, or they may hang."""
    return (
        evaluations is not None
        and not evaluations.may_repeat
        and bool(expensive_leaves(problem.model))
    )


def _same(model: Model, called: Model, thetas: Array, inputs: tuple[Array, ...]) -> bool:
    """Whether two models agree at parameter rows (n, d); rows that make `called` raise agree."""
    try:
        first, second = (each.predict(thetas, *inputs) for each in (model, called))
    except ValueError:
        if len(thetas) > 1:
            return all(_same(model, called, row[None], inputs) for row in thetas)
        return _raises(called, thetas, inputs)
    if np.array_equal(first, second):
        return True
    # Rows are compared on separate scales; numbers that are not finite have no value.
    finite = [np.where(np.isfinite(values), values, np.nan) for values in (first, second)]
    size = np.nan_to_num(np.abs(finite[0])).max(axis=1, keepdims=True, initial=0.0)
    size[size == 0] = 1.0
    return alike(finite[0] / size, finite[1] / size)


def _raises(model: Model, thetas: Array, inputs: tuple[Array, ...]) -> bool:
    try:
        model.predict(thetas, *inputs)
    except ValueError:
        return True
    return False
