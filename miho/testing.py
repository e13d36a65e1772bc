"""Conformance suite for optimizers, and a check of models: what all must do, whoever wrote them.

    from miho.testing import check_optimizer
    check_optimizer(MyMethod())

or, one test per check, parametrise over `CHECKS`. A method that cannot pass a check by design
declares it with a reason: `expected_failures={"stays_in_the_box": "clips lower bounds only"}`.
A declared failure that passes is an error too, so that declarations stay true. A method that takes
milliseconds per evaluation may be checked over fewer of them: `evaluations=300`. One that computes
for `PATIENCE` seconds without an evaluation fails the check that it is in; the seconds are its own
CPU's, so that a busy machine makes no difference. So does one that only waits for as long. That
needs the main thread and a POSIX system.
"""

from __future__ import annotations

import contextlib
import math
import pickle
import random
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from itertools import combinations_with_replacement
from types import FrameType

import numpy as np

from miho.models import Model
from miho.optim import (
    AskTell,
    Budget,
    BudgetExhausted,
    LeastSquaresProblem,
    Optimizer,
    Oracle,
    Outcome,
    Parameter,
    Resumable,
    RunRecord,
    Space,
    Trace,
    minimize,
)
from miho.optim.minimize import raised_at
from miho.optim.problem import mean_square
from miho.optim.seeds import stream
from miho.quantities import Array

BUDGET = 20_000
"""Evaluations per run unless told otherwise: beyond the first batch of any method in use."""


PATIENCE = 60.0
"""CPU seconds that a method may compute between two evaluations, and seconds that it may wait."""
RELATIVE = 1e-9
"""By which a loss that is summed in another order may differ."""
IDLE = 0.01
"""Who computes less than this fraction of the time waits: a busy machine gives more."""


class ConformanceError(AssertionError):
    """A check that failed: its name and what was seen."""


class NoEvaluation(BaseException):
    """Raised in a method that asks for nothing; no Exception, so that none takes it for its own."""


