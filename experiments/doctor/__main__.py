"""Check the machine, the installation and a folder of results; one line for each check.

python -m experiments.doctor                          # machine and packages
python -m experiments.doctor runs/identify            # its runs as well
python -m experiments.doctor runs/identify --quarantine
python -m experiments.doctor --timing                 # the A/A test too, some five seconds

Exit codes: 0 nothing has to be mended, 2 no such folder, 3 something failed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from experiments.cli import OK, SOME_FAILED, guarded
from experiments.doctor.check import Check, State
from experiments.doctor.machine import machine_checks
from experiments.doctor.packages import package_checks
from experiments.doctor.results import result_checks


def diagnose(arguments: Sequence[str] | None = None) -> int:
    """Print the checks as they are made; the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.doctor",
        description="Check this machine, the installed packages and a folder of results.",
    )
    parser.add_argument("root", type=Path, nargs="?", metavar="ROOT", help="a folder of runs")
    parser.add_argument(
        "--quarantine",
        action="store_true",
        help="move damaged runs to ROOT/.quarantine; nothing is deleted",
    )
    parser.add_argument("--timing", action="store_true", help="compare a method with itself")
    chosen = parser.parse_args(arguments)
    if chosen.quarantine and chosen.root is None:
        parser.error("--quarantine needs the ROOT of the runs")
    if chosen.root is not None and not chosen.root.is_dir():
        raise FileNotFoundError(f"{chosen.root}: no such folder of runs; check its name")
    checks = [machine_checks(chosen.root or Path(), timing=chosen.timing), package_checks()]
    if chosen.root is not None:
        checks.append(result_checks(chosen.root, quarantine=chosen.quarantine))
    made: list[Check] = []
    for check in chain.from_iterable(checks):
        print(check.line, flush=True)
        made.append(check)
    failed = sum(check.state is State.FAILED for check in made)
    warned = sum(check.state is State.WARNING for check in made)
    print(f"{len(made)} checks: {failed} failed, {warned} warnings")
    return SOME_FAILED if failed else OK


def main() -> None:
    """Diagnose, and exit with the code that fits."""
    codes: list[int] = []
    guarded(lambda: codes.append(diagnose()), lambda: codes[0])


if __name__ == "__main__":
    main()
