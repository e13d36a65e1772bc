"""The pace of a run: of late, without what it knew from before."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from miho.optim import Budget
from miho.optim.pace import LOGGED, Pace
from miho.parallel.usage import Usage


def oracle(evaluations: float, seconds: float, usage: Usage | None = None) -> Any:
    meter = SimpleNamespace(seconds=seconds)
    return SimpleNamespace(
        evaluations=evaluations, meter=meter, workers=SimpleNamespace(usage=usage, busy=3)
    )


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time, to be set."""
    time = [0.0]
    monkeypatch.setattr("miho.optim.pace.time.monotonic", lambda: time[0])
    return time


def test_it_is_of_the_last_seconds(clock: list[float]) -> None:
    pace = Pace(Budget(evaluations=400))
    for second in range(40):
        clock[0] = float(second)
        pace.update(oracle(second if second < 20 else 20 + 5 * (second - 20), second))
    assert pace.rate == pytest.approx(5.0)
    assert pace.words(oracle(115, 39.0)) == ", 5/s, at most 57 s left"
    assert Pace(Budget()).words(oracle(0, 0.0)) == ""


def test_what_was_known_is_no_pace(clock: list[float]) -> None:
    pace = Pace(Budget())
    for known in (50, 100):
        pace.update(oracle(known, 0.1, Usage(4, known=known)))
        clock[0] += 0.1
    assert not pace.rate
    pace.update(oracle(101, 1.0, Usage(4, known=100)))
    assert pace.rate == pytest.approx(10.0)


def test_workers_and_their_efficiency_are_told(clock: list[float]) -> None:
    usage = Usage(4, evaluations=10, seconds=1e9)
    usage.begin()
    assert ", 3 of 4 workers busy (100% of their time)" in Pace(Budget()).words(
        oracle(10, 1.0, usage)
    )


def test_a_line_is_due_each_ten_seconds(clock: list[float]) -> None:
    pace = Pace(Budget())
    assert not pace.line_due()
    clock[0] = LOGGED
    assert pace.line_due()
    assert not pace.line_due()
