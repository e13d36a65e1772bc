"""Searches that go on as evaluations come: what they decide, and that it can be repeated."""

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
    Arrivals,
    AsynchronousMIHO,
    AsynchronousMIHOGN,
    Budget,
    BudgetExhausted,
    Optimizer,
    Oracle,
    Outcome,
    Parameter,
    Problem,
    RunRecord,
    Space,
    hyperband_table,
    minimize,
)
from miho.optim.asynchronous_miho import AsynchronousRung
from miho.optim.asynchronous_miho_gn import AsynchronousMIHOGNState
from miho.optim.miho_gn_state import MIHOGNState
from miho.optim.oracle import Kind
from miho.optim.schedule import Rung
from miho.parallel import Ahead, worth
from tests.optim.decays import Outside, fit

Array = NDArray[np.float64]

LIMIT = 600.0
"""Seconds for an evaluation: with a limit workers make all of them, however short they are."""
METHOD = AsynchronousMIHO(R=27, eta=3)


class Valley(Problem):
    """A curved valley of two parameters, whose evaluations take `seconds`."""

    name = "valley"
    space = Space((Parameter("a", "-", -2.0, 2.0), Parameter("b", "-", -1.0, 3.0)))

    def __init__(self, seconds: float = 0.0) -> None:
        self.seconds = seconds

    def loss(self, thetas: Array, fidelity: float = 1.0) -> Array:
        time.sleep(self.seconds)
        a, b = thetas.T
        return np.asarray((1 - a) ** 2 + 100 * (b - a * a) ** 2)


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


def same(first: RunRecord, second: RunRecord) -> bool:
    """Whether two runs are the same but for their seconds."""
    a, b = first.trace, second.trace
    return (
        a.evaluations == b.evaluations
        and a.loss == b.loss
        and np.array_equal(np.array(a.theta), np.array(b.theta))
        and first.evaluations == second.evaluations
    )


def test_a_configuration_is_promoted_among_the_best_third_of_those_seen() -> None:
    rung = AsynchronousRung(Rung(1, 0, 8, 1), np.empty((1, 2)))

    def promoted_after(loss: float) -> list[float]:
        rung.add(loss, np.empty(2))
        promotions = []
        while rung.promotes(3, 3):
            promotions.append(rung.promote()[0])
        return promotions

    assert [promoted_after(loss) for loss in (5.0, 3.0, 4.0)] == [[], [], [3.0]]
    # The second of six is the best of those that are left, though the best of all came too late.
    assert [promoted_after(loss) for loss in (2.0, 1.0, 9.0)] == [[], [], [1.0]]
    # All were seen: as many as the next rung has.
    assert [promoted_after(loss) for loss in (8.0, 7.0)] == [[], [2.0]]
    assert rung.complete


