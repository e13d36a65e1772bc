"""The checks that every optimizer must pass, unless it declares a failure with a reason."""

from __future__ import annotations

import contextlib
import math
import pickle
import random
from collections.abc import Callable, Mapping

import numpy as np

from miho.optim import (
    AskTell,
    Budget,
    BudgetExhausted,
    Optimizer,
    Oracle,
    Outcome,
    Resumable,
    RunRecord,
    Trace,
    minimize,
)
from miho.optim.minimize import raised_at
from miho.optim.seeds import stream
from miho.quantities import Array
from miho.testing.decay_fit import DecayFit, NoEvaluation, patience
from miho.testing.models import ConformanceError, require

BUDGET = 20_000
"""Default evaluations per run: more than the first batch of any method."""
RELATIVE = 1e-9
"""Largest relative difference of a loss that is summed in another order."""


def check_optimizer(
    optimizer: Optimizer,
    expected_failures: Mapping[str, str] | None = None,
    evaluations: int = BUDGET,
) -> None:
    """Run every check on one optimizer.

    Parameters
    ----------
    optimizer : Optimizer
        The method.
    expected_failures : mapping of str to str, optional
        Checks that the method fails by design, with the reasons.
    evaluations : int
        Largest budget of a run.

    Raises
    ------
    ConformanceError
        At the first check that fails, or that passes despite a declared failure.
    """
    for name in CHECKS:
        run_check(name, optimizer, expected_failures or {}, evaluations)


def run_check(
    name: str, optimizer: Optimizer, expected_failures: Mapping[str, str], evaluations: int = BUDGET
) -> None:
    """Run one check; it must fail if and only if `expected_failures` has a reason for it.

    Parameters
    ----------
    name : str
        The check, a key of `CHECKS`.
    optimizer : Optimizer
        The method.
    expected_failures : mapping of str to str
        Checks that the method fails by design, with the reasons.
    evaluations : int
        Largest budget of a run; it should exceed the method's start-up phase.

    Raises
    ------
    ConformanceError
        If the result is not the expected one.
    """
    expected = expected_failures.get(name)
    method = type(optimizer).__name__
    try:
        with patience():
            CHECKS[name](optimizer, evaluations)
    except (Exception, NoEvaluation) as error:
        if expected is None:
            message = str(error)
            if not isinstance(error, ConformanceError):
                message = f"{type(error).__name__}: {error} ({raised_at(error, optimizer)})"
            raise ConformanceError(f"{method} fails {name}: {message}") from error
    else:
        if expected is not None:
            raise ConformanceError(f"{method} passes {name}; remove the declared failure")


def _run_observed(optimizer: Optimizer, evaluations: int) -> tuple[Oracle, DecayFit]:
    """The oracle and the problem, which records evaluations, after one run."""
    problem = DecayFit()
    space = problem.space.seeded(problem.name, 3)
    oracle = Oracle(problem, Budget(evaluations=evaluations), space=space)
    with contextlib.suppress(BudgetExhausted):
        optimizer.run(oracle, stream("conformance"))
    return oracle, problem


def _outcome(record: RunRecord) -> str:
    """The outcome of a run, with the error that ended it."""
    error = f": {record.error.strip().splitlines()[-1]}" if record.error else ""
    return f"the outcome is {record.outcome}{error}"


def _same(a: Trace, b: Trace) -> bool:
    """Return whether two traces are equal except for their seconds."""
    return (
        a.evaluations == b.evaluations
        and a.loss == b.loss
        and np.array_equal(np.array(a.theta), np.array(b.theta))
    )


