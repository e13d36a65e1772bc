"""What is said of workers, and from when on an evaluation is worth one."""

from __future__ import annotations

import json

import pytest

from miho.parallel import usage as module
from miho.parallel.usage import AGAIN, ALONE, IN_A_ROW, Usage, Worth


@pytest.mark.parametrize(
    ("usage", "text"),
    [
        (Usage(1, here=9, each=1e-6), "evaluations made here, 1 µs each"),
        (Usage(4, here=9, each=1e-6), "evaluations made here, 1 µs each: too short for 4 workers"),
        (Usage(4, here=1, each=0.5), "evaluations made here, 500 ms each: too few for 4 workers"),
        (
            Usage(32, here=9, each=2e-4, at_a_time=1),
            "evaluations made here, 200 µs each: too short for 32 workers, so one at a time",
        ),
        (
            Usage(8, evaluations=3669, seconds=40.0, here=3, each=0.1, at_a_time=8, wall=10.0),
            "3,669 evaluations by 8 workers, 100 ms each, which were busy 50% of the time",
        ),
        (
            Usage(1, evaluations=2, seconds=2.0, known=7, each=1.0, wall=2.0),
            "7 evaluations known from before; 2 evaluations by a worker, 1 s each, which was busy "
            "100% of the time",
        ),
        (Usage(4, known=7), "7 evaluations known from before"),
    ],
)
def test_a_line_says_who_made_the_evaluations(usage: Usage, text: str) -> None:
    assert str(usage) == text
    assert Usage(**json.loads(json.dumps(usage.stored))) == usage


def test_the_time_after_a_run_is_not_that_of_its_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [5.0]
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    usage = Usage(2, evaluations=4, seconds=6.0)
    usage.begin()
    now[0] = 9.0
    usage.end()
    now[0] = 1000.0
    assert usage.efficiency == 6.0 / (2 * 4.0)


def lengths(*seconds: float, raised: bool = False) -> Worth:
    """What is known after evaluations of these seconds."""
    worth = Worth(Usage(4), limited=False)
    for each in seconds:
        worth.count(each, 1, here=True, raised=raised)
    return worth


def test_an_evaluation_is_worth_a_worker_of_its_own_where_several_in_a_row_are_long() -> None:
    long, short = 2 * ALONE, ALONE / 2
    assert not lengths().alone
    assert not lengths(long).alone
    assert lengths(*[long] * IN_A_ROW).alone
    # The first one loaded something; later some were held up by another program.
    assert not lengths(long, short, *[long] * IN_A_ROW).alone
    assert lengths(long, short, *[long] * (IN_A_ROW + AGAIN)).alone
    # A configuration that is rejected at once says nothing of the others.
    assert not lengths(*[long] * IN_A_ROW, raised=True).alone
    known = Worth(Usage(4), limited=False)
    for _ in range(IN_A_ROW):
        known.remember()
    assert known.alone
    assert Worth(Usage(4), limited=True).alone
