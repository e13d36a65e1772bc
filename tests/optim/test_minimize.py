"""`minimize`: every ending is a record."""

import ctypes
import itertools
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from miho import MIHO, Budget, Optimizer, Oracle, minimize
from miho.compiled import Climb, Rows
from miho.fitting.named import METHODS
from miho.optim import Outcome, RandomSearch
from miho.testing import DecayFit


class Interrupted(Optimizer):
    """Two Ctrl-C after ten evaluations."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        oracle(oracle.space.decode(oracle.space.initial(10)))
        if oracle.budget.evaluations is None:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)


class Broken(Optimizer):
    """Fails after ten evaluations."""

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        oracle(oracle.space.decode(oracle.space.initial(10)))
        raise RuntimeError("a bug\nin the method")


@dataclass(frozen=True)
class Loading(Optimizer):
    """Tells what was there before its first evaluation."""

    seen: list[bool]
    loads = ("colorsys",)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        assert oracle.meter.evaluations == 0
        kernel = oracle.traits.kernel
        assert isinstance(kernel, Traced)
        self.seen.extend(["colorsys" in sys.modules, kernel.rows_asked_for == 1])


@dataclass
class Traced:
    """Fast forms that are checked when they are first asked for."""

    rows_asked_for: int = 0
    climb: Climb | None = None

    @property
    def rows(self) -> Rows | None:
        self.rows_asked_for += 1
        return None


def test_what_a_run_needs_is_loaded_before_its_clock_starts() -> None:
    problem, optimizer = DecayFit(), Loading([])
    problem.kernel = Traced()
    sys.modules.pop("colorsys", None)
    assert minimize(optimizer, problem).error is None
    assert optimizer.seen == [True, True]


IMPORTS = """
import sys
from miho import Budget, minimize
from miho.fitting.named import method_of
from miho.testing import DecayFit

method, problem = method_of(sys.argv[1]), DecayFit()
problem.space.seeded("a", 1).initial(1)
for name in method.loads:
    __import__(name)
before = set(sys.modules)
minimize(method, problem, Budget(evaluations=200))
print([name for name in sys.modules if name.startswith("scipy.") and name not in before])
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_methods_import_no_part_of_scipy_while_the_clock_runs(name: str) -> None:
    command = [sys.executable, "-c", IMPORTS, name]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert process.stdout.strip() == "[]"


def test_ctrl_c_keeps_what_was_found() -> None:
    record = minimize(Interrupted(), DecayFit())
    assert record.outcome is Outcome.INTERRUPTED
    assert record.evaluations == 10
    assert record.theta is not None


@pytest.mark.parametrize("error", [KeyboardInterrupt, GeneratorExit])
def test_an_interrupt_that_nobody_sent_is_a_failure(error: type[BaseException]) -> None:
    def stop(_: Oracle) -> None:
        raise error

    record = minimize(RandomSearch(), DecayFit(), Budget(seconds=60), observer=stop)
    assert record.outcome is Outcome.FAILED
    assert error.__name__ in (record.error or "").splitlines()[-1]


class Upset(DecayFit):
    """Does something at each evaluation."""

    def __init__(self, deed: Callable[[], object]) -> None:
        super().__init__()
        self.deed = deed

    def loss(self, thetas: np.ndarray, fidelity: float = 1.0) -> np.ndarray:
        self.deed()
        return super().loss(thetas, fidelity)


def test_ctrl_c_in_a_callback_of_a_library_is_not_lost() -> None:
    """ctypes prints what they raise, and goes on."""
    callback = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))
    record = minimize(RandomSearch(), Upset(callback), Budget(evaluations=100))
    assert record.outcome is Outcome.INTERRUPTED


def test_an_interrupt_that_a_model_raises_itself_is_a_failure() -> None:
    def deed() -> None:
        raise KeyboardInterrupt

    record = minimize(RandomSearch(), Upset(deed), Budget(evaluations=100))
    assert record.outcome is Outcome.FAILED
    assert "nobody interrupted" in (record.error or "")


