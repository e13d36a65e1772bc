"""Do the faults of the fault table to this checkout, and measure: the tests in tests/faults.

Those that judge seconds run alone and first, the others two at a time.

python -m experiments.faults                   # R1 to R26, some six minutes
python -m experiments.faults R7 R18            # some of them
python -m experiments.faults --quick           # those that take a few seconds at most
python -m experiments.faults --output FILE.md  # the table as Markdown as well

Exit codes: 0 every row is met, or not judged because the machine is busy; 2 no such row; 3 a row is
missed, missing or broken. It needs pytest and pytest-xdist, which `make test` installs.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
import textwrap
import time
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from experiments.app.console import BY_SIGNAL, OK, SOME_FAILED
from miho.analysis import to_markdown

if TYPE_CHECKING:
    import pytest

FOLDER = Path(__file__).parents[1] / "tests" / "faults"
ROWS = [f"R{number}" for number in range(1, 27)]
WIDTHS = {"row": 4, "fault": 30, "goal": 34, "measured": 50, "verdict": 10, "seconds": 7}
MET, NOT_JUDGED, MISSED, BROKEN, MISSING = "met", "not judged", "MISSED", "BROKEN", "missing"


class Table:
    """A plugin of pytest that gathers what became of the rows, and says it as they end."""

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


def faults(arguments: Sequence[str] | None = None) -> int:
    """Run the rows asked for; the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.faults",
        description="Do every fault of the fault table and measure what comes of it.",
    )
    parser.add_argument("rows", nargs="*", metavar="R1", help="rows to run; all by default")
    parser.add_argument("--quick", action="store_true", help="only rows that take little time")
    parser.add_argument("--output", type=Path, metavar="FILE", help="write the table as Markdown")
    chosen = parser.parse_args(arguments)
    rows = [row.upper() for row in chosen.rows]
    for row in rows:
        if row not in ROWS:
            parser.error(f"there is no row {row}; rows are {ROWS[0]} to {ROWS[-1]}")
    missing = [name for name in ("pytest", "xdist") if importlib.util.find_spec(name) is None]
    if missing:
        parser.error(f"needs a library that is missing ({', '.join(missing)}); run make test first")
    import pytest  # of the extra dev, which a checkout that only runs has not

    selection = " or ".join(f"fault(row='{row}')" for row in rows) or "fault"
    if chosen.quick:
        selection = f"({selection}) and fault(quick=True)"
    table, began = Table(), time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="faults-", ignore_cleanup_errors=True) as folder:
        for part, processes in (("timed", "0"), ("not timed", "2")):
            pytest.main(
                [
                    str(FOLDER), "-qq", "--no-header", "--thorough", "-p", "no:cacheprovider",
                    "-n", processes, "--basetemp", f"{folder}/{part}",
                    "-m", f"({selection}) and {part}",
                    "-W", "ignore::pytest.PytestAssertRewriteWarning",  # of Hydra's own plugin
                ],
                plugins=[table],
            )  # fmt: skip
            if table.interrupted:
                return BY_SIGNAL + 2
    frame = table.frame(sorted(table.outcomes) if chosen.quick else rows or ROWS)
    print(f"\n{_text(frame)} in {time.perf_counter() - began:.0f} s")
    if chosen.output is not None:
        chosen.output.write_text(to_markdown(frame), encoding="utf-8")
    return OK if frame["verdict"].isin([MET, NOT_JUDGED]).all() else SOME_FAILED


def _text(frame: pd.DataFrame) -> str:
    """Aligned, each cell wrapped within its column; how many rows are fine below."""
    lines = [_line(list(WIDTHS)), _line(["-" * width for width in WIDTHS.values()])]
    for cells in frame.itertuples(index=False):
        wrapped = [
            textwrap.wrap(str(cell), width) or [""]
            for cell, width in zip(cells, WIDTHS.values(), strict=True)
        ]
        lines += map(_line, zip_longest(*wrapped, fillvalue=""))
    fine = int(frame["verdict"].isin([MET, NOT_JUDGED]).sum())
    return "\n".join([*lines, f"{fine} of {len(frame)} rows fine"])


def _line(cells: Sequence[str]) -> str:
    padded = (f"{cell:<{width}}" for cell, width in zip(cells, WIDTHS.values(), strict=True))
    return "  ".join(padded).rstrip()


if __name__ == "__main__":
    sys.exit(faults())
