"""The oracle: exact counts, in-order improvements, a clock that stops while recording."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from miho import Budget, Oracle, Parameter, Problem, Space
from miho.compiled import Block
from miho.optim import BudgetExhausted, Clock, Meter, RunInterrupted, Trace
from miho.testing import DecayFit

Array = NDArray[np.float64]
NOTHING = np.empty(0)
SPACE = Space((Parameter("x", "m", -10.0, 10.0),))


class Watch:
    """A clock that moves only when it is set."""

    def __init__(self) -> None:
        self.now = 100.0

    def clock(self) -> Clock:
        return Clock(wall=lambda: self.now, cpu=lambda: self.now / 2)


class FunctionProblem(Problem):
    """The loss of x is `loss(x)`, one second each on `watch`."""

    name = "given"
    space = SPACE

    def __init__(self, loss: Callable[[float], Any] = abs, watch: Watch | None = None) -> None:
        self.calls = 0
        self._loss = loss
        self._watch = watch

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Any:
        self.calls += len(thetas)
        if self._watch is not None:
            self._watch.now += len(thetas)
        values = [self._loss(x) for x in thetas[:, 0]]
        return np.array(values) if len(values) > 1 else np.asarray(values[0])[None]


def column(*values: float) -> Array:
    return np.array(values, dtype=float)[:, None]


def test_improvements_inside_a_batch_are_recorded_at_their_own_evaluation() -> None:
    watch = Watch()
    oracle = Oracle(FunctionProblem(watch=watch), Budget(), clock=watch.clock())
    losses = oracle(column(5, 7, 3, 3, 4, 1, 2))
    assert losses.tolist() == [5, 7, 3, 3, 4, 1, 2]
    assert oracle.trace.evaluations == [1, 3, 6]
    assert oracle.trace.loss == [5, 3, 1]
    assert oracle.trace.seconds == pytest.approx([1, 3, 6])
    assert [theta.tolist() for theta in oracle.trace.theta] == [[5], [3], [1]]


def test_the_clock_stops_while_recording_and_observing() -> None:
    watch = Watch()

    def slow(oracle: Oracle) -> None:
        watch.now += 1000

    oracle = Oracle(FunctionProblem(watch=watch), Budget(), clock=watch.clock(), observer=slow)
    for x in (3, 2, 1):
        oracle(column(x))
    assert oracle.trace.seconds == [1, 2, 3]
    watch.now += 5
    oracle.stop()
    assert oracle.meter.seconds == 8


def test_a_slow_record_costs_the_method_nothing() -> None:
    watch = Watch()

    class SlowTrace(Trace):
        def add(self, *row: Any) -> None:
            super().add(*row)
            watch.now += 1000

    oracle = Oracle(
        FunctionProblem(watch=watch), Budget(), clock=watch.clock(), meter=Meter(trace=SlowTrace())
    )
    for x in (3, 2, 1):
        oracle(column(x))
    oracle.stop()
    assert oracle.trace.seconds == [1, 2, 3]
    assert oracle.meter.seconds == 3
    assert oracle.meter.cpu_seconds == 1.5


def test_the_budget_is_exact_in_the_middle_of_a_batch() -> None:
    problem = FunctionProblem()
    oracle = Oracle(problem, Budget(evaluations=4))
    oracle(column(9, 8))
    with pytest.raises(BudgetExhausted):
        oracle(column(7, 6, 5))
    assert problem.calls == oracle.evaluations == 4
    assert oracle.best == 6
    with pytest.raises(BudgetExhausted):
        oracle(column(1))
    assert problem.calls == 4


def test_seconds_end_a_run_within_a_chunk() -> None:
    watch = Watch()
    problem = FunctionProblem(watch=watch)
    oracle = Oracle(problem, Budget(seconds=3), clock=watch.clock())
    with pytest.raises(BudgetExhausted):
        oracle(column(*range(9, 0, -1)))
    assert problem.calls == 3


def test_a_compiled_block_lasts_no_longer_than_a_chunk() -> None:
    """At 6 ms an evaluation, 20 ms hold three; before anything was timed, what is needed."""
    watch, allowed = Watch(), []

    class Slow(FunctionProblem):
        def loss(self, thetas: Array, fidelity: float = 1.0) -> Any:
            watch.now += 0.006 * len(thetas)
            return np.abs(thetas[:, 0])

    def block(most: float, best: float, target: float) -> Block:
        allowed.append(int(most))
        return Block(1, NOTHING, NOTHING, NOTHING[:, None], {})

    oracle = Oracle(Slow(), Budget(evaluations=4), clock=watch.clock())
    oracle.spend(block, 1)
    oracle(column(3))
    watch.now += 0.006
    oracle.spend(block, 1)
    oracle.spend(block, 1)
    assert allowed == [1, 2, 1]  # of the 3 that time allows, as many as are left
    with pytest.raises(BudgetExhausted):
        oracle.spend(block, 1)


def test_the_target_ends_a_run() -> None:
    oracle = Oracle(FunctionProblem(), Budget(target=2.5))
    oracle(column(5))
    with pytest.raises(BudgetExhausted):
        oracle(column(2))
    assert oracle.best == 2


@pytest.mark.parametrize(
    ("loss", "reason"),
    [
        (lambda x: math.nan, "loss is nan"),
        (lambda x: math.inf, "loss is inf"),
        (lambda x: -math.inf, "loss is -inf"),
        (lambda x: None, "not one real number per row: object"),
        (lambda x: "low", "not one real number per row: <U3"),
        (lambda x: 1j, "not one real number per row: complex128"),
        (lambda x: np.zeros(2), "not one real number per row: float64 of shape (1, 2)"),
        (lambda x: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
def test_unusable_values_are_counted_with_their_reason(
    loss: Callable[[float], Any], reason: str
) -> None:
    oracle = Oracle(FunctionProblem(lambda x: loss(x) if x > 0 else 4.0), Budget())
    assert oracle(column(1)).tolist() == [math.inf]
    assert oracle(column(0)).tolist() == [4.0]
    assert oracle.best == 4.0
    assert oracle.evaluations == 2
    ((message, count),) = oracle.meter.rejected.items()
    assert message.startswith(reason)
    assert count == 1


def test_one_bad_row_does_not_spoil_its_batch() -> None:
    def loss(x: float) -> float:
        if x == 2:
            raise ArithmeticError("no two")
        return x

    oracle = Oracle(FunctionProblem(loss), Budget())
    assert oracle(column(3, 2, 1)).tolist() == [3, math.inf, 1]
    assert oracle.trace.evaluations == [1, 3]
    assert oracle.meter.rejected == {"ArithmeticError: no two; first at x = 2": 1}


@pytest.mark.filterwarnings("error")
def test_huge_and_tiny_losses_are_usable() -> None:
    oracle = Oracle(FunctionProblem(lambda x: x), Budget())
    assert oracle(column(1e308, 1e308, 5e-324)).tolist() == [1e308, 1e308, 5e-324]
    assert not oracle.meter.rejected


def test_a_fidelity_costs_its_fraction_and_never_becomes_best() -> None:
    oracle = Oracle(FunctionProblem(), Budget(evaluations=2))
    oracle(column(1, 1, 1, 1), fidelity=0.25)
    assert oracle.evaluations == 1
    assert oracle.best == math.inf
    oracle(column(5))
    assert oracle.trace.evaluations == [2]
    with pytest.raises(ValueError, match="fidelity is 0"):
        Oracle(FunctionProblem(), Budget())(column(1), fidelity=0.0)


@pytest.mark.parametrize("N", [3, 600, 701, 1_000_003])
@pytest.mark.parametrize("seed", range(3))
def test_the_count_of_rows_does_not_depend_on_how_they_are_cut(N: int, seed: int) -> None:
    """By one batch, by single rows, and by compiled blocks: the quotient of two whole numbers."""
    rng = np.random.default_rng(seed)
    parts = rng.integers(1, max(2, N // 2), 200)
    limit = -(-int(parts.sum()) // N)

    def blocks(most: float, best: float, target: float) -> Block:
        rows = parts[blocks_made[0]]
        blocks_made[0] += 1
        return Block(rows / N, NOTHING, NOTHING, NOTHING[:, None], {}, blocks_made[0] == parts.size)

    problem = FunctionProblem()
    problem.rows = N
    compiled, batches = (Oracle(problem, Budget(evaluations=limit)) for _ in range(2))
    blocks_made = [0]
    compiled.spend(blocks, 0.0)
    for rows in parts:
        batches(column(1), fidelity=rows / N)
    assert compiled.evaluations == batches.evaluations == int(parts.sum()) / N
    rows_left = limit * N - int(parts.sum())
    assert batches.affords(rows_left / N)
    assert not batches.affords((rows_left + 1) / N)


def test_a_problem_may_reuse_its_buffer() -> None:
    class Reuses(FunctionProblem):
        buffer = np.empty(8)

        def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
            if len(thetas) > 4:
                raise ValueError("too many")
            self.buffer[: len(thetas)] = np.abs(thetas[:, 0])
            return self.buffer[: len(thetas)]

    for oracle in (Oracle(Reuses(), Budget()), Oracle(Reuses(), Budget())):
        oracle(column(9))  # so that the chunks grow
        assert oracle(column(6, 5, 4, 3, 2, 1)).tolist() == [6, 5, 4, 3, 2, 1]


def test_a_problem_cannot_edit_what_it_is_asked() -> None:
    class Edits(FunctionProblem):
        def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
            thetas *= 2
            return thetas[:, 0]

    batch = column(1, 2)
    oracle = Oracle(Edits(), Budget())
    assert oracle(batch).tolist() == [math.inf, math.inf]
    assert batch.tolist() == [[1], [2]]
    assert oracle.meter.rejected == {"ValueError: output array is read-only; first at x = 1": 2}


def test_reasons_without_end_are_counted_together() -> None:
    def loss(x: float) -> float:
        raise ValueError(f"bad {chr(int(x) + 200)}")

    oracle = Oracle(FunctionProblem(loss), Budget())
    oracle(column(*range(100)))
    assert len(oracle.meter.rejected) == 21
    assert oracle.meter.rejected["other reasons"] == 80


def test_reasons_that_differ_in_numbers_are_one() -> None:
    """With the first as the example; a line of a file and a digit in a name tell reasons apart."""
    texts = ["at x1=1.25, step 3", "at x1=-1e-09, step 0x7f", "at x2=1.0, step 3", "f.py:12: no"]

    def loss(x: float) -> float:
        raise ArithmeticError([*texts, "f.py:13: no"][int(x) % 5])

    oracle = Oracle(FunctionProblem(loss), Budget())
    oracle(column(*range(10)))
    assert oracle.meter.rejected == {
        "ArithmeticError: at x1=1.25, step 3; first at x = 0": 4,
        "ArithmeticError: at x2=1.0, step 3; first at x = 2": 2,
        "ArithmeticError: f.py:12: no; first at x = 3": 2,
        "ArithmeticError: f.py:13: no; first at x = 4": 2,
    }


def test_after_ctrl_c_the_run_ends_between_two_evaluations() -> None:
    oracle = Oracle(FunctionProblem(), Budget())
    oracle(column(3))
    oracle.interrupted = True
    with pytest.raises(RunInterrupted):
        oracle(column(2))
    assert oracle.evaluations == 1


@pytest.mark.parametrize(
    "settings",
    [
        {"evaluations": 0},
        {"evaluations": 1.5},
        {"evaluations": True},
        {"seconds": 0.0},
        {"seconds": -1.0},
        {"seconds": math.nan},
        {"target": math.inf},
    ],
)
def test_bad_budgets(settings: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"budget.{next(iter(settings))} is"):
        Budget(**settings)


def test_configurations_of_another_dimension_are_refused() -> None:
    oracle = Oracle(DecayFit(), Budget())
    with pytest.raises(ValueError, match=r"have the shape \(1, 3\); expected \(n, 2\)"):
        oracle(np.ones((1, 3)))
    oracle.stop()


def test_a_former_member_names_its_place() -> None:
    oracle = Oracle(DecayFit(), Budget())
    with pytest.raises(AttributeError, match=r"it is oracle\.starts\.add now"):
        _ = oracle.record_descent
    with pytest.raises(AttributeError, match=r"it is oracle\.traits\.rounding now"):
        _ = oracle.rounding
