"""A journal gives no value of a model that has changed, however its numbers are written."""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import miho
from miho.models import FunctionModel
from miho.parallel import (
    Evaluations,
    Journal,
    JournalError,
    Pool,
    StaleJournalError,
    UncheckedJournalError,
    open_pool,
    usage,
    worth,
)
from miho.parallel.journal_check import _gap, _words
from miho.parallel.process_executor import HungError
from tests.parallel.changed_models import RANDOM, WAYS, search, t

PROBLEM = SimpleNamespace(description="problem", called_as=())


@pytest.fixture(autouse=True)
def expensive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every evaluation counts as expensive, however long it takes."""
    monkeypatch.setattr(worth, "EXPENSIVE", 0.0)
    monkeypatch.setattr(usage, "LEAST", 0.0)


@pytest.mark.parametrize("name", WAYS)
def test_a_number_that_changes_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same number is not, and values that cannot be compared are used with a word."""
    monkeypatch.setenv("MIHO_TEST_GAIN", "0")
    journal, make = tmp_path / "journal", WAYS[name]
    first = search(make(1.0, tmp_path), journal)
    assert search(make(1.0, tmp_path), journal) == first
    said = "two evaluations of one configuration differ"
    if name in RANDOM:
        search(make(2.0, tmp_path), journal)
        assert said in capsys.readouterr().err
        return
    assert said not in capsys.readouterr().err
    with pytest.raises(
        JournalError, match=r"belongs to another problem, model or data|has changed"
    ):
        search(make(2.0, tmp_path), journal)


class Growing:
    """A loss whose factor may change, and the rows that it was asked for."""

    def __init__(self, factor: float = 1.0, *, noisy: bool = False, limit: float = 9.0) -> None:
        self.factor, self.noisy, self.limit = factor, noisy, limit
        self.asked: list[float] = []

    def __call__(self, thetas: Any) -> Any:
        self.asked += thetas[:, 0].tolist()
        if (thetas > self.limit).any():
            raise ArithmeticError("too large")
        return self.factor * (thetas[:, 0] - 3) ** 2 + self.noisy * len(self.asked)


def values(
    path: Path, loss: Growing, rows: Sequence[float], pool: Any = None, task: str = "loss"
) -> list[float]:
    """Values of rows, each asked for by itself, in a journal that is opened for this."""
    with closing(Journal(path, PROBLEM)) as journal:
        evaluated = Evaluations(pool, journal).function(task, loss)
        return [float(evaluated(np.array([[row]]))[0]) for row in rows]


ROWS = [0.0, 1.0, 3.5, 5.0, 6.0, 7.0]


def test_the_best_the_worst_and_the_first_are_evaluated_again(tmp_path: Path) -> None:
    path, first, again = tmp_path / "journal", Growing(), Growing()
    before = values(path, first, ROWS)
    assert values(path, again, ROWS) == before
    assert again.asked == [3.5, 7.0, 0.0]


