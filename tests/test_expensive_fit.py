"""Fits of expensive models: workers, journals, and what an interrupt leaves."""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, lru_cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import j0

import miho
from miho.models import FunctionModel, function_calls
from miho.models.fingerprint import fingerprint
from miho.parallel import Evaluations, Journal, JournalError, open_pool, usage, worth

t = np.linspace(0, 2, 30)
y = 2 * np.exp(-1.5 * t) + 0.05 * np.random.default_rng(1).standard_normal(30)
BOX = {"a": (0, 5), "b": (0.01, 10)}
BUDGET = miho.Budget(evaluations=60)
CHECKED = 3
"""Evaluations of a journal that are made again before the others are used."""


class Counted:
    """A model that no formula can be traced through, and how often it was evaluated."""

    def __init__(self, on_call: Callable[[int], object] = lambda count: None) -> None:
        self.calls: list[int] = []
        self._on_call = on_call

    @property
    def model(self) -> FunctionModel:
        calls, on_call = self.calls, self._on_call

        def decay(t: Any, a: Any, b: Any) -> Any:
            a, b = float(a), float(b)
            calls.append(1)
            on_call(len(calls))
            return a * np.exp(-b * t)

        return FunctionModel(decay, batched=False, columns=("t",))


@pytest.fixture
def expensive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every evaluation counts as expensive, however long it takes."""
    monkeypatch.setattr(worth, "EXPENSIVE", 0.0)
    monkeypatch.setattr(usage, "LEAST", 0.0)


@pytest.mark.usefixtures("expensive")
def test_the_same_call_evaluates_nothing_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = miho.fit(Counted().model, t, y, BOX, budget=BUDGET)
    first, again = Counted(), Counted()
    one = miho.fit(first.model, t, y, BOX, budget=BUDGET, journal=tmp_path / "journal")
    two = miho.fit(again.model, t, y, BOX, budget=BUDGET, journal=tmp_path / "journal")
    assert len(first.calls) >= 60
    assert len(again.calls) == CHECKED
    assert plain.theta.tobytes() == one.theta.tobytes() == two.theta.tobytes()
    assert "evaluations of an earlier call" in capsys.readouterr().err


@pytest.mark.usefixtures("expensive")
def test_who_goes_on_calls_a_function_as_it_was_called_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Quick when it was tried, and known to be row by row, it has become expensive since."""
    x, calls = np.linspace(0, 2, 300), list[int]()
    measured = j0(2 * x) + 0.01 * np.sin(9 * x)

    def bessel(x: Any, a: Any, b: Any) -> Any:
        calls.append(x.size)
        return a * j0(b * x)

    def fitted(name: str) -> bytes:
        calls.clear()
        path = tmp_path / name
        return miho.fit(bessel, x, measured, BOX, budget=BUDGET, journal=path).run.tobytes()

    tried_from = partial(monkeypatch.setattr, function_calls, "is_expensive")
    tried_from(lambda *_: False)
    first = fitted("journal")
    assert min(calls) < x.size // 2
    tried_from(lambda *_: True)
    again = fitted("journal")
    assert len(calls) <= 6  # three for the smallest number of rows, and one for each other
    assert again == first
    fitted("another")
    assert set(calls[2:]) == {x.size}