def test_a_failing_method_is_an_outcome_with_its_traceback() -> None:
    record = minimize(Broken(), DecayFit())
    assert record.outcome is Outcome.FAILED
    assert record.evaluations == 10
    assert "Traceback" in (record.error or "")
    last = (record.error or "").splitlines()[-1]
    assert last.startswith("RuntimeError: a bug in the method (test_minimize.py:")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"optimizer": "miho_qn"}, r"optimizer is 'miho_qn'; expected a method, .* miho\.MIHOGN"),
        ({"optimizer": "m" * 999}, "optimizer is 'm{79}; expected a method"),
        ({"optimizer": MIHO}, r"optimizer is the class MIHO; write MIHO\(\)"),
        ({"problem": abs}, "problem is <built-in function abs>.* miho.fit takes a function"),
        ({"problem": DecayFit}, "problem is the class DecayFit"),
        ({"budget": 200}, "budget is 200; expected a Budget"),
        ({"seed": 1.5}, "seed is 1.5; expected a whole number"),
    ],
)
def test_a_wrong_argument_is_refused(changed: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {"optimizer": RandomSearch(), "problem": DecayFit(), **changed}
    with pytest.raises(ValueError, match=message):
        minimize(**arguments)


def test_a_problem_without_a_space_is_refused() -> None:
    problem = DecayFit()
    problem.space = {"a": (0, 1)}  # type: ignore[assignment]
    with pytest.raises(ValueError, match=r"space of the problem is .* expected a miho\.Space"):
        minimize(RandomSearch(), problem)


def test_a_seed_may_be_a_number_of_numpy() -> None:
    seed: Any = np.int64(3)
    budget = Budget(evaluations=20)
    plain = minimize(RandomSearch(), DecayFit(), budget, seed=3)
    assert minimize(RandomSearch(), DecayFit(), budget, seed=seed).loss == plain.loss


def test_the_record_is_the_end_of_the_trace() -> None:
    problem = DecayFit()
    record = minimize(RandomSearch(), problem, Budget(evaluations=500), seed=1)
    assert record.outcome is Outcome.BUDGET
    assert record.evaluations == 500
    assert record.theta is not None
    assert record.loss == record.trace.loss[-1] == problem.loss(record.theta[None])[0]
    assert record.seconds >= record.trace.seconds[-1]


def test_methods_of_one_repetition_share_their_start() -> None:
    budget = Budget(evaluations=5)
    random = minimize(RandomSearch(batch=5), DecayFit(), budget, seed=2)
    miho = minimize(MIHO(R=20, eta=2), DecayFit(), budget, seed=2)
    assert random.trace.loss == miho.trace.loss


def test_an_observer_costs_no_time_and_changes_nothing() -> None:
    losses = []
    budget = Budget(evaluations=3000)
    watched = minimize(
        MIHO(R=100, eta=3), DecayFit(), budget, observer=lambda o: losses.append(o.best)
    )
    alone = minimize(MIHO(R=100, eta=3), DecayFit(), budget)
    assert losses
    assert watched.trace.loss == alone.trace.loss


def test_only_asktell_methods_resume() -> None:
    record = minimize(RandomSearch(), DecayFit(), Budget(evaluations=5))
    with pytest.raises(ValueError, match="cannot be resumed"):
        minimize(Broken(), DecayFit(), checkpoint=record.checkpoint)
    with pytest.raises(ValueError, match="resume the same run"):
        minimize(RandomSearch(batch=7), DecayFit(), checkpoint=record.checkpoint)
    with pytest.raises(ValueError, match="resume the same run"):
        minimize(RandomSearch(), DecayFit(), seed=1, checkpoint=record.checkpoint)


def test_resuming_leaves_the_checkpoint_as_it_was() -> None:
    first = minimize(RandomSearch(), DecayFit(), Budget(evaluations=500))
    for _ in range(2):
        more = minimize(
            RandomSearch(), DecayFit(), Budget(evaluations=5000), checkpoint=first.checkpoint
        )
        assert more.evaluations == 5000
        assert first.trace.evaluations[-1] <= first.evaluations == 500
    whole = minimize(RandomSearch(), DecayFit(), Budget(evaluations=5000))
    assert more.trace.loss == whole.trace.loss


@pytest.mark.parametrize("call", [1, 2, 4, 9, 20, 40, 80, 120])
@pytest.mark.parametrize("delay", [1e-6, 1e-4])
def test_ctrl_c_at_any_time_resumes_bit_exactly(call: int, delay: float) -> None:
    optimizer, budget, calls = MIHO(R=300, eta=3), Budget(evaluations=6000), itertools.count(1)

    def deed() -> None:
        if next(calls) == call:
            signal.setitimer(signal.ITIMER_REAL, delay)

    handler = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        cut = minimize(optimizer, Upset(deed), budget)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, handler)
    assert cut.outcome is Outcome.INTERRUPTED
    checkpoint = pickle.loads(pickle.dumps(cut.checkpoint))
    resumed = minimize(optimizer, DecayFit(), budget, checkpoint=checkpoint)
    whole = minimize(optimizer, DecayFit(), budget)
    assert resumed.trace.evaluations == whole.trace.evaluations
    assert resumed.trace.loss == whole.trace.loss


def test_an_interrupt_in_the_middle_of_a_step_cannot_be_resumed() -> None:
    def stop(_: Oracle) -> None:
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)

    record = minimize(RandomSearch(), DecayFit(), observer=stop)
    assert record.outcome is Outcome.INTERRUPTED
    assert record.checkpoint is None