class DecayFit(LeastSquaresProblem):
    """Fit y = a exp(-b t): a on a linear, b on a log scale; remembers all it was asked.

    `thetas` and `losses` list every loss evaluation in order, with +inf for one at a fidelity below
    one, which cannot become best; `spent` adds the cost of residuals and Jacobians, and counts a
    fidelity as that fraction. All data are used at any fidelity. `spoil` may turn the losses of a
    batch into something else.
    """

    name = "conformance"
    space = Space(
        (
            Parameter("a", "V", -5.0, 5.0, sigma_max=0.5),
            Parameter("b", "1/s", 0.01, 10.0, scale="log", sigma_max=0.3),
        )
    )
    linear = ("a",)

    def __init__(self, spoil: Callable[[Array, Array], Array] | None = None) -> None:
        self.t = np.linspace(0.0, 2.0, 17)
        self.y = 2.0 * np.exp(-1.5 * self.t) + 0.05 * np.cos(40 * self.t)
        self.thetas: list[Array] = []
        self.losses: list[float] = []
        self.spent = 0.0
        self._spoil = spoil

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        """Mean squared residual (n,), spoilt if asked for."""
        losses = mean_square(thetas[:, :1] * np.exp(-thetas[:, 1:] * self.t) - self.y)
        if self._spoil is not None:
            losses = self._spoil(thetas, losses)
        self._remember(thetas, losses if fidelity == 1.0 else np.full(len(thetas), np.inf))
        self.spent += len(thetas) * fidelity
        return losses

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Model minus data, (17,)."""
        residuals = theta[0] * np.exp(-theta[1] * self.t) - self.y
        if self._spoil is not None and not np.isfinite(
            self._spoil(theta[None], mean_square(residuals)[None])
        ):
            residuals = np.full_like(residuals, np.nan)
        self._remember(theta[None], mean_square(residuals)[None])
        self.spent += 1
        return np.asarray(residuals)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        """Derivatives of the residuals, (17, 2)."""
        decay = np.exp(-theta[1] * self.t)
        self.spent += 2
        _be_patient()
        return np.stack([decay, -theta[0] * self.t * decay], axis=1)

    def _remember(self, thetas: Array, losses: Array) -> None:
        self.thetas.extend(thetas.copy())
        self.losses.extend(losses.tolist())
        _be_patient()


def check_optimizer(
    optimizer: Optimizer,
    expected_failures: Mapping[str, str] | None = None,
    evaluations: int = BUDGET,
) -> None:
    """Run every check on one optimizer; raises ConformanceError at the first that fails."""
    for name in CHECKS:
        run_check(name, optimizer, expected_failures or {}, evaluations)


def check_model(model: Model, thetas: Array, *inputs: Array) -> None:
    """Check a model at parameter rows (n, d) and input columns (N,).

    A row is the same in any batch, `jacobian` is the derivative of `predict`, by central
    differences to 1e-6 of each column's range, and the output is jointly linear in the parameters
    that `linear` names. Raises ConformanceError.
    """
    batch = model.predict(thetas, *inputs)
    for theta, row in zip(thetas, batch, strict=True):
        alone = model.predict(theta[None], *inputs)[0]
        _require(np.array_equal(alone, row), f"predict at {theta} depends on the batch")
        jacobian = model.jacobian(theta, *inputs)
        for k, name in enumerate(model.parameters):
            h = 1e-6 * max(abs(theta[k]), 1e-3) * (np.arange(theta.size) == k)
            ahead, behind = model.predict(np.stack([theta + h, theta - h]), *inputs)
            difference = (ahead - behind) / (2 * h[k])
            close = 1e-6 * max(np.ptp(difference), np.abs(difference).max())
            _require(
                bool(np.allclose(jacobian[:, k], difference, rtol=1e-5, atol=close)),
                f"jacobian with respect to {name} is not the derivative of predict at {theta}",
            )
        _check_linear(model, theta, *inputs)


def _check_linear(model: Model, theta: Array, *inputs: Array) -> None:
    """Second differences in all pairs of linear parameters vanish."""
    names = list(model.parameters)
    for name in model.linear:
        _require(name in names, f"linear names {name!r}; parameters are {', '.join(names)}")
    steps = np.diag(np.where(theta == 0, 1.0, theta))
    for one, other in combinations_with_replacement(model.linear, 2):
        h, k = steps[names.index(one)], steps[names.index(other)]
        both, first, second, none = model.predict(
            np.stack([theta + h + k, theta + h, theta + k, theta]), *inputs
        )
        size = max(np.abs(row).max() for row in (both, first, second, none))
        _require(
            bool(np.abs(both - first - second + none).max() <= 1e-9 * size),
            f"linear names {one} and {other}, but predict is not linear in them at {theta}",
        )


def run_check(
    name: str,
    optimizer: Optimizer,
    expected_failures: Mapping[str, str],
    evaluations: int = BUDGET,
) -> None:
    """Run one check; a failure is expected exactly where `expected_failures` gives a reason.

    `evaluations` is the largest budget of a run; choose it beyond the method's start-up phase.
    """
    expected = expected_failures.get(name)
    called = type(optimizer).__name__
    try:
        with _patience():
            CHECKS[name](optimizer, evaluations)
    except (Exception, NoEvaluation) as error:
        if expected is None:
            seen = str(error)
            if not isinstance(error, ConformanceError):
                seen = f"{type(error).__name__}: {error} ({raised_at(error, optimizer)})"
            raise ConformanceError(f"{called} fails {name}: {seen}") from error
    else:
        if expected is not None:
            raise ConformanceError(f"{called} passes {name}; remove the declared failure")


@contextlib.contextmanager
def _patience() -> Iterator[None]:
    """While this lasts, a method that does not come to its next evaluation raises NoEvaluation.

    It may compute for PATIENCE seconds of its own, which a busy machine does not shorten, or wait
    for as many of the clock without computing.
    """
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or not hasattr(signal, "setitimer"):
        yield
        return

    over: list[str] = []

    def give_up(reason: str) -> None:
        over.append(f"{reason} without an evaluation")
        raise NoEvaluation(over[0])

    def on_computing(number: int, frame: FrameType | None) -> None:
        give_up(f"it computed for {PATIENCE:g} CPU seconds")

    computed = time.process_time()

    def on_waiting(number: int, frame: FrameType | None) -> None:
        nonlocal computed
        before, computed = computed, time.process_time()
        if computed - before < IDLE * PATIENCE:
            give_up(f"it waited for {PATIENCE:g} seconds")

    handlers = {signal.SIGVTALRM: on_computing, signal.SIGALRM: on_waiting}
    previous = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    signal.setitimer(signal.ITIMER_VIRTUAL, PATIENCE, PATIENCE)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE, PATIENCE)
    try:
        yield
    finally:
        for timer in (signal.ITIMER_VIRTUAL, signal.ITIMER_REAL):
            signal.setitimer(timer, 0.0)
        for number, handler in previous.items():
            signal.signal(number, handler)
        if over:  # a run that this ended is a failed one, and its failure is caught
            raise NoEvaluation(over[0])


def _be_patient() -> None:
    """Begin to wait anew, if somebody waits."""
    if hasattr(signal, "setitimer") and signal.getitimer(signal.ITIMER_VIRTUAL)[0]:
        signal.setitimer(signal.ITIMER_VIRTUAL, PATIENCE, PATIENCE)
        signal.setitimer(signal.ITIMER_REAL, PATIENCE, PATIENCE)


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ConformanceError(message)


def _watched(optimizer: Optimizer, evaluations: int) -> tuple[Oracle, DecayFit]:
    """One run, without set-up, of which the problem has seen every evaluation."""
    problem = DecayFit()
    space = problem.space.seeded(problem.name, 3)
    oracle = Oracle(problem, Budget(evaluations=evaluations), space=space)
    with contextlib.suppress(BudgetExhausted):
        optimizer.run(oracle, stream("conformance"))
    return oracle, problem


def _same(one: Trace, other: Trace) -> bool:
    return (
        one.evaluations == other.evaluations
        and one.loss == other.loss
        and np.array_equal(np.array(one.theta), np.array(other.theta))
    )


def is_a_frozen_dataclass(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """Settings are a frozen dataclass: comparable, picklable, safe to share between runs."""
    settings = getattr(type(optimizer), "__dataclass_params__", None)
    _require(settings is not None and settings.frozen, "it is not a frozen dataclass")
    _require(pickle.loads(pickle.dumps(optimizer)) == optimizer, "it does not pickle to itself")


def keeps_the_budget_exactly(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """Every evaluation goes through the oracle, and not one more than allowed is made."""
    for budget in (*(n for n in (1, 2, 7, 400) if n < evaluations), evaluations):
        oracle, problem = _watched(optimizer, budget)
        _require(
            oracle.evaluations == problem.spent <= budget,
            f"budget {budget}: oracle counted {oracle.evaluations}, problem {problem.spent}",
        )


def records_every_improvement(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """The trace holds just the running minima of all losses, in order."""
    oracle, problem = _watched(optimizer, evaluations)
    minima = np.minimum.accumulate(problem.losses)
    improvements = np.unique(minima[np.isfinite(minima)])[::-1]
    trace = oracle.trace
    _require(trace.loss == improvements.tolist(), "the trace is not the running minimum")
    for column in (trace.evaluations, trace.seconds, trace.cpu_seconds):
        _require(bool((np.diff(column) >= 0).all()), "a column of the trace decreases")


def ends_descents_at_losses_it_has_seen(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """No descent ended below the best loss that was evaluated: by their ends a search may stop."""
    oracle, _ = _watched(optimizer, evaluations)
    least = min(oracle.meter.starts.ends, default=math.inf)
    _require(
        least >= oracle.best * (1 - RELATIVE),
        f"a descent ended at a loss of {least}; the best of the run is {oracle.best}",
    )


def starts_at_the_common_start(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """The first configuration evaluated is the first common initial configuration."""
    oracle, problem = _watched(optimizer, 1)
    start = oracle.space.decode(oracle.space.initial(1))[0]
    _require(np.array_equal(problem.thetas[0], start), f"{problem.thetas[0]} is not {start}")


def stays_in_the_box(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """Every configuration evaluated lies within the space's bounds."""
    _, problem = _watched(optimizer, evaluations)
    outside = np.array(problem.thetas)[~problem.space.contains(np.array(problem.thetas))]
    _require(not outside.size, f"{len(outside)} configurations outside, such as {outside[:1]}")