@pytest.mark.usefixtures("expensive")
def test_other_bounds_use_a_journal_and_other_data_do_not(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    miho.fit(Counted().model, t, y, start={"a": 1, "b": 1}, journal=path)
    alone, known = Counted(), Counted()
    for counted, journal in ((alone, None), (known, path)):
        miho.fit(
            counted.model, t, y, {"a": (0, 9), "b": (0, 9)}, start={"a": 1, "b": 1}, journal=journal
        )
    assert len(known.calls) < len(alone.calls)
    with pytest.raises(JournalError, match="belongs to another problem, model or data"):
        miho.fit(Counted().model, t, y + 1, start={"a": 1, "b": 1}, journal=path)


@pytest.mark.usefixtures("expensive")
def test_a_descent_starts_from_the_best_of_what_another_method_evaluated(tmp_path: Path) -> None:
    path, searched, alone, descended = tmp_path / "journal", Counted(), Counted(), Counted()
    method = miho.optim.RandomSearch()
    search = miho.fit(searched.model, t, y, BOX, method=method, budget=BUDGET, journal=path)
    best = search.problem.space.names
    values = dict(zip(best, search.run.tolist(), strict=True))
    by_hand = miho.fit(alone.model, t, y, start=values)
    known = miho.fit(descended.model, t, y, BOX, start="journal", journal=path)
    assert known.run.tolist() == pytest.approx(by_hand.run.tolist(), rel=1e-6)
    assert len(descended.calls) < len(alone.calls)
    fixed = Counted()
    with pytest.raises(ValueError, match="journal has no configuration of decay within the bounds"):
        miho.fit(fixed.model, t, y, {"a": (0, 5)}, fixed={"b": 1.0}, start="journal", journal=path)
    with pytest.raises(ValueError, match="expected a file as journal as well"):
        miho.fit(fixed.model, t, y, BOX, start="journal")


@pytest.mark.usefixtures("expensive")
def test_an_interrupt_tells_what_is_kept_and_the_same_call_goes_on(tmp_path: Path) -> None:
    stop = [30]

    def interrupt(count: int) -> None:
        if count in stop:
            os.kill(os.getpid(), signal.SIGINT)

    first, again, path = Counted(interrupt), Counted(interrupt), tmp_path / "journal"
    with pytest.raises(KeyboardInterrupt, match="evaluations are kept in"):
        miho.fit(first.model, t, y, BOX, budget=BUDGET, journal=path)
    stop.clear()
    fit = miho.fit(again.model, t, y, BOX, budget=BUDGET, journal=path)
    plain = Counted()
    assert miho.fit(plain.model, t, y, BOX, budget=BUDGET).theta.tobytes() == fit.theta.tobytes()
    assert len(first.calls) == 30
    assert len(again.calls) <= len(plain.calls) - 30 + 1 + CHECKED


@pytest.mark.usefixtures("expensive")
def test_an_interrupt_without_a_journal_tells_of_it() -> None:
    def interrupt(count: int) -> None:
        if count == 30:
            os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.02)

    with pytest.raises(KeyboardInterrupt, match="with journal='FILE' none is lost"):
        miho.fit(Counted(interrupt).model, t, y, BOX, budget=BUDGET)
    with pytest.raises(KeyboardInterrupt, match=r"^the search was interrupted$"):
        miho.fit_many(Counted(interrupt).model, t, [y], BOX)  # takes no journal


@pytest.mark.usefixtures("expensive")
def test_priors_are_settled_within_one_journal(tmp_path: Path) -> None:
    space = {"a": {"low": 0, "high": 5, "prior": (2.0, 0.1)}, "b": (0.01, 10)}
    first, again = Counted(), Counted()
    one = miho.fit(first.model, t, y, space, budget=BUDGET, journal=tmp_path / "journal")
    two = miho.fit(again.model, t, y, space, budget=BUDGET, journal=tmp_path / "journal")
    assert len(first.calls) > 50
    assert len(again.calls) == CHECKED
    assert one.theta.tobytes() == two.theta.tobytes()


@pytest.mark.usefixtures("expensive")
def test_joint_fits_have_a_journal_too(tmp_path: Path) -> None:
    first, again = Counted(), Counted()
    results = [
        miho.fit_joint(
            {"one": (counted.model, t, y), "two": (counted.model, t, 2 * y)},
            BOX, local=["a"], budget=BUDGET, journal=tmp_path / "journal",
        ).theta.tobytes()
        for counted in (first, again)
    ]  # fmt: skip
    assert results[0] == results[1]
    assert len(first.calls) > 50
    assert len(again.calls) == CHECKED + 1  # of the second part


def test_workers_that_are_not_used_are_told_of(capsys: pytest.CaptureFixture[str]) -> None:
    alone = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, BOX, compiled=False)
    fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, BOX, compiled=False, workers=2)
    assert fit.theta.tobytes() == alone.theta.tobytes()
    said = capsys.readouterr().err
    assert re.fullmatch(r"miho: evaluations made here, .* each: too short for 2 workers\n", said)
    with pytest.raises(ValueError, match="workers is 0; expected a number of processes"):
        miho.fit(lambda t, a, b: a * np.exp(-b * t), t, y, BOX, compiled=False, workers=0)


