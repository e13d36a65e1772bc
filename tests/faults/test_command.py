"""The faults command: every row on its own, within its time, and a table at the end."""

import os
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from experiments.diagnosis.fault_table import ROWS, FaultTable, as_text
from experiments.faults import faults
from tests.faults.conftest import Figures, at_most, started

FILES = [path.read_text() for path in sorted(Path(__file__).parent.glob("test_*.py"))]
MARKS = [mark for text in FILES for mark in re.findall(r"(?s)@pytest.mark.fault\(.*?\ndef", text)]
"""The marks of all rows, with what follows up to the test."""


def numbers(texts: Sequence[str]) -> list[str]:
    return [row for text in texts for row in re.findall(r'^\s*row="(R\d+)"', text, re.MULTILINE)]


def test_every_row_is_one_test() -> None:
    rows = numbers(MARKS)
    assert len(rows) == len(set(rows))
    assert sorted(rows, key=ROWS.index) == ROWS


def test_rows_that_judge_seconds_are_alone() -> None:
    timed = [part for text in FILES for part in text.split("\n\n\n") if "pytest.mark.timed" in part]
    assert sorted(numbers(timed), key=ROWS.index) == ["R10", "R11", "R12"]


def test_seconds_are_not_judged_while_other_work_keeps_cores_busy() -> None:
    at_most(15.0, 14.0, busy=3.6)
    for busy in (3.6, None):
        with pytest.raises(pytest.skip.Exception, match=r"busy with other work|an unknown load"):
            at_most(15.0, 19.0, busy)
    with pytest.raises(AssertionError):
        at_most(15.0, 19.0, busy=0.0)
    timed = [part for text in FILES for part in text.split("\n\n\n") if "pytest.mark.timed" in part]
    rows = [part for part in timed if numbers([part])]
    assert all("at_most(" in part or "skip_if_busy(" in part for part in rows)


def test_quick_rows() -> None:
    assert sorted(numbers([mark for mark in MARKS if "quick=True" in mark])) == [
        "R14", "R15", "R18", "R9",
    ]  # fmt: skip


def sleep(measured: object) -> None:
    time.sleep(1000)


@pytest.mark.slow
def test_a_row_is_stopped_at_its_limit() -> None:
    began = time.perf_counter()
    with started(sleep, {"measured": None}) as (process, answer):
        assert not answer.poll(0.2)
    assert process.exitcode
    assert time.perf_counter() - began < 30


def pid(measured: Figures) -> None:
    measured(str(os.getpid()))


def miss(measured: Figures) -> None:
    measured("figures")
    raise AssertionError("too slow")


def leave(measured: Figures) -> None:
    pytest.skip("2 cores busy")


@pytest.mark.slow
def test_a_row_answers_from_a_process_of_its_own() -> None:
    answers = []
    for row in (pid, miss, leave):
        with started(row, {"measured": Figures()}) as (_, answer):
            assert answer.poll(60)
            answers.append(answer.recv())
    (number, passed, _), (figures, failed, why), (_, skipped, busy) = answers
    assert number != str(os.getpid())
    assert (passed, failed, skipped) == ("passed", "failed", "skipped")
    assert figures == "figures"
    assert why.endswith("AssertionError: too slow\n")
    assert busy == "2 cores busy"


def test_rows_that_judge_seconds_come_first_and_one_by_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[list[str]] = []
    monkeypatch.setattr(pytest, "main", lambda arguments, plugins: calls.append(arguments))
    assert faults(["R7", "R10"]) == 3, "nothing was run"
    selections = [(call[call.index("-n") + 1], call[call.index("-m") + 1]) for call in calls]
    rows = "(fault(row='R7') or fault(row='R10'))"
    assert selections == [("0", f"{rows} and timed"), ("2", f"{rows} and not timed")]


def report(row: str, outcome: str, measured: str) -> pytest.TestReport:
    properties: list[tuple[str, Any]] = [
        ("fault", {"row": row, "fault": "a fault | a pipe", "promise": "a goal"}),
        *([("measured", measured)] if measured else []),
    ]
    place = ("tests/faults/test_x.py", 1, "test_x")
    return pytest.TestReport(
        "test_x", place, {}, outcome, "Traceback\nOSError: gone", "call", user_properties=properties
    )  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("outcome", "measured", "verdict", "code"),
    [
        ("passed", "a long measure " * 10, "met", 0),
        ("skipped", "not judged: busy; figures", "not judged", 0),
        ("failed", "figures", "MISSED", 3),
        ("failed", "", "BROKEN", 3),
        ("", "", "missing", 3),
    ],
)
def test_exit_codes_and_output(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    outcome: str,
    measured: str,
    verdict: str,
    code: int,
) -> None:
    def run(arguments: list[str], plugins: list[FaultTable]) -> None:
        if outcome and "not timed" in arguments[-3]:
            for row in ("R18", "R7"):
                plugins[0].pytest_runtest_logreport(report(row, outcome, measured))

    monkeypatch.setattr(pytest, "main", run)
    page = tmp_path / "faults.md"
    assert faults(["r18", "R7", "--output", str(page)]) == code
    lines = page.read_text().splitlines()
    assert lines[0] == "| row | fault | goal | measured | verdict | seconds |"
    assert [line.split()[1] for line in lines[2:]] == ["R7", "R18"], "in order, however they end"
    assert all(f"| {verdict} |" in line for line in lines[2:])
    if outcome:
        assert r"a fault \| a pipe" in lines[2]
    if verdict == "BROKEN":
        assert "OSError: gone" in lines[2]
    printed = capsys.readouterr().out.splitlines()
    counts = {"met": "2 of 2 rows met in", "not judged": "0 of 2 rows met, 2 not judged in"}
    assert printed[-1].startswith(counts.get(verdict, "0 of 2 rows met in"))


def test_the_table_is_aligned() -> None:
    table = FaultTable()
    for row in ("R1", "R2"):
        table.pytest_runtest_logreport(report(row, "passed", "a long measure " * 10))
    lines = as_text(table.frame(["R1", "R2"])).splitlines()
    assert len({line.index("a goal") for line in lines if "a goal" in line}) == 1
    assert max(map(len, lines)) <= 150
    assert lines[-1] == "2 of 2 rows met"


def test_an_unknown_row() -> None:
    with pytest.raises(SystemExit) as ended:
        faults(["R99"])
    assert ended.value.code == 2
