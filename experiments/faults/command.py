"""Do the faults of the fault table to this checkout, and measure.

Those that judge seconds run alone and first, the others two at a time.

python -m experiments.faults                   # R1 to R26, some six minutes
python -m experiments.faults R7 R18            # some of them
python -m experiments.faults --quick           # those that take a few seconds at most
python -m experiments.faults --output FILE.md  # the table as Markdown as well

Exit codes: 0 every row is met, or not judged because the machine is busy; 2 no such row; 3 a row is
missed, missing or broken.
"""

from __future__ import annotations

import argparse
import textwrap
import time
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

import pandas as pd

from experiments.cli import OK, SOME_FAILED, guarded
from experiments.faults.outcome import Outcome, run_rows
from experiments.faults.registry import ENTRIES
from miho.analysis import to_markdown

AT_ONCE = 2
WIDTHS = {"row": 4, "fault": 30, "goal": 34, "measured": 50, "verdict": 10, "seconds": 7}


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
    wanted = [row.upper() for row in chosen.rows]
    known = [entry.number for entry in ENTRIES]
    for row in wanted:
        if row not in known:
            parser.error(f"there is no row {row}; rows are {known[0]} to {known[-1]}")
    entries = [entry for entry in ENTRIES if entry.quick or not chosen.quick]
    entries = [entry for entry in entries if not wanted or entry.number in wanted]
    began = time.perf_counter()
    outcomes = [told(outcome) for outcome in run_rows(entries, AT_ONCE)]
    outcomes.sort(key=lambda outcome: known.index(outcome.entry.number))
    print(f"\n{table(outcomes)} in {time.perf_counter() - began:.0f} s")
    if chosen.output is not None:
        chosen.output.write_text(to_markdown(frame(outcomes)), encoding="utf-8")
    return OK if all(outcome.fine for outcome in outcomes) else SOME_FAILED


def told(outcome: Outcome) -> Outcome:
    """Print a line as a row ends."""
    entry = outcome.entry
    print(
        f"{entry.number:<4} {outcome.verdict:<10} {outcome.seconds:5.1f} s  {entry.name}: "
        f"{outcome.row.measured}",
        flush=True,
    )
    return outcome


def frame(outcomes: Sequence[Outcome]) -> pd.DataFrame:
    """A row per outcome."""
    return pd.DataFrame(
        [
            (o.row.number, o.row.fault, o.row.goal, o.row.measured, o.verdict, f"{o.seconds:.1f}")
            for o in outcomes
        ],
        columns=list(WIDTHS),
    )


def table(outcomes: Sequence[Outcome]) -> str:
    """Aligned text, each cell wrapped within its column; how many are fine below."""
    lines = [_line(list(WIDTHS)), _line(["-" * width for width in WIDTHS.values()])]
    for cells in frame(outcomes).itertuples(index=False):
        wrapped = [
            textwrap.wrap(str(cell), width) or [""]
            for cell, width in zip(cells, WIDTHS.values(), strict=True)
        ]
        lines += map(_line, zip_longest(*wrapped, fillvalue=""))
    fine = sum(outcome.fine for outcome in outcomes)
    return "\n".join([*lines, f"{fine} of {len(outcomes)} rows fine"])


def _line(cells: Sequence[str]) -> str:
    padded = (f"{cell:<{width}}" for cell, width in zip(cells, WIDTHS.values(), strict=True))
    return "  ".join(padded).rstrip()


def main() -> None:
    """Run, and exit with the code that fits."""
    codes: list[int] = []
    guarded(lambda: codes.append(faults()), lambda: codes[0])
