"""The faults command: every row on its own, within its time, and a table at the end."""

import time
from pathlib import Path

import pytest

from experiments.faults import command, outcome
from experiments.faults.outcome import Outcome, run_row
from experiments.faults.registry import ENTRIES, Entry
from experiments.faults.row import Row


def test_the_table_has_all_rows_in_order() -> None:
    assert [one.number for one in ENTRIES] == [f"R{n}" for n in range(1, 22)]
    assert len({one.name for one in ENTRIES}) == 21


def test_a_row_that_is_not_there() -> None:
    found = run_row(Entry("R1", "nothing_of_that_name"))
    assert (found.verdict, found.fine) == (outcome.MISSING, False)


@pytest.mark.slow
def test_a_row_is_stopped_at_its_limit() -> None:
    started = time.perf_counter()
    found = run_row(Entry("R8", "objectives"), limit=0.2)
    assert found.verdict == outcome.BROKEN
    assert found.row.measured == "stopped after 0.2 s"
    assert time.perf_counter() - started < 30


@pytest.mark.slow
def test_a_row_runs_in_a_process_of_its_own() -> None:
    found = run_row(Entry("R18", "schedule"))
    assert found.verdict == outcome.MET
    assert found.seconds > 0


def fake(verdict: str) -> Outcome:
    measured = "a long measure " * 10
    return Outcome(Row("R7", "a fault | a pipe", "a goal", measured, met=True), verdict, 1.25)


@pytest.mark.parametrize(
    ("verdict", "code"),
    [("met", 0), ("not judged", 0), ("MISSED", 3), ("missing", 3), ("BROKEN", 3)],
)
def test_exit_codes_and_output(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, verdict: str, code: int
) -> None:
    asked: list[str] = []

    def run(one: Entry) -> Outcome:
        asked.append(one.number)
        return fake(verdict)

    monkeypatch.setattr(command, "run_row", run)
    page = tmp_path / "faults.md"
    assert command.faults(["r7", "R18", "--output", str(page)]) == code
    assert asked == ["R7", "R18"]
    lines = page.read_text().splitlines()
    assert lines[0] == "| row | fault | goal | measured | verdict | seconds |"
    assert len(lines) == 4
    assert r"a fault \| a pipe" in lines[2]


def test_quick_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def run(one: Entry) -> Outcome:
        asked.append(one.number)
        return fake("met")

    monkeypatch.setattr(command, "run_row", run)
    command.faults(["--quick"])
    assert asked == [one.number for one in ENTRIES if one.quick]
    assert 0 < len(asked) < 21


def test_the_table_is_aligned() -> None:
    lines = command.table([fake("met"), fake("MISSED")]).splitlines()
    assert len({line.index("a goal") for line in lines if "a goal" in line}) == 1
    assert max(map(len, lines)) <= 150
    assert lines[-1] == "1 of 2 rows fine in 2 s"


def test_an_unknown_row() -> None:
    with pytest.raises(SystemExit) as ended:
        command.faults(["R22"])
    assert ended.value.code == 2