def test_one_worker_goes_as_deep_as_it_can_before_it_begins_anew() -> None:
    """The first bracket of R = 9 and eta = 3: 9 configurations for 1 mutation, 3 for 3, 1 for 9."""
    method, oracle = AsynchronousMIHO(R=9, eta=3), Oracle(Valley(), Budget())
    state = method.start(oracle, np.random.default_rng(1))
    method.step(state, oracle)
    (bracket,), ends = state.brackets, [(0, 0, 0)]
    while not bracket.rungs[-1].complete:
        method.step(state, oracle)
        seen = tuple(rung.seen for rung in bracket.rungs)
        if seen != ends[-1]:
            ends.append(seen)
    assert ends == [
        (0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (3, 1, 0), (4, 1, 0), (5, 1, 0), (6, 1, 0),
        (6, 2, 0), (7, 2, 0), (8, 2, 0), (9, 2, 0), (9, 3, 0), (9, 3, 1),
    ]  # fmt: skip
    assert oracle.evaluations == 9 * 2 + 3 * 3 + 9


@pytest.mark.parametrize("workers_of_run", [1, 3, 40])
def test_rungs_have_as_many_configurations_as_in_the_table(workers_of_run: int) -> None:
    table = hyperband_table(27, 3)
    expected = sum(rung.n * (rung.mutations + (rung.j == 0)) for rung in table)
    record = minimize(METHOD, Valley(), replay=Arrivals(workers_of_run))
    assert record.outcome is Outcome.CONVERGED, record.error
    assert record.evaluations == expected


def test_a_run_is_repeated_by_its_arrivals_with_any_workers(workers: Shuffling) -> None:
    budget = Budget(evaluations=300)
    record = minimize(METHOD, Valley(), budget, workers=workers, evaluation_limit=LIMIT)
    assert record.error is None
    assert record.evaluations == 300, "the budget is exact"
    assert record.arrivals is not None
    assert record.arrivals.workers == 4
    assert len(set(record.arrivals.positions)) > 1, "or this tests nothing"
    assert record.usage is not None
    assert record.usage.evaluations >= 300
    alone = minimize(METHOD, Valley(), budget, replay=record.arrivals)
    assert same(alone, record)
    assert alone.arrivals == record.arrivals
    assert not same(minimize(METHOD, Valley(), budget), record)
    with Shuffling(2, 5) as others:
        again = minimize(
            METHOD, Valley(), budget, workers=others, evaluation_limit=LIMIT,
            replay=record.arrivals,
        )  # fmt: skip
    assert same(again, record)


def test_a_run_is_resumed_wherever_it_was_cut() -> None:
    rng = np.random.default_rng(3)
    replay = Arrivals(3, rng.integers(0, 3, 150).tolist())
    whole = minimize(METHOD, Valley(), Budget(evaluations=120), replay=replay)
    cut = None
    for evaluations in range(1, 121):
        checkpoint = None if cut is None else pickle.loads(pickle.dumps(cut.checkpoint))
        budget = Budget(evaluations=evaluations)
        cut = minimize(METHOD, Valley(), budget, checkpoint=checkpoint, replay=replay)
        assert cut.evaluations == evaluations
    assert cut is not None
    assert same(cut, whole)
    assert cut.arrivals == whole.arrivals


def test_what_is_under_way_is_begun_again(workers: Shuffling) -> None:
    """A run that workers make, cut and resumed with others: the arrivals are those of both."""
    checkpoint = None
    for evaluations in (7, 50, 120):
        record = minimize(
            METHOD, Valley(), Budget(evaluations=evaluations), checkpoint=checkpoint,
            workers=workers, evaluation_limit=LIMIT,
        )  # fmt: skip
        assert record.error is None
        checkpoint = pickle.loads(pickle.dumps(record.checkpoint))
    assert record.arrivals is not None
    budget = Budget(evaluations=120)
    assert same(minimize(METHOD, Valley(), budget, replay=record.arrivals), record)


def test_a_journal_has_a_run_made_again_as_it_was(tmp_path: Path, workers: Shuffling) -> None:
    """None of its evaluations is made twice, and they come in the same order."""
    budget, journal = Budget(evaluations=20), tmp_path / "journal"
    first = minimize(METHOD, Valley(0.011), budget, workers=workers, journal=journal)
    again = minimize(METHOD, Valley(0.011), budget, workers=workers, journal=journal)
    assert first.error is None
    assert again.usage is not None
    assert again.usage.known == 20
    assert same(first, again)


def test_arrivals_of_another_run_are_refused() -> None:
    record = minimize(METHOD, Valley(), replay=Arrivals(2, [0, 1, 2]))
    assert record.outcome is Outcome.FAILED
    assert record.error is not None
    assert "replay: arrival 2 is at position 2 of 2" in record.error


def test_a_run_has_as_many_chains_as_it_began_with() -> None:
    oracle = Oracle(Valley(), Budget(evaluations=5), replay=Arrivals(6))
    with pytest.raises(BudgetExhausted):
        METHOD.run(oracle, np.random.default_rng(1))
    resumed = Oracle(Valley(), Budget(evaluations=9), meter=oracle.meter)
    with pytest.raises(BudgetExhausted):
        METHOD.resume(resumed, oracle.state)
    assert len(resumed.state.chains) == 6


@pytest.mark.parametrize("says_rows", [True, False])
@pytest.mark.parametrize("linear", [(), ("a", "c")], ids=["stepping", "projecting"])
def test_rounds_of_candidates_are_the_same_with_any_workers(
    says_rows: bool, linear: tuple[str, ...], workers: Shuffling, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A round has more than one evaluation of a kind begun; candidates wait for each other."""
    begun: list[tuple[str, int]] = []
    ahead = Oracle.ahead

    def count(oracle: Oracle, thetas: Array, fidelity: float = 1.0, kind: Kind = "loss") -> Ahead:
        begun.append((kind, len(thetas)))
        return ahead(oracle, thetas, fidelity, kind)

    problem, method = Outside(fit(linear=linear), says_rows), MIHOGN(brackets=3, base=8.0)
    alone = minimize(method, problem, seed=1)
    monkeypatch.setattr(Oracle, "ahead", count)
    spread = minimize(method, problem, seed=1, workers=workers, evaluation_limit=LIMIT)
    assert spread.error is None
    assert same(alone, spread)
    assert max(n for kind, n in begun if kind == "jacobian") > 1
    assert max(n for kind, n in begun if kind == "residuals") > 1


BRACKETS = AsynchronousMIHOGN(brackets=12)


@pytest.mark.parametrize("method", [METHOD, BRACKETS], ids=["miho", "miho_gn"])
def test_a_cheap_loss_has_one_evaluation_at_a_time_and_says_so(
    method: Optimizer, workers: Shuffling, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is sent, and the run is that without workers to the last bit."""
    monkeypatch.setattr(worth, "ALONE", math.inf)  # however busy the machine is
    monkeypatch.setattr(worth, "WORTH_SENDING", math.inf)
    problem, budget = Outside(fit()), Budget(evaluations=200)
    alone = minimize(method, problem, budget, seed=1)
    record = minimize(method, problem, budget, seed=1, workers=workers)
    assert same(record, alone)
    assert record.arrivals is None
    assert record.usage is not None
    assert record.usage.evaluations == 0
    assert str(record.usage).endswith("for 4 workers, so one at a time")


def test_chains_begin_when_two_evaluations_in_a_row_were_long(workers: Shuffling) -> None:
    budget = Budget(evaluations=40)
    record = minimize(METHOD, Valley(0.011), budget, workers=workers)
    assert record.error is None
    assert record.arrivals is not None
    assert (record.arrivals.alone, record.arrivals.workers) == (2, 4)
    assert record.usage is not None
    assert record.usage.here == 2
    assert record.usage.at_a_time == 4
    assert same(minimize(METHOD, Valley(), budget, replay=record.arrivals), record)
    # Arrivals of a run whose chains all began at its start decide otherwise.
    early = replace(record.arrivals, alone=0)
    assert not same(minimize(METHOD, Valley(), budget, replay=early), record)


def test_a_run_that_was_alone_may_go_on_with_several(workers: Shuffling) -> None:
    """It repeats itself by its arrivals, and so does one that is cut before chains begin."""
    first = minimize(METHOD, Valley(), Budget(evaluations=30))
    budget = Budget(evaluations=90)
    record = minimize(
        METHOD, Valley(), budget, checkpoint=first.checkpoint, workers=workers,
        evaluation_limit=LIMIT,
    )  # fmt: skip
    assert record.arrivals is not None
    assert record.arrivals.alone == 31, "the evaluation at which it was cut is made first"
    assert same(minimize(METHOD, Valley(), budget, replay=record.arrivals), record)


def test_brackets_at_a_time_are_repeated_by_their_arrivals(workers: Shuffling) -> None:
    problem = Outside(fit())
    record = minimize(BRACKETS, problem, seed=1, workers=workers, evaluation_limit=LIMIT)
    assert record.outcome in (Outcome.CONVERGED, Outcome.BRACKETS), record.error
    assert record.arrivals is not None
    assert len(set(record.arrivals.positions)) > 1, "or this tests nothing"
    alone = minimize(BRACKETS, problem, seed=1, replay=record.arrivals)
    assert same(alone, record)
    assert alone.descents == record.descents


@pytest.mark.parametrize("says_rows", [True, False])
def test_brackets_at_a_time_are_resumed_wherever_they_were_cut(says_rows: bool) -> None:
    problem = Outside(fit(), says_rows)
    replay = Arrivals(6, [1, 0, 1, 1, 0] * 8)
    whole = minimize(BRACKETS, problem, seed=2, replay=replay)
    assert whole.outcome in (Outcome.CONVERGED, Outcome.BRACKETS), whole.error
    assert whole.arrivals is not None
    assert len(whole.arrivals.positions) > 40
    cut, evaluations = None, 0
    while cut is None or cut.outcome in (Outcome.BUDGET, Outcome.NO_FINITE_VALUE):
        evaluations += 4
        checkpoint = None if cut is None else pickle.loads(pickle.dumps(cut.checkpoint))
        budget = Budget(evaluations=evaluations)
        cut = minimize(BRACKETS, problem, budget, 2, checkpoint=checkpoint, replay=replay)
        assert cut.evaluations <= evaluations
    assert cut.trace.loss == whole.trace.loss
    assert cut.evaluations == pytest.approx(whole.evaluations, rel=1e-12)
    assert cut.arrivals == whole.arrivals
    assert cut.descents == whole.descents


def test_brackets_at_a_time_find_what_one_after_the_other_do() -> None:
    """To the digits in which a descent ends, with a doubtful optimum's evidence from both."""
    for seed in range(3):
        alone = minimize(MIHOGN(), Outside(fit()), seed=seed)
        several = minimize(AsynchronousMIHOGN(), Outside(fit()), seed=seed, replay=Arrivals(8))
        assert several.outcome is alone.outcome is Outcome.CONVERGED, several.error
        assert several.loss == pytest.approx(alone.loss, rel=1e-9)


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
    minimize(AsynchronousMIHOGN(), Outside(fit()), seed=0, replay=Arrivals(8))
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
        oracle, method = Oracle(problem, Budget()), AsynchronousMIHOGN(brackets=3)
        method.run(oracle, np.random.default_rng(4))
        reference = Oracle(problem, Budget())
        MIHOGN(brackets=3).run(reference, np.random.default_rng(4))
        assert oracle.evaluations == reference.evaluations
        assert oracle.trace.loss == reference.trace.loss
