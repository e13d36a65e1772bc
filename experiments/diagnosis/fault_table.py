"""The fault table, collected from pytest while the tests run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd

from experiments.app.run_text import table_text

if TYPE_CHECKING:
    import pytest

ROWS = [f"R{number}" for number in range(1, 36)]
COLUMNS = ["row", "fault", "goal", "measured", "verdict", "seconds"]
MET, NOT_JUDGED, MISSED, BROKEN, MISSING = "met", "not judged", "MISSED", "BROKEN", "missing"


class FaultTable:
    """Plugin of pytest that collects the rows of the table and prints each at its end."""

    def __init__(self) -> None:
        self.outcomes: dict[str, tuple[str, ...]] = {}
        """Cells of each row in the order of `COLUMNS`."""
        self.interrupted = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record a test that has ended, or whose setup failed."""
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
        """Start no further row after Ctrl-C."""
        self.interrupted = True

    def pytest_report_teststatus(self, report: pytest.TestReport) -> tuple[str, str, str]:
        """Suppress the dots of pytest between the lines."""
        return report.outcome, "", ""

    def frame(self, rows: Sequence[str]) -> pd.DataFrame:
        """Table of these rows, in order; rows without a test are marked as missing."""
        absent = ("-", "-", "no such test", MISSING, "0.0")
        cells = [self.outcomes.get(row, (row, *absent)) for row in sorted(rows, key=ROWS.index)]
        return pd.DataFrame(cells, columns=COLUMNS)


def as_text(frame: pd.DataFrame) -> str:
    """Aligned text with wrapped cells, and the number of rows that are met."""
    met, unjudged = (int((frame["verdict"] == verdict).sum()) for verdict in (MET, NOT_JUDGED))
    rest = f", {unjudged} not judged" if unjudged else ""
    return f"{table_text(frame)}\n{met} of {len(frame)} rows met{rest}"
