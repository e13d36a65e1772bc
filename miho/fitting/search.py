"""The search of a problem: by the machine, or in NumPy first and compiled if it takes long."""

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

NUMPY_SECONDS, PER_EVALUATION, PER_ROW = 2.0, 3e-4, 3e-6
"""Estimated seconds: limit for all searches of one formula in NumPy, one evaluation in NumPy, and
each of its rows in addition."""
numpy_seconds: defaultdict[object, float] = defaultdict(float)
"""The estimated seconds that the searches of each formula have taken in this process."""


def searched(
    problem: CurveFit,
    method: Optimizer | str | None = None,
    budget: Budget | None = None,
    seed: int = 0,
    evaluations: Evaluations | None = None,
) -> Fit:
    """The optimum of a problem, by `MIHOGN()` unless another method is given.

    `evaluations`, if given, evaluates search and descent. Raises KeyboardInterrupt after a Ctrl-C,
    and ValueError if no finite value was found.
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
    # A small budget may end before an evaluation on all rows.
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
    if not math.isfinite(descent.cost):  # the search may have used a part of the rows
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
    """The fit at the best of its optima, with exact minima for all optima within the noise.

    A report then repeats no descents, whose evaluations may be expensive.
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


def _run(
    problem: CurveFit,
    method: Optimizer,
    budget: Budget,
    seed: int,
    evaluations: Evaluations | None,
) -> tuple[CurveFit, RunRecord]:
    """Search a problem, and compile its formula only if that is needed and the search takes long.

    The machine searches a formula at once. Without the machine, the search starts in NumPy, and
    after about NUMPY_SECONDS the compiled problem continues from the same state. The time is
    estimated from the number of evaluations, so the result does not depend on the processor. All
    searches of one formula in this process share it.
    """

    def run(
        problem: CurveFit, budget: Budget, checkpoint: Checkpoint | None = None
    ) -> tuple[CurveFit, RunRecord]:
        return problem, minimize(
            method, problem, budget, seed, checkpoint=checkpoint, rehearse=False,
            workers=evaluations, observer=pace_line(problem, method, budget),
        )  # fmt: skip

    checkpoint = None
    model = problem.model
    by_machine = problem.kernel is not None and problem.kernel.taped is not None
    undecided = problem.compiled is None and isinstance(method, MIHOGN) and not by_machine
    if undecided and isinstance(model, Expression):
        formula = getattr(model.value, "__code__", type(model))
        seconds = PER_EVALUATION + PER_ROW * problem.residual_count
        most = int((NUMPY_SECONDS - numpy_seconds[formula]) / seconds)
        limits = most if budget.evaluations is None else min(most, budget.evaluations)
        if most > 0:
            plain = replace(problem, compiled=False, dear=True)
            plain, first = run(plain, replace(budget, evaluations=limits))
            numpy_seconds[formula] += first.evaluations * seconds
            if _ended(first, budget) or limits == budget.evaluations:
                return plain, first
            checkpoint = first.checkpoint
        problem = replace(problem, compiled=True, dear=True)
    if problem.kernel is not None and machine() is None:
        _say_that_formulas_are_compiled()
    if problem.kernel is not None and method.uncompiled:
        sys.stderr.write(
            "miho: compiling the search, once on this machine, for about half a minute "
            "(compiled=False does without)\n"
        )
    return run(problem, budget, checkpoint)


def _left(budget: Budget, run: RunRecord) -> Budget | None:
    """The rest of the budget after a run; None if the run used more than is left."""
    evaluations, seconds = budget.evaluations, budget.seconds
    if evaluations is not None:
        evaluations -= math.ceil(run.evaluations)
    if seconds is not None:
        seconds -= run.seconds
    few = evaluations is not None and evaluations < run.evaluations
    late = seconds is not None and seconds < run.seconds
    return None if few or late else replace(budget, evaluations=evaluations, seconds=seconds)


@cache
def _say_that_formulas_are_compiled() -> None:
    """Write once per process that compiling each formula takes seconds."""
    sys.stderr.write(
        "miho: compiling each formula takes some seconds, as the library was installed without a "
        "C compiler\n"
    )


def _ended(run: RunRecord, budget: Budget) -> bool:
    """Whether a run ended for another reason than the number of its evaluations."""
    if run.outcome not in (Outcome.BUDGET, Outcome.NO_FINITE_VALUE) or run.checkpoint is None:
        return True
    late = budget.seconds is not None and run.seconds >= budget.seconds
    return late or (budget.target is not None and run.loss <= budget.target)