def repeats_with_the_same_seed(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """Same seed, same trace but for the seconds; another seed, another run."""
    budget = Budget(evaluations=evaluations)
    first, again = (minimize(optimizer, DecayFit(), budget, seed=3) for _ in range(2))
    other = minimize(optimizer, DecayFit(), budget, seed=4)
    _require(_same(first.trace, again.trace), "two runs with one seed differ")
    _require(not _same(first.trace, other.trace), "runs with different seeds are the same")


def uses_no_global_randomness(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """NumPy's and Python's global generators are left alone."""
    before = random.getstate(), str(np.random.get_state())  # noqa: NPY002
    minimize(optimizer, DecayFit(), Budget(evaluations=evaluations))
    after = random.getstate(), str(np.random.get_state())  # noqa: NPY002
    _require(before == after, "it drew from a global generator")


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
        _require(record.outcome is not Outcome.FAILED, f"{spoil.__name__}: {record.error}")
        if record.theta is not None:
            clean = DecayFit().loss(record.theta[None])[0]
            _require(record.loss == clean, f"{spoil.__name__}: best is {record.loss}, not {clean}")


def says_when_nothing_is_finite(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """A run that saw nothing finite ends as such, with reasons."""
    problem = DecayFit(lambda thetas, losses: np.full(len(thetas), np.nan))
    record = minimize(optimizer, problem, Budget(evaluations=evaluations))
    _require(record.outcome is Outcome.NO_FINITE_VALUE, f"the outcome is {record.outcome}")
    _require(record.theta is None and math.isinf(record.loss), "it claims a best configuration")
    _require(bool(record.rejected), "no reason was recorded")


def stops_at_the_target(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """A run ends at the first evaluation that reaches the target."""
    free = minimize(optimizer, DecayFit(), Budget(evaluations=evaluations), seed=3)
    middle = len(free.trace) // 2
    target = free.trace.loss[middle]
    record = minimize(optimizer, DecayFit(), Budget(evaluations=evaluations, target=target), seed=3)
    _require(record.outcome is Outcome.BUDGET, f"the outcome is {record.outcome}")
    _require(
        record.loss <= target
        and record.trace.evaluations[middle] == free.trace.evaluations[middle],
        f"it reached {record.loss}, not {target}",
    )


def resumes_bit_exactly(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """A Resumable run cut anywhere, pickled and resumed is the run that was never cut."""
    if not isinstance(optimizer, Resumable):
        return
    whole = minimize(optimizer, DecayFit(), Budget(evaluations=evaluations), seed=3)
    cut: RunRecord | None = None
    cuts = (n for n in (1, 5, 57, 58, 15_700, 15_701, 18_211) if n < evaluations)
    for n in (*cuts, evaluations):
        checkpoint = None if cut is None else pickle.loads(pickle.dumps(cut.checkpoint))
        budget = Budget(evaluations=n)
        cut = minimize(optimizer, DecayFit(), budget, seed=3, checkpoint=checkpoint)
    _require(cut is not None and _same(cut.trace, whole.trace), "the resumed run differs")


def asks_without_side_effects(optimizer: Optimizer, evaluations: int = BUDGET) -> None:
    """`ask` only reads the state: asked twice, an AskTell method gives the same batch."""
    if not isinstance(optimizer, AskTell):
        return
    problem = DecayFit()
    state = optimizer.init(problem.space, stream("conformance"))
    for _ in range(5):
        if optimizer.done(state):
            return
        first, second = optimizer.ask(state).copy(), optimizer.ask(state)
        _require(np.array_equal(first, second), "asked twice, it gave two batches")
        optimizer.tell(state, second, problem.loss(second))
        _require(np.array_equal(first, second), "tell changed the batch it was given")


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
