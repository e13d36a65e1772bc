"""The faults command: every row on its own, within its time, and a table at the end."""

import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from experiments.faults import command, outcome
from experiments.faults.outcome import Outcome, run_rows
from experiments.faults.registry import ENTRIES, Entry
from experiments.faults.row import Row


def test_the_table_has_all_rows_in_order() -> None:
    assert [one.number for one in ENTRIES] == [f"R{n}" for n in range(1, 27)]
    assert len({one.name for one in ENTRIES}) == 26


def test_a_row_that_is_not_there() -> None:
    (found,) = run_rows([Entry("R1", "nothing_of_that_name")])
    assert (found.verdict, found.fine) == (outcome.MISSING, False)


@pytest.mark.slow
def test_a_row_is_stopped_at_its_limit() -> None:
    started = time.perf_counter()
    (found,) = run_rows([Entry("R8", "objectives")], limit=0.2)
    assert found.verdict == outcome.BROKEN
    assert found.row.measured == "stopped after 0.2 s"
    assert time.perf_counter() - started < 30


@pytest.mark.slow
def test_rows_run_in_processes_of_their_own_and_timed_ones_first() -> None:
    entries = [Entry("R14", "targets", timed=True), Entry("R15", "names"), Entry("R18", "schedule")]
    found = list(run_rows(entries, at_once=2))
    assert {one.verdict for one in found} == {outcome.MET}
    assert found[0].entry.number == "R14"
    assert all(one.seconds > 0 for one in found)


def test_rows_that_judge_seconds_are_alone() -> None:
    assert [one.number for one in ENTRIES if one.timed] == ["R10", "R11", "R12", "R20"]


def fake(verdict: str, entry: Entry = ENTRIES[6]) -> Outcome:
    row = Row(entry.number, "a fault | a pipe", "a goal", "a long measure " * 10, met=True)
    return Outcome(entry, row, verdict, 1.25)


@pytest.mark.parametrize(
    ("verdict", "code"),
    [("met", 0), ("not judged", 0), ("MISSED", 3), ("missing", 3), ("BROKEN", 3)],
)
def test_exit_codes_and_output(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, verdict: str, code: int
) -> None:
    def run(entries: Iterable[Entry], at_once: int) -> Iterator[Outcome]:
        yield from (fake(verdict, entry) for entry in reversed(list(entries)))

    monkeypatch.setattr(command, "run_rows", run)
    page = tmp_path / "faults.md"
    assert command.faults(["r18", "R7", "--output", str(page)]) == code
    lines = page.read_text().splitlines()
    assert lines[0] == "| row | fault | goal | measured | verdict | seconds |"
    assert [line.split()[1] for line in lines[2:]] == ["R7", "R18"], "in order, however they end"
    assert r"a fault \| a pipe" in lines[2]


def test_quick_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def run(entries: Iterable[Entry], at_once: int) -> Iterator[Outcome]:
        asked.extend(entry.number for entry in entries)
        return iter(())

    monkeypatch.setattr(command, "run_rows", run)
    command.faults(["--quick"])
    assert asked == [one.number for one in ENTRIES if one.quick]
    assert 0 < len(asked) < 26


def test_the_table_is_aligned() -> None:
    lines = command.table([fake("met"), fake("MISSED")]).splitlines()
    assert len({line.index("a goal") for line in lines if "a goal" in line}) == 1
    assert max(map(len, lines)) <= 150
    assert lines[-1] == "1 of 2 rows fine"


def test_an_unknown_row() -> None:
    with pytest.raises(SystemExit) as ended:
        command.faults(["R99"])
    assert ended.value.code == 2