@pytest.mark.parametrize("workers", [1, 3, "threads"])
def test_a_report_is_the_same_by_workers(
    workers: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("miho.parallel.blocks.WORTH_SENDING", 0.0)  # all is sent
    monkeypatch.setattr("miho.parallel.blocks.MOST", np.inf)
    frame = {"t": t, "y": y, "z": np.repeat([0.0, 1.0, 2.0], 10)}
    fit = miho.fit(lambda t, a, b: a * np.exp(-b * t), frame, "y", BOX, compiled=False)
    plain = fit.report(replicates=20)
    with ThreadPoolExecutor(3) as threads:
        shared = fit.report(replicates=20, workers=threads if workers == "threads" else workers)
    assert plain.replicates is not None
    assert shared.replicates is not None
    assert plain.replicates.tobytes() == shared.replicates.tobytes()
    assert plain.parameters.equals(shared.parameters)
    assert plain.left_out.equals(shared.left_out)
    for one, two in zip(plain.profiles, shared.profiles, strict=True):
        assert one is not None
        assert two is not None
        assert one.values.tobytes() == two.values.tobytes()
        assert one.tau.tobytes() == two.tau.tobytes()


def test_a_profile_whose_worker_is_lost_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("miho.parallel.blocks.MOST", np.inf)
    parent = os.getpid()

    def dies(t: Any, a: Any, b: Any) -> Any:
        a, b = float(a), float(b)
        if os.getpid() != parent:
            os._exit(1)
        return a * np.exp(-b * t)

    fit = miho.fit(FunctionModel(dies, batched=False, columns=("t",)), t, y, BOX, budget=BUDGET)
    report = fit.report(workers=2)
    assert report.profiles == (None, None)
    assert "profile intervals of a are left out: their worker was lost" in report.omitted[0]


def test_a_fingerprint_tells_code_and_constants_apart() -> None:
    def of(factor: float) -> Callable[[float], float]:
        return lambda x: factor * x

    def documented(x: float) -> float:
        """Twice."""
        return 2 * x  # it

    documented_otherwise = {}
    exec("def documented(x: float) -> float:\n    'Other words.'\n    return 2 * x",
         documented_otherwise)  # fmt: skip
    assert fingerprint(of(2.0)) == fingerprint(of(2.0))
    assert fingerprint(of(2.0)) != fingerprint(of(3.0))
    assert fingerprint(lambda x: 2 * x) != fingerprint(lambda x: 3 * x)
    assert fingerprint(documented) == fingerprint(documented_otherwise["documented"])
    assert fingerprint(np.arange(3)) != fingerprint(np.arange(4))


class Engine:
    """A model with a state: what it was called with, and where it writes its output."""

    def __init__(self) -> None:
        self.calls, self.output = 0, np.zeros(3)

    def __call__(self, a: float) -> float:
        self.calls += 1
        self.output[:] = a
        return a


def test_a_fingerprint_is_the_same_after_calls() -> None:
    engine, buffer = Engine(), np.zeros(3)

    def filled(a: float) -> float:
        buffer[:] = engine(a)
        return float(buffer.sum())

    before = fingerprint(filled), fingerprint(engine.__call__)
    filled(2.0)
    assert (fingerprint(filled), fingerprint(engine.__call__)) == before


class Simulator:
    """A model whose setting is one of an object."""

    def __init__(self, gain: float) -> None:
        self.gain = gain

    def output(self, t: Any, a: Any, b: Any) -> Any:
        return self.gain * a * np.exp(-b * t)


def through(helper: Any) -> Any:
    def decay(t: Any, a: Any, b: Any) -> Any:
        return helper(a) * np.exp(-b * t)

    return decay


def test_a_journal_tells_objects_classes_and_wrapped_helpers_apart() -> None:
    def once(a: Any) -> Any:
        return a

    def twice(a: Any) -> Any:
        return 2 * a

    same = fingerprint(Simulator(1.0).output)
    assert same == fingerprint(Simulator(1.0).output)
    assert same != fingerprint(Simulator(2.0).output)
    prints = [fingerprint(through(lru_cache(helper))) for helper in (once, twice)]
    assert prints[0] != prints[1]
    spaces = [fingerprint(through(SimpleNamespace(k=k))) for k in (1, 1, 2)]
    assert spaces[0] == spaces[1] != spaces[2]
    kinds = [type("Gain", (), {"__module__": __name__, "of": helper}) for helper in (once, twice)]
    assert fingerprint(through(kinds[0])) != fingerprint(through(kinds[1]))


def test_a_fingerprint_tells_members_of_classes_and_decorated_models_apart() -> None:
    def of(members: dict[str, Any]) -> str:
        return fingerprint(type("Gain", (), {"__module__": __name__, **members})())

    def once(a: Any) -> Any:
        return a

    def twice(a: Any) -> Any:
        return 2 * a

    assert of({"gain": 2.0}) == of({"gain": 2.0}) != of({"gain": 3.0})
    for kind in (staticmethod, property, cached_property):
        assert of({"gain": kind(once)}) == of({"gain": kind(once)}) != of({"gain": kind(twice)})
    for decorator in (lru_cache, Compiled):
        assert fingerprint(decorator(once)) == fingerprint(decorator(once))
        assert fingerprint(decorator(once)) != fingerprint(decorator(twice))


class Compiled:
    """A function as numba decorates it."""

    def __init__(self, function: Any) -> None:
        self.py_func = function

    def __call__(self, a: Any) -> Any:
        return self.py_func(a)


def test_a_search_that_failed_is_told_of(capsys: pytest.CaptureFixture[str]) -> None:
    class Failing(miho.optim.RandomSearch):
        def run(self, oracle: Any, rng: Any) -> None:
            oracle(oracle.space.decode(oracle.space.initial(5)))
            raise RuntimeError("out of ideas")

    miho.fit(Counted().model, t, y, BOX, method=Failing())
    assert "the search failed, its best is taken: RuntimeError: out of ideas" in (
        capsys.readouterr().err
    )


def test_a_limit_holds_for_the_first_call_as_well() -> None:
    """A model is not tried out where a call may hang."""
    parent, calls = os.getpid(), list[int]()

    def simulate(t: Any, a: Any, b: Any) -> Any:
        a, b = float(a), float(b)
        if os.getpid() == parent:
            calls.append(1)
        return a * np.exp(-b * t)

    fit = miho.fit(
        FunctionModel(simulate, columns=("t",)), t, y, BOX, budget=BUDGET, workers=2,
        evaluation_limit=60.0,
    )  # fmt: skip
    assert not calls
    assert fit.error < 0.1


def test_a_model_that_becomes_slow_is_sent_to_workers_and_written_down(tmp_path: Path) -> None:
    """It is fast below 0; so many seconds above it are far more than the machine may hesitate."""

    def wait(thetas: Any) -> Any:
        time.sleep(max(0.0, 0.05 * float((thetas > 0).any())))
        return thetas[:, 0]

    journal = Journal(tmp_path / "journal", SimpleNamespace(description="waits", called_as=()))
    with ThreadPoolExecutor(2) as threads, open_pool(threads) as pool:
        spread = Evaluations(pool, journal)
        task = spread.function("wait", wait)
        for k in range(20):
            task(np.array([[-1.0 - k]]))
        for k in range(10):
            task(np.array([[1.0 + k]]))
        assert spread.usage.evaluations >= 5
        assert len(journal) >= 5
        spread.close()
    journal.close()


def test_what_cannot_be_sent_ends_a_fit_in_one_line() -> None:
    lock = threading.Lock()

    def slow(t: Any, a: Any, b: Any) -> Any:
        with lock:
            time.sleep(0.02)
        return float(a) * np.exp(-float(b) * t)

    with pytest.raises(ValueError, match="cannot be sent to workers") as error:
        miho.fit(slow, t, y, BOX, workers=2, budget=BUDGET)
    assert "\n" not in str(error.value)


def test_want_of_memory_is_not_written_down_as_a_value_of_the_model(tmp_path: Path) -> None:
    def fail(thetas: Any) -> Any:
        time.sleep(0.02)
        raise MemoryError("no room")

    journal = Journal(tmp_path / "journal", SimpleNamespace(description="fails", called_as=()))
    task = Evaluations(None, journal).function("fail", fail)
    with pytest.raises(MemoryError, match="no room"):
        task(np.array([[1.0]]))
    assert not len(journal)
    journal.close()
