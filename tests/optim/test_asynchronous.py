"""Brackets at a time: the decisions of a search that goes on as evaluations come."""

from __future__ import annotations

import math
import pickle
import random
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from miho.optim import (
    MIHOGN,
    AsynchronousMIHOGN,
    Budget,
    Meter,
    Oracle,
    Outcome,
    RunRecord,
    minimize,
)
from miho.optim.asynchronous_miho_gn import AsynchronousMIHOGNState
from miho.optim.distribution import Distribution, Kind
from miho.optim.miho_gn_state import MIHOGNState
from miho.parallel import Ahead, usage
from tests.optim.decays import Outside, fit

Array = NDArray[np.float64]

LIMIT = 600.0
"""Seconds for an evaluation: with a limit workers make all of them, however short they are."""
BRACKETS = AsynchronousMIHOGN(max_brackets=12)
AT_A_TIME = 6


class Slow(Outside):
    """A problem whose evaluations take 11 ms, long enough for a journal."""

    def residuals(self, theta: Array, fidelity: float = 1.0) -> Array:
        time.sleep(0.011)
        return super().residuals(theta, fidelity)

    def jacobian(self, theta: Array, fidelity: float = 1.0) -> Array:
        time.sleep(0.011)
        return super().jacobian(theta, fidelity)


class Shuffling(Executor):
    """Makes calls in a thread of its own, each time one at random of those that wait."""

    def __init__(self, workers: int, seed: int) -> None:
        self._max_workers = workers
        self._random = random.Random(seed)
        self._waiting: list[tuple[Future[Any], Callable[[], Any]]] = []
        self._changed = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        with self._changed:
            self._waiting.append((future, lambda: fn(*args, **kwargs)))
            self._changed.notify()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._ended)
                if not self._waiting:
                    return
                position = self._random.randrange(len(self._waiting))
                future, call = self._waiting.pop(position)
            if future.set_running_or_notify_cancel():
                future.set_result(call())


@pytest.fixture
def workers() -> Iterator[Shuffling]:
    with Shuffling(4, 1) as executor:
        yield executor


