"""The fault table: what became of each of its rows, gathered from pytest as they end."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import pandas as pd

if TYPE_CHECKING:
    import pytest

ROWS = [f"R{number}" for number in range(1, 36)]
WIDTHS = {"row": 4, "fault": 30, "goal": 34, "measured": 50, "verdict": 10, "seconds": 7}
MET, NOT_JUDGED, MISSED, BROKEN, MISSING = "met", "not judged", "MISSED", "BROKEN", "missing"


class FaultTable:
    """A plugin of pytest that gathers the rows of the table and prints each as it ends."""

    def __init__(self) -> None:
        self.outcomes: dict[str, tuple[str, ...]] = {}
        """By row: its cells in the order of `WIDTHS`."""
        self.interrupted = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test that is done, or that could not be set up."""
        properties: dict[str, Any] = dict(report.user_properties)
        if "fault" not in properties or (report.when != "call" and report.passed):
            return
        row, measured = properties["fault"], str(properties.get("measured", ""))
        verdict = {"passed": MET, "skipped": NOT_JUDGED, "failed": MISSED}[report.outcome]
        if not measured:
            verdict, measured = BROKEN, report.longreprtext.strip().rpartition("\n")[2]
        seconds = f"{report.duration:.1f}"
        cells = row["row"], row["fault"], row["promise"], measured, verdict, seconds
        self.outcomes[row["row"]] = cells
        name = report.location[2]
        print(f"{row['row']:<4} {verdict:<10} {seconds:>5} s  {name}: {measured}", flush=True)

    def pytest_keyboard_interrupt(self) -> None:
        """Ctrl-C: no further row is begun."""
        self.interrupted = True

    def pytest_report_teststatus(self, report: pytest.TestReport) -> tuple[str, str, str]:
        """No dots of pytest's between the lines."""
        return report.outcome, "", ""

    def frame(self, rows: Sequence[str]) -> pd.DataFrame:
        """These rows, in order, and what is missing of them."""
        absent = ("-", "-", "no such test", MISSING, "0.0")
        cells = [self.outcomes.get(row, (row, *absent)) for row in sorted(rows, key=ROWS.index)]
        return pd.DataFrame(cells, columns=list(WIDTHS))


def as_text(frame: pd.DataFrame) -> str:
    """Aligned, each cell wrapped within its column; how many rows are met below."""
    lines = [_line(list(WIDTHS)), _line(["-" * width for width in WIDTHS.values()])]
    for cells in frame.itertuples(index=False):
        wrapped = [
            textwrap.wrap(str(cell), width) or [""]
            for cell, width in zip(cells, WIDTHS.values(), strict=True)
        ]
        lines += map(_line, zip_longest(*wrapped, fillvalue=""))
    met, unjudged = (int((frame["verdict"] == verdict).sum()) for verdict in (MET, NOT_JUDGED))
    rest = f", {unjudged} not judged" if unjudged else ""
    return "\n".join([*lines, f"{met} of {len(frame)} rows met{rest}"])


def _line(cells: Sequence[str]) -> str:
    padded = (f"{cell:<{width}}" for cell, width in zip(cells, WIDTHS.values(), strict=True))
    return "  ".join(padded).rstrip()
