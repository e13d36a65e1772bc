"""Inject the faults of the fault table into this checkout, and measure the effect (tests/faults).

Tests that measure seconds run first and alone; the other tests run two at a time.

python -m experiments.faults                   # R1 to R35, about seven minutes
python -m experiments.faults R7 R18            # some rows
python -m experiments.faults --quick           # rows that take a few seconds at most
python -m experiments.faults --output FILE.md  # also write the table as Markdown

Exit codes: 0 every row is met, or not judged because the machine is busy; 2 no such row; 3 a row is
missed, missing or broken. The command needs pytest and pytest-xdist, which `make test` installs.
"""

import argparse
import importlib.util
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from experiments.app.console import BY_SIGNAL, OK, SOME_FAILED
from experiments.diagnosis.fault_table import MET, NOT_JUDGED, ROWS, FaultTable, as_text
from miho.analysis import to_markdown

FOLDER = Path(__file__).parents[1] / "tests" / "faults"


def faults(arguments: Sequence[str] | None = None) -> int:
    """Run the requested rows and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.faults",
        description="Inject every fault of the fault table and measure the effect.",
    )
    parser.add_argument("rows", nargs="*", metavar="R1", help="rows to run; all by default")
    parser.add_argument("--quick", action="store_true", help="only rows that take a few seconds")
    parser.add_argument("--output", type=Path, metavar="FILE", help="write the table as Markdown")
    options = parser.parse_args(arguments)
    rows = [row.upper() for row in options.rows]
    for row in rows:
        if row not in ROWS:
            parser.error(f"there is no row {row}; rows are {ROWS[0]} to {ROWS[-1]}")
    missing = [name for name in ("pytest", "xdist") if importlib.util.find_spec(name) is None]
    if missing:
        parser.error(f"needs a library that is missing ({', '.join(missing)}); run make test first")
    import pytest  # in the extra dev, which a user need not install

    selection = " or ".join(f"fault(row='{row}')" for row in rows) or "fault"
    if options.quick:
        selection = f"({selection}) and fault(quick=True)"
    table, began = FaultTable(), time.perf_counter()
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
    frame = table.frame(sorted(table.outcomes) if options.quick else rows or ROWS)
    print(f"\n{as_text(frame)} in {time.perf_counter() - began:.0f} s")
    if options.output is not None:
        options.output.write_text(to_markdown(frame), encoding="utf-8")
    return OK if frame["verdict"].isin([MET, NOT_JUDGED]).all() else SOME_FAILED


if __name__ == "__main__":
    sys.exit(faults())
