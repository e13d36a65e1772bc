"""Rows of the fault table: each is a test marked `fault`, done in a process of its own.

    @pytest.mark.fault(row="R1", fault="SIGKILL of a sweep, rerun", promise="0 runs lost")
    def test_kills(tmp_path: Path, measured: Figures, thorough: bool) -> None: ...

A row says what it measured before it judges. It may fork, set clocks, kill its children and end as
it likes: all that it started ends with its process. `experiments.faults` prints the table.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing import connection
from typing import Any

import pytest

from experiments.diagnosis.machine import BUSY_CORES
from tests.faults.commands import descendants

LIMIT_SECONDS = 240.0
STOP_SECONDS = 5.0
"""How long the process of a row may take to end by itself once the row is done."""
PRELOADED = ["tests.faults.commands"]
"""What the server of the rows' processes imports once, so that no row has to."""


@dataclass
class Figures:
    """What a row measured, in words; a row that fails before is broken, and not missed."""

    text: str = ""

    def __call__(self, text: str) -> None:
        self.text = text


@pytest.fixture
def measured() -> Figures:
    """Where a row leaves its figures."""
    return Figures()


@pytest.fixture
def thorough(request: pytest.FixtureRequest) -> bool:
    """Whether a row does its fault as often as the table asks; less often in the test suite."""
    return bool(request.config.getoption("--thorough"))


def skip_if_busy(busy: float | None) -> None:
    """Leave a row unjudged where other work keeps so many cores busy, or nobody knows how many."""
    if busy is None:
        pytest.skip("an unknown load")
    if busy > BUSY_CORES:
        pytest.skip(f"{busy:.2f} cores busy with other work")


def at_most(allowed: float, figure: float, busy: float | None) -> None:
    """Judge a figure that other work on the machine can only make larger."""
    if figure > allowed:
        skip_if_busy(busy)
    assert figure <= allowed


def pytest_itemcollected(item: pytest.Item) -> None:
    """Reports carry what the table shows of a row, from other processes as well."""
    for marker in item.iter_markers("fault"):
        item.user_properties.append(("fault", dict(marker.kwargs)))


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Do a row in a process of its own; other tests as pytest does."""
    if pyfuncitem.get_closest_marker("fault") is None:
        return None
    arguments = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    with started(pyfuncitem.function, arguments) as (_, answer):
        if not answer.poll(LIMIT_SECONDS):
            pytest.fail(f"stopped after {LIMIT_SECONDS:g} s", pytrace=False)
        try:
            figures, outcome, why = answer.recv()
        except EOFError:
            pytest.fail("the process of the row ended without an answer", pytrace=False)
    text = f"not judged: {why}; {figures}" if outcome == "skipped" else figures
    if text:
        pyfuncitem.user_properties.append(("measured", text))
    if outcome == "skipped":
        pytest.skip(text)
    if outcome == "failed":
        pytest.fail(f"{why}measured: {text}" if text else why.strip(), pytrace=False)
    return True


@contextlib.contextmanager
def started(row: Callable[..., None], arguments: dict[str, Any]) -> Iterator[tuple[Any, Any]]:
    """The process of a row, which ends with the context like all it started, and its pipe."""
    context = multiprocessing.get_context("forkserver")  # no thread of pytest's is copied
    context.set_forkserver_preload(PRELOADED)
    answer, sender = context.Pipe(duplex=False)
    process = context.Process(target=_do, args=(row, arguments, sender))
    process.start()
    sender.close()
    answered = False
    try:
        yield process, answer
        answered = True
    finally:
        family = descendants(process.pid or 0)
        process.join(STOP_SECONDS if answered else 0.0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid or 0, signal.SIGKILL)
        process.kill()
        for pid in family:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.join(STOP_SECONDS)
        answer.close()


def _do(row: Callable[..., None], arguments: dict[str, Any], sender: connection.Connection) -> None:
    """In the process of the row: lead a group of its own, so that all of it can be ended."""
    os.setsid()
    outcome, why = "passed", ""
    try:
        row(**arguments)
    except pytest.skip.Exception as busy:
        outcome, why = "skipped", str(busy)
    except BaseException:  # noqa: BLE001 -- whatever ends it is its answer
        outcome, why = "failed", traceback.format_exc()
    sender.send((arguments["measured"].text, outcome, why))
