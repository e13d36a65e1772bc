"""Evaluations by workers: the same as without, each made once, and how they end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.cma_es import CMAES
from miho.data import Dataset
from miho.identification import CurveFit, Huber
from miho.identification.residual_expressions import weighted
from miho.methods import PSO, DifferentialEvolution, LeastSquares
from miho.models import FunctionModel
from miho.models.joint import JointModel, JointPart
from miho.models.model import ExternalModel, Model
from miho.models.spread import SpreadModel
from miho.optim import (
    MIHO,
    MIHOGN,
    Budget,
    Optimizer,
    Outcome,
    Parameter,
    Problem,
    RandomSearch,
    Space,
    minimize,
)
from miho.optim.spread import spread_problem
from miho.parallel import Evaluations, NoWorkersLeft, evaluations, open_pool
from miho.parallel.process_executor import WorkerLostError
from tests.parallel.expensive import (
    LIMIT,
    OUTPUT,
    SPACE,
    TIMES,
    Array,
    Bowl,
    Counted,
    Residuals,
    Watched,
    decay,
    decay_fit,
    same,
)

BUDGET = Budget(evaluations=60)
RUNS: list[tuple[Optimizer, Problem]] = [
    (RandomSearch(batch=10), Bowl()),
    (PSO(particles=10), Bowl()),
    (DifferentialEvolution(popsize=5), Bowl()),
    (CMAES(), Bowl()),
    (MIHO(), decay_fit()),
    (MIHOGN(), Residuals()),
    (MIHOGN(), decay_fit()),
    (LeastSquares(), decay_fit()),
]


@pytest.mark.parametrize(
    ("optimizer", "problem"), RUNS, ids=[f"{type(o).__name__}-{p.name}" for o, p in RUNS]
)
def test_a_run_by_workers_is_the_same_to_the_last_bit(
    optimizer: Optimizer, problem: Problem
) -> None:
    """Values, errors of the model by name and message, and the budget."""
    alone = minimize(optimizer, problem, BUDGET)
    assert alone.error is None
    with ThreadPoolExecutor(4) as threads:
        for workers in (2, threads, map):
            shared = minimize(optimizer, problem, BUDGET, workers=workers, evaluation_limit=LIMIT)
            assert same(alone, shared), (alone.rejected, shared.rejected, shared.error)
            assert shared.usage is not None
            assert shared.usage.evaluations > 0 == shared.usage.here
    if isinstance(problem, Bowl):
        (reason,) = alone.rejected
        assert reason.startswith("ArithmeticError: a is large in 1 rows; first at a = ")


def test_what_a_budget_pays_for_is_evaluated_once_and_no_more() -> None:
    """Also where a row of a batch raises, and the method asks for the others one by one."""

    def loss(thetas: Array) -> Array:
        if (thetas[:, 0] > 3).any():
            raise ArithmeticError("a is large")
        return np.asarray((thetas**2).sum(axis=1))

    problem = Counted(loss)
    with ThreadPoolExecutor(4) as threads:
        record = minimize(
            RandomSearch(batch=10), problem, Budget(evaluations=45), workers=threads,
            evaluation_limit=LIMIT,
        )  # fmt: skip
    assert record.evaluations == problem.counts.total() == len(problem.counts) == 45
    assert 0 < sum(record.rejected.values()) < 45


def test_a_cheap_model_stays_here_and_says_so() -> None:
    record = minimize(RandomSearch(batch=10), Bowl(), BUDGET, workers=2)
    assert record.usage is not None
    assert record.usage.evaluations == 0 < record.usage.here
    assert "too short for 2 workers" in str(record.usage)


def test_unpicklable_closures_are_for_threads_and_lambdas_for_all() -> None:
    lock, scale = threading.Lock(), 2.0

    def locked(thetas: Array) -> Array:
        with lock:
            return np.asarray((thetas**2).sum(axis=1) * scale)

    alone = minimize(RandomSearch(batch=10), Counted(locked), BUDGET)
    assert alone.error is None
    with ThreadPoolExecutor(2) as threads:
        record = minimize(
            RandomSearch(batch=10), Counted(locked), BUDGET, workers=threads,
            evaluation_limit=LIMIT,
        )  # fmt: skip
    assert same(alone, record)
    refused = minimize(
        RandomSearch(batch=10), Counted(locked), BUDGET, workers=2, evaluation_limit=LIMIT
    )
    assert refused.outcome is Outcome.FAILED
    assert refused.error is not None
    assert "cannot be sent to workers" in refused.error
    assert refused.error.count("\n") == 1
    model = FunctionModel(lambda t, *, a, b: scale * a * np.exp(-b * t) if b > 0 else 0 * t, False)
    data = Dataset("lambda", {"t": TIMES, "y": OUTPUT}, {"t": "", "y": ""}, "y")
    problem = CurveFit(model, data, SPACE)
    alone = minimize(LeastSquares(), problem, BUDGET)
    assert same(alone, minimize(LeastSquares(), problem, BUDGET, workers=2, evaluation_limit=LIMIT))


class External(ExternalModel):
    """A simulation, some of whose results fail."""

    inputs, parameters, output = {"t": ""}, {"a": "", "b": ""}, ""
    linear, name, step = (), "external", 1e-3

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        outputs = thetas[:, :1] * np.exp(-thetas[:, 1:] * inputs[0])
        outputs[thetas[:, 1] > 1] = np.nan
        return np.asarray(outputs)


LEAF = FunctionModel(decay, batched=False)
JOINT = JointModel((JointPart("one", LEAF, ("a", "b")), JointPart("two", LEAF, ("a", "c"))))
HALVES = np.repeat([0.0, 1.0], [8, TIMES.size - 8])
MODELS: dict[str, tuple[Model, tuple[Array, ...], list[list[float]]]] = {
    "plain": (LEAF, (TIMES,), [[2.0, 1.5], [1.0, 0.5]]),
    "weighted": (weighted(LEAF), (TIMES, TIMES + 1), [[2.0, 1.5], [1.0, 0.5]]),
    "joint": (JOINT, (HALVES, TIMES), [[2.0, 1.5, 0.7], [1.0, 0.5, 0.3]]),
    "external": (External(), (TIMES,), [[2.0, 0.5], [2.0, 1.0], [2.0, 1.5]]),
}


@pytest.mark.parametrize("kind", MODELS)
def test_models_of_expensive_leaves_give_the_same_by_workers(kind: str) -> None:
    model, inputs, rows = MODELS[kind]
    with ThreadPoolExecutor(2) as threads, open_pool(threads) as pool:
        spread = Evaluations(pool, limited=True)
        shared = model.with_leaves(lambda leaf: SpreadModel(leaf, spread, "leaf"))
        assert shared is not model
        thetas = np.array(rows)
        for _ in range(2):
            assert np.array_equal(
                model.predict(thetas, *inputs), shared.predict(thetas, *inputs), equal_nan=True
            )
            for theta in thetas:
                assert np.array_equal(
                    model.jacobian(theta, *inputs), shared.jacobian(theta, *inputs), equal_nan=True
                )
        assert not spread._pending
        assert not spread._here
        assert spread.usage.evaluations > 0


def test_tied_and_fixed_parameters_of_a_expensive_model() -> None:
    space = Space((Parameter("a", "", tied="4 * b"), Parameter("b", "", 0.1, 5.0)))
    problem = decay_fit()
    problem = replace(problem, space=space)
    alone = minimize(LeastSquares(), problem, BUDGET)
    shared = minimize(LeastSquares(), problem, BUDGET, workers=2, evaluation_limit=LIMIT)
    assert same(alone, shared)


def _complex(thetas: Array) -> Any:
    return thetas[:, 0] * (1 + 2j)


def _too_few(thetas: Array) -> Any:
    return thetas[:1, 0]


@pytest.mark.parametrize("loss", [_complex, _too_few])
def test_values_that_are_none_are_refused_as_without_workers(loss: Any) -> None:
    alone = minimize(RandomSearch(batch=5), Counted(loss), Budget(evaluations=20))
    with ThreadPoolExecutor(2) as threads:
        record = minimize(
            RandomSearch(batch=5), Counted(loss), Budget(evaluations=20), workers=threads,
            evaluation_limit=LIMIT,
        )  # fmt: skip
    assert record.outcome is alone.outcome
    assert sum(record.rejected.values()) == sum(alone.rejected.values())


def test_what_is_complete_first_is_first() -> None:
    executor = Watched(lambda number, future: True)
    with open_pool(executor) as pool:
        spread = Evaluations(pool, limited=True)
        task = spread.function("sum", lambda thetas: thetas.sum(axis=1))
        needs = [
            spread.ahead(lambda k=k: task(np.array([[k, 0.0], [k, 1.0]])))  # type: ignore[misc]
            for k in range(3)
        ]
        assert len(executor.calls) == 6
        assert spread.busy == 4
        for number in (4, 0, 2, 3):  # of the last, the first, and all of the middle one
            executor.calls[number][1]()
        assert spread.first_ready(needs) == 1
        executor.calls[5][1]()
        assert spread.first_ready(needs) == 1, "in the order in which they came"
        assert spread.first_ready(needs[::2]) == 1
        assert np.array_equal(task(np.array([[1.0, 0.0], [1.0, 1.0]])), [1.0, 2.0])
        assert spread.first_ready([needs[1], needs[2]]) == 0, "what is known waits for nothing"
        assert len(executor.calls) == 6
        spread.close()
    assert executor.calls[1][0].cancelled()


def test_values_of_failed_batches_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluations, "MOST_KEPT", 20)
    with ThreadPoolExecutor(2) as threads, open_pool(threads) as pool:
        spread = Evaluations(pool, limited=True)
        task = spread.function("bowl", Bowl().loss)
        for k in range(50):
            with pytest.raises(ValueError, match="a is large"):
                task(np.array([[4.0, k], [1.0, k], [2.0, k]]))
        assert len(spread._here) <= 20
        assert not spread._pending


def test_ctrl_c_while_workers_are_busy_leaves_a_run_that_goes_on() -> None:
    """The signal comes when so many calls were given, of which none ever ends."""
    alone = minimize(RandomSearch(batch=10), Bowl(), BUDGET)

    def interrupt(number: int, future: Future[Any]) -> bool:
        if number == 24:
            os.kill(os.getpid(), signal.SIGINT)
        return number >= 20

    record = minimize(
        RandomSearch(batch=10), Bowl(), BUDGET, workers=Watched(interrupt), evaluation_limit=LIMIT
    )
    assert record.outcome is Outcome.INTERRUPTED, record.error
    assert record.evaluations == 20
    assert record.checkpoint is not None
    again = minimize(
        RandomSearch(batch=10), Bowl(), BUDGET, checkpoint=record.checkpoint, workers=map,
        evaluation_limit=LIMIT,
    )  # fmt: skip
    assert same(alone, again)


def test_workers_that_are_gone_end_a_run_in_one_line_and_it_can_go_on() -> None:
    alone = minimize(RandomSearch(batch=10), Bowl(), BUDGET)

    def leave(number: int, future: Future[Any]) -> bool:
        if number >= 25:
            future.cancel()
        return number >= 25

    executor = Watched(leave)
    record = minimize(
        RandomSearch(batch=10), Bowl(), BUDGET, workers=executor, evaluation_limit=LIMIT
    )
    assert record.outcome is Outcome.FAILED
    assert record.error == "the workers or their scheduler have left; give new workers\n"
    assert len(executor.calls) <= 30
    assert record.loss <= alone.trace.loss[0]
    assert record.checkpoint is not None
    assert same(
        alone, minimize(RandomSearch(batch=10), Bowl(), BUDGET, checkpoint=record.checkpoint)
    )


def test_workers_that_all_end_without_an_answer_end_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lose(number: int, future: Future[Any]) -> bool:
        if number >= 10:
            future.set_exception(WorkerLostError("killed by SIGSEGV", again=False))
        return number >= 10

    monkeypatch.setattr(evaluations, "MOST_LOST", 20)
    record = minimize(
        RandomSearch(batch=10), Bowl(), Budget(evaluations=1000), workers=Watched(lose),
        evaluation_limit=LIMIT,
    )  # fmt: skip
    assert record.outcome is Outcome.FAILED
    assert record.error is not None
    assert record.error.startswith("the last 20 evaluations ended their workers (killed by S")
    assert record.error.count("\n") == 1
    assert record.evaluations <= 30
    assert np.isfinite(record.loss)


def test_a_broken_executor_is_not_taken_for_errors_of_the_model() -> None:
    with ProcessPoolExecutor(1) as executor:
        executor.shutdown()
        record = minimize(
            MIHOGN(), decay_fit(), Budget(evaluations=1000), workers=executor,
            evaluation_limit=LIMIT,
        )  # fmt: skip
    assert record.outcome is Outcome.FAILED
    assert record.error is not None
    assert "give a new one" in record.error
    assert record.error.count("\n") == 1
    assert record.evaluations == 0 == sum(record.rejected.values())


def test_a_value_that_never_comes_from_workers_of_others_is_given_up() -> None:
    ended = threading.Event()

    def loss(thetas: Array) -> Array:
        if (thetas[:, 0] > 4).any():
            ended.wait()
        return np.asarray((thetas**2).sum(axis=1))

    with ThreadPoolExecutor(8) as threads:
        try:
            record = minimize(
                RandomSearch(batch=10), Counted(loss), Budget(evaluations=40), workers=threads,
                evaluation_limit=0.5,
            )  # fmt: skip
        finally:
            ended.set()
    reason = "WorkerLostError: no end within 0.5 s, so it was given up"
    assert record.evaluations == 40
    ((rejected, count),) = record.rejected.items()
    assert rejected.startswith(f"{reason}; first at ")
    assert 0 < count < 8
    assert record.error is None


def test_what_ends_a_run_is_no_exception_that_methods_catch() -> None:
    assert not issubclass(NoWorkersLeft, Exception)


@pytest.mark.parametrize("limit", [0, -1.0, np.nan, "soon"])
def test_a_limit_that_is_none_is_refused(limit: Any) -> None:
    with (
        pytest.raises(ValueError, match="evaluation_limit"),
        spread_problem(Bowl(), None, limit),
    ):
        pass


def test_a_limit_does_not_run_while_no_worker_is_there() -> None:
    """A queue may keep its jobs waiting for hours."""
    late = LateExecutor()
    with spread_problem(Bowl(), late, 0.1) as (problem, evaluations):
        assert evaluations is not None
        pool = evaluations._pool
        assert pool is not None
        pool.empty = lambda: not late.there.is_set()
        timer = threading.Timer(1.0, late.arrive)
        timer.start()
        assert problem.loss(np.array([[1.0, 2.0]])).tolist() == [5.0]


class LateExecutor(ThreadPoolExecutor):
    """A thread that begins with its work when told."""

    def __init__(self) -> None:
        super().__init__(1)
        self.there = threading.Event()
        super().submit(self.there.wait)

    def arrive(self) -> None:
        self.there.set()


def test_robust_losses_are_the_same_by_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where there is no room for derivatives beside residuals, and they come later."""
    monkeypatch.setattr("miho.optim.miho_gn_state.ROOM", 0)
    problem = decay_fit(rho=Huber(0.01))
    alone = minimize(MIHOGN(), problem, BUDGET)
    assert same(alone, minimize(MIHOGN(), problem, BUDGET, workers=2, evaluation_limit=LIMIT))


SCRIPT = """
import time
import numpy as np
from scipy.special import j0
from miho.optim import Budget, Parameter, Problem, RandomSearch, Space, minimize
print("the script runs")
class Mine(Problem):
    name, space = "mine", Space((Parameter("x", "1", -1.0, 1.0),))
    def loss(self, thetas, fidelity=1.0):
        return square(thetas)
square = lambda thetas: (thetas ** 2).sum(axis=1) + 0 * j0(1.0)
record = minimize(RandomSearch(batch=4), Mine(), Budget(evaluations=8), workers=2,
                  evaluation_limit=60)
print(record.outcome, record.evaluations, record.usage.evaluations, dict(record.rejected))
"""


def test_a_script_that_does_not_ask_whether_it_is_the_main_one(tmp_path: Path) -> None:
    """It is not run again by its workers, and what it defines itself goes to them."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=120, check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )  # fmt: skip
    assert ended.stderr == ""
    assert ended.stdout.splitlines() == ["the script runs", "budget 8.0 8 {}"]