@pytest.fixture
def several(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations at a time without workers; which of them ends first depends on their count."""

    def first_ready(workers: Distribution, needs: list[Ahead]) -> int:
        return round(600 * workers._meter.evaluations) // 7 % len(needs)

    monkeypatch.setattr(Distribution, "count", AT_A_TIME)
    monkeypatch.setattr(Distribution, "first_ready", first_ready)


def same(first: RunRecord, second: RunRecord) -> bool:
    """Whether two runs are the same but for their seconds."""
    a, b = first.trace, second.trace
    return (
        a.evaluations == b.evaluations
        and a.loss == b.loss
        and np.array_equal(np.array(a.theta), np.array(b.theta))
        and first.evaluations == second.evaluations
    )


@pytest.mark.parametrize("says_rows", [True, False])
@pytest.mark.parametrize("linear", [(), ("a", "c")], ids=["stepping", "projecting"])
def test_rounds_of_candidates_are_the_same_with_any_workers(
    says_rows: bool, linear: tuple[str, ...], workers: Shuffling, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A round has more than one evaluation of a kind begun; candidates wait for each other."""
    begun: list[tuple[str, int]] = []
    ahead = Distribution.ahead

    def count(
        workers: Distribution, thetas: Array, fidelity: float = 1.0, kind: Kind = "loss"
    ) -> Ahead:
        begun.append((kind, len(thetas)))
        return ahead(workers, thetas, fidelity, kind)

    problem, method = Outside(fit(linear=linear), says_rows), MIHOGN(max_brackets=3, base_cost=8.0)
    alone = minimize(method, problem, seed=1)
    monkeypatch.setattr(Distribution, "ahead", count)
    spread = minimize(method, problem, seed=1, workers=workers, evaluation_limit=LIMIT)
    assert spread.error is None
    assert same(alone, spread)
    assert max(n for kind, n in begun if kind == "jacobian") > 1
    assert max(n for kind, n in begun if kind == "residuals") > 1


def test_a_cheap_loss_has_one_evaluation_at_a_time_and_says_so(
    workers: Shuffling, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is sent, and the run is that without workers to the last bit."""
    monkeypatch.setattr(usage, "ALONE", math.inf)  # however busy the machine is
    monkeypatch.setattr(usage, "WORTH_SENDING", math.inf)
    problem, budget = Outside(fit()), Budget(evaluations=200)
    alone = minimize(BRACKETS, problem, budget, seed=1)
    record = minimize(BRACKETS, problem, budget, seed=1, workers=workers)
    assert same(record, alone)
    assert record.usage is not None
    assert record.usage.evaluations == 0
    assert str(record.usage).endswith("for 4 workers, so one at a time")


def test_a_journal_repeats_a_run(tmp_path: Path, workers: Shuffling) -> None:
    """Its evaluations come in the same order; a few are made again to check the model."""
    problem, budget, journal = Slow(fit(30)), Budget(evaluations=30), tmp_path / "journal"
    first, again = (
        minimize(BRACKETS, problem, budget, seed=1, workers=workers, journal=journal)
        for _ in range(2)
    )
    assert first.error is None
    assert first.usage is not None
    assert first.usage.at_a_time == 4
    assert again.usage is not None
    assert again.usage.evaluations < 10 < again.usage.known
    assert same(first, again)


def test_a_resumed_run_has_as_many_evaluations_at_a_time() -> None:
    assert Oracle(fit(), Budget(), meter=Meter(at_a_time=AT_A_TIME)).workers.count == AT_A_TIME


def test_evaluations_in_progress_begin_again(workers: Shuffling) -> None:
    """A run that is cut twice and resumed with workers."""
    alone = minimize(MIHOGN(), Outside(fit()), seed=1)
    checkpoint = None
    for budget in (Budget(evaluations=7), Budget(evaluations=50), None):
        record = minimize(
            AsynchronousMIHOGN(), Outside(fit()), budget, 1, checkpoint=checkpoint,
            workers=workers, evaluation_limit=LIMIT,
        )  # fmt: skip
        checkpoint = pickle.loads(pickle.dumps(record.checkpoint))
    assert record.outcome is Outcome.CONVERGED, record.error
    assert record.loss == pytest.approx(alone.loss, rel=1e-9)


@pytest.mark.usefixtures("several")
@pytest.mark.parametrize("says_rows", [True, False])
def test_brackets_at_a_time_are_resumed_wherever_they_were_cut(says_rows: bool) -> None:
    problem = Outside(fit(), says_rows)
    whole = minimize(BRACKETS, problem, seed=2)
    assert whole.outcome in (Outcome.CONVERGED, Outcome.BRACKETS), whole.error
    assert not same(whole, minimize(MIHOGN(max_brackets=12), problem, seed=2)), (
        "or this tests nothing"
    )
    cut, evaluations = None, 0
    while cut is None or cut.outcome in (Outcome.BUDGET, Outcome.NO_FINITE_VALUE):
        evaluations += 4
        checkpoint = None if cut is None else pickle.loads(pickle.dumps(cut.checkpoint))
        budget = Budget(evaluations=evaluations)
        cut = minimize(BRACKETS, problem, budget, 2, checkpoint=checkpoint)
        assert cut.evaluations <= evaluations
    assert cut.trace.loss == whole.trace.loss
    assert cut.evaluations == pytest.approx(whole.evaluations, rel=1e-12)
    assert cut.descents == whole.descents


@pytest.mark.usefixtures("several")
def test_brackets_at_a_time_find_what_one_after_the_other_do() -> None:
    """To the digits in which a descent ends, with a doubtful optimum's evidence from both."""
    for seed in range(3):
        alone = minimize(MIHOGN(), Outside(fit()), seed=seed)
        several = minimize(AsynchronousMIHOGN(), Outside(fit()), seed=seed)
        assert several.outcome is alone.outcome is Outcome.CONVERGED, several.error
        assert several.loss == pytest.approx(alone.loss, rel=1e-9)


@pytest.mark.usefixtures("several")
def test_a_bracket_that_goes_on_leaves_open_whether_the_next_is_a_challenge(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only its end says so: what it knew when it began is old by then."""
    step, close = AsynchronousMIHOGN.step, MIHOGN._close
    flags, closed = [], []

    def noting(method: MIHOGN, state: MIHOGNState, oracle: Oracle) -> None:
        close(method, state, oracle)
        closed.append(state.challenged)

    def stepping(method: AsynchronousMIHOGN, state: AsynchronousMIHOGNState, o: Oracle) -> None:
        step(method, state, o)
        flags.append((state.search.challenged, any(closed[-1:])))

    monkeypatch.setattr(MIHOGN, "_close", noting)
    monkeypatch.setattr(AsynchronousMIHOGN, "step", stepping)
    minimize(AsynchronousMIHOGN(), Outside(fit()), seed=0)
    assert any(closed), "or this tests nothing"
    assert [flag for flag, _ in flags] == [last for _, last in flags]


def test_a_challenge_of_an_optimum_is_none_of_a_better_one() -> None:
    oracle = Oracle(fit(), Budget())
    search = MIHOGN().start(oracle, np.random.default_rng(0))
    challenging = replace(search, challenging=True)
    challenging.learn(search)
    assert challenging.challenging
    search.best_found_after = 20.0
    challenging.learn(search)
    assert not challenging.challenging


def test_one_worker_has_one_bracket_at_a_time() -> None:
    for problem in (fit(), Outside(fit())):
        oracle, method = Oracle(problem, Budget()), AsynchronousMIHOGN(max_brackets=3)
        method.run(oracle, np.random.default_rng(4))
        reference = Oracle(problem, Budget())
        MIHOGN(max_brackets=3).run(reference, np.random.default_rng(4))
        assert oracle.evaluations == reference.evaluations
        assert oracle.trace.loss == reference.trace.loss