def is_a_frozen_dataclass(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """Settings are a frozen dataclass: comparable, picklable, safe to share between runs."""
    settings = getattr(type(optimizer), "__dataclass_params__", None)
    require(settings is not None and settings.frozen, "it is not a frozen dataclass")
    require(pickle.loads(pickle.dumps(optimizer)) == optimizer, "it does not pickle to itself")


def keeps_the_budget_exactly(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """Every evaluation goes through the oracle, and the budget is never exceeded."""
    for budget in (*(n for n in (1, 2, 7, 400) if n < evaluations), evaluations):
        oracle, problem = _run_observed(optimizer, budget)
        require(
            oracle.evaluations == problem.spent <= budget,
            f"budget {budget}: oracle counted {oracle.evaluations}, problem {problem.spent}",
        )


def records_every_improvement(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """The trace contains exactly the running minima of all losses, in order."""
    oracle, problem = _run_observed(optimizer, evaluations)
    minima = np.minimum.accumulate(problem.losses)
    improvements = np.unique(minima[np.isfinite(minima)])[::-1]
    trace = oracle.trace
    require(trace.loss == improvements.tolist(), "the trace is not the running minimum")
    for column in (trace.evaluations, trace.seconds, trace.cpu_seconds):
        require(bool((np.diff(column) >= 0).all()), "a column of the trace decreases")


def ends_descents_at_losses_it_has_seen(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """No descent ends below the best evaluated loss, because a search may stop by these ends."""
    oracle, _ = _run_observed(optimizer, evaluations)
    least = min(oracle.meter.starts.ends, default=math.inf)
    require(
        least >= oracle.best * (1 - RELATIVE),
        f"a descent ended at a loss of {least}; the best of the run is {oracle.best}",
    )


def starts_at_the_common_start(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """The first evaluated configuration is the first common initial configuration."""
    oracle, problem = _run_observed(optimizer, 1)
    start = oracle.space.decode(oracle.space.initial(1))[0]
    require(np.array_equal(problem.thetas[0], start), f"{problem.thetas[0]} is not {start}")


def stays_in_the_box(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """Every evaluated configuration is within the space's bounds."""
    _, problem = _run_observed(optimizer, evaluations)
    outside = np.array(problem.thetas)[~problem.space.contains(np.array(problem.thetas))]
    require(not outside.size, f"{len(outside)} configurations outside, for example {outside[:1]}")


def repeats_with_the_same_seed(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """The same seed gives the same trace except for the seconds; another seed gives another run."""
    budget = Budget(evaluations=evaluations)
    first, second = (minimize(optimizer, DecayFit(), budget, seed=3) for _ in range(2))
    reseeded = minimize(optimizer, DecayFit(), budget, seed=4)
    require(_same(first.trace, second.trace), "two runs with one seed differ")
    require(not _same(first.trace, reseeded.trace), "runs with different seeds are the same")


def uses_no_global_randomness(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """NumPy's and Python's global generators are not used."""
    before = random.getstate(), str(np.random.get_state())  # noqa: NPY002
    minimize(optimizer, DecayFit(), Budget(evaluations=evaluations))
    after = random.getstate(), str(np.random.get_state())  # noqa: NPY002
    require(before == after, "it drew from a global generator")


def survives_unusable_values(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """NaN, infinities and exceptions never end a run as failed, and never become best."""

    def half_nan(thetas: Array, losses: Array) -> Array:
        return np.where(thetas[:, 0] < 0.5, np.nan, losses)

    def minus_infinity(thetas: Array, losses: Array) -> Array:
        return np.where(thetas[:, 1] > 2.0, -np.inf, losses)

    def raises(thetas: Array, losses: Array) -> Array:
        if (thetas[:, 0] < 0).any():
            raise ArithmeticError("below zero")
        return losses

    for spoil in (half_nan, minus_infinity, raises):
        record = minimize(optimizer, DecayFit(spoil), Budget(evaluations=evaluations), seed=3)
        require(record.outcome is not Outcome.FAILED, f"{spoil.__name__}: {record.error}")
        if record.theta is not None:
            clean = DecayFit().loss(record.theta[None])[0]
            require(record.loss == clean, f"{spoil.__name__}: best is {record.loss}, not {clean}")


def says_when_nothing_is_finite(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """A run without finite values has that outcome, with reasons."""
    problem = DecayFit(lambda thetas, losses: np.full(len(thetas), np.nan))
    record = minimize(optimizer, problem, Budget(evaluations=evaluations))
    require(record.outcome is Outcome.NO_FINITE_VALUE, _outcome(record))
    require(record.theta is None and math.isinf(record.loss), "it claims a best configuration")
    require(bool(record.rejected), "no reason was recorded")


def stops_at_the_target(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """A run ends at the first evaluation that reaches the target."""
    free = minimize(optimizer, DecayFit(), Budget(evaluations=evaluations), seed=3)
    middle = len(free.trace) // 2
    target = free.trace.loss[middle]
    record = minimize(optimizer, DecayFit(), Budget(evaluations=evaluations, target=target), seed=3)
    require(record.outcome is Outcome.BUDGET, _outcome(record))
    require(
        record.loss <= target
        and record.trace.evaluations[middle] == free.trace.evaluations[middle],
        f"it reached {record.loss}, not {target}",
    )


def resumes_bit_exactly(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """A Resumable run that is cut anywhere, pickled and resumed equals an uncut run."""
    if not isinstance(optimizer, Resumable):
        return
    whole = minimize(optimizer, DecayFit(), Budget(evaluations=evaluations), seed=3)
    cut: RunRecord | None = None
    cuts = (n for n in (1, 5, 57, 58, 2_911, 15_700, 15_701, 18_211) if n < evaluations)
    for n in (*cuts, evaluations):
        checkpoint = None if cut is None else pickle.loads(pickle.dumps(cut.checkpoint))
        budget = Budget(evaluations=n)
        cut = minimize(optimizer, DecayFit(), budget, seed=3, checkpoint=checkpoint)
    require(cut is not None and _same(cut.trace, whole.trace), "the resumed run differs")


def asks_without_side_effects(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """`ask` only reads the state: called twice, an AskTell method gives the same batch."""
    if not isinstance(optimizer, AskTell):
        return
    problem = DecayFit()
    state = optimizer.init(problem.space, stream("conformance"))
    for _ in range(5):
        if optimizer.done(state):
            return
        first, second = optimizer.ask(state).copy(), optimizer.ask(state)
        require(np.array_equal(first, second), "two calls of ask gave different batches")
        optimizer.tell(state, second, problem.loss(second))
        require(np.array_equal(first, second), "tell changed the batch it was given")


CHECKS: dict[str, Callable[[Optimizer, int], None]] = {
    check.__name__: check
    for check in (
        is_a_frozen_dataclass,
        keeps_the_budget_exactly,
        records_every_improvement,
        ends_descents_at_losses_it_has_seen,
        starts_at_the_common_start,
        stays_in_the_box,
        repeats_with_the_same_seed,
        uses_no_global_randomness,
        survives_unusable_values,
        says_when_nothing_is_finite,
        stops_at_the_target,
        resumes_bit_exactly,
        asks_without_side_effects,
    )
}
"""Checks by name; each takes an optimizer and a number of evaluations."""