def test_a_row_without_a_value_is_among_them(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    values(path, Growing(), ROWS)
    with pytest.raises(ValueError, match="too large"):
        values(path, Growing(), [10.0])
    same = Growing()
    values(path, same, ROWS)
    assert same.asked == [3.5, 10.0, 7.0]
    raised = "ArithmeticError: too large"
    with pytest.raises(StaleJournalError, match=rf"at \(10\) it gave {raised}, now 49; name"):
        values(path, Growing(limit=99.0), ROWS)
    with pytest.raises(StaleJournalError, match=rf"it gave 0.25, now {raised}; name"):
        values(path, Growing(limit=2.0), ROWS)


def test_a_further_function_costs_one_evaluation(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    for task in ("loss", "part"):
        values(path, Growing(), ROWS, task=task)
    first, further, changed = Growing(), Growing(), Growing(2.0)
    with closing(Journal(path, PROBLEM)) as journal:
        evaluations = Evaluations(None, journal)
        for loss, task in ((first, "loss"), (further, "part")):
            evaluations.function(task, loss)(np.array([[1.0]]))
        assert (len(first.asked), further.asked) == (3, [3.5])
    with closing(Journal(path, PROBLEM)) as journal:
        evaluations = Evaluations(None, journal)
        evaluations.function("loss", first)(np.array([[1.0]]))
        with pytest.raises(StaleJournalError, match="has changed"):
            evaluations.function("part", changed)(np.array([[1.0]]))


def test_rounding_is_said_and_more_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "journal"
    before = values(path, Growing(), ROWS)
    assert values(path, Growing(1 + 1e-12), ROWS) == before
    assert "values differ by rounding errors, 1e-12 of the largest" in capsys.readouterr().err
    with pytest.raises(StaleJournalError, match=r"it gave 0.25, now 0.250000025; name"):
        values(path, Growing(1 + 1e-7), ROWS)


def test_a_perfect_fit_is_rounding(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its value is compared with those of the beginning."""
    path, rows = tmp_path / "journal", [1.0, 2.0, 2.5, 3 - 1e-14]
    before = values(path, Growing(), rows)

    class Rounded(Growing):
        more = 1e-15

        def __call__(self, thetas: Any) -> Any:
            return super().__call__(thetas) + self.more * (thetas[:, 0] == rows[-1])

    assert values(path, Rounded(), rows) == before
    assert "values differ by rounding" in capsys.readouterr().err
    changed = Rounded()
    changed.more = 1e-6
    with pytest.raises(StaleJournalError, match="has changed"):
        values(path, changed, rows)


def test_a_huge_value_hides_no_change(tmp_path: Path) -> None:
    path, rows = tmp_path / "journal", [1.0, 2.0, 2.5, 1e9]
    values(path, Growing(limit=1e10), rows)

    class Moved(Growing):
        def __call__(self, thetas: Any) -> Any:
            return super().__call__(thetas) + 1e-3

    with pytest.raises(StaleJournalError, match="has changed"):
        values(path, Moved(limit=1e10), rows)


def test_words_are_of_the_row_that_differs() -> None:
    before = np.array([[np.nan, np.inf], [1.0, -np.inf], [2.0, 3.0]])
    after = np.array([[np.nan, np.inf], [1.0, -np.inf], [2.0, 4.0]])
    assert _gap(before, after) == 0.25
    assert _words(before, after) == ("3 in row 3", "4")
    assert _words(before[:, 0], np.array([np.nan, np.nan, 2.0])) == ("1 in row 2", "nan")


def test_chance_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "journal"
    before = values(path, Growing(noisy=True), ROWS)
    assert values(path, Growing(noisy=True), ROWS) == before
    said = capsys.readouterr().err
    assert said.count("two evaluations of one configuration differ") == said.count("\n") == 1


def test_workers_make_the_evaluations_side_by_side(tmp_path: Path) -> None:
    """None ends before all three have begun."""
    path, together = tmp_path / "journal", threading.Barrier(3)
    before = values(path, Growing(), ROWS)

    class Waiting(Growing):
        def __call__(self, thetas: Any) -> Any:
            value = super().__call__(thetas)
            if len(self.asked) <= 3:
                together.wait(60)
            return value

    with ThreadPoolExecutor(3) as threads, open_pool(threads) as pool:
        assert values(path, Waiting(), ROWS, pool) == before
        with pytest.raises(StaleJournalError, match="has changed"):
            values(path, Waiting(2.0), ROWS, pool)


def test_a_machine_that_fails_is_no_changed_model(tmp_path: Path) -> None:
    path, broken = tmp_path / "journal", Growing()
    values(path, Growing(), ROWS)

    def missing(thetas: Any) -> Any:
        raise FileNotFoundError("no licence")

    with pytest.raises(StaleJournalError, match=r"now fails: FileNotFoundError: no lic") as raised:
        values(path, missing, ROWS)  # type: ignore[arg-type]
    assert isinstance(raised.value.error, UncheckedJournalError)
    assert values(path, broken, ROWS)


def test_a_failure_of_the_second_evaluation_is_no_chance(tmp_path: Path) -> None:
    path, changed = tmp_path / "journal", Growing(2.0)
    values(path, Growing(), ROWS)

    def once(thetas: Any) -> Any:
        if len(changed.asked) >= 3:
            raise FileNotFoundError("no licence")
        return changed(thetas)

    with pytest.raises(StaleJournalError, match="cannot be checked"):
        values(path, once, ROWS)  # type: ignore[arg-type]


def test_a_lowered_limit_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Stored values are used where their evaluations take longer than the limit of today."""
    path = tmp_path / "journal"
    before = values(path, Growing(), ROWS)
    with ThreadPoolExecutor(1) as threads, closing(Pool(threads, 1)) as pool:
        done = Future[Any]()
        done.set_exception(HungError("no end within 1 s", again=False))
        pool.share = lambda function: lambda argument: done  # type: ignore[method-assign]
        assert values(path, Growing(), ROWS, pool) == before
    assert "now take longer than evaluation_limit" in capsys.readouterr().err


def test_a_fit_uses_no_value_of_a_changed_model(tmp_path: Path) -> None:
    """Its message names the best configuration, and the journal stays as it is."""
    gain, path = [1.0], tmp_path / "journal"

    def line(t: Any, a: Any) -> Any:
        return gain[0] * float(a) * t

    def fitted(**settings: Any) -> float:
        model = FunctionModel(line, batched=False, columns=("t",))
        return miho.fit(model, t, 2 * t, {"a": (0, 4)}, journal=path, **settings).values["a"]

    assert fitted() == pytest.approx(2.0)
    content, gain[0] = path.read_bytes(), 2.0
    for start in ({"a": 1.0}, "journal", None):
        with pytest.raises(JournalError, match=r"at \(2\) it gave 2 .*, now 4; name another file"):
            fitted(start=start)
    assert path.read_bytes() == content


def test_a_model_that_writes_its_input_goes_on(tmp_path: Path) -> None:
    name, path = str(tmp_path / "input.json"), tmp_path / "journal"

    def simulate(t: Any, a: Any) -> Any:
        Path(name).write_text(json.dumps({"a": float(a)}))
        return json.loads(Path(name).read_text())["a"] * t

    first = search(simulate, path)
    assert search(simulate, path) == first
