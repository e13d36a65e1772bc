"""Check the machine, the installation and a folder of results; print one line for each check.

python -m experiments.doctor                          # machine and packages
python -m experiments.doctor runs/identify            # also the runs in this folder
python -m experiments.doctor runs/identify --quarantine

Exit codes: 0 no check failed, 2 no such folder, 3 a check failed.
"""

import argparse
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from experiments.app.console import OK, SOME_FAILED, root_folder, run_and_exit
from experiments.diagnosis.machine import Check, Severity, machine_checks, package_checks
from experiments.diagnosis.results import result_checks


def diagnose(arguments: Sequence[str] | None = None) -> int:
    """Make the checks, print each result at once, and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.doctor",
        description="Check this machine, the installed packages and a folder of results.",
    )
    parser.add_argument(
        "root", type=root_folder, nargs="?", metavar="ROOT", help="a folder of runs"
    )
    parser.add_argument(
        "--quarantine",
        action="store_true",
        help="move damaged runs to ROOT/.quarantine; nothing is deleted",
    )
    parser.add_argument("--timing", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    root = options.root
    if options.timing:
        parser.error("--timing is now a row of faults; run python -m experiments.faults R12")
    if options.quarantine and root is None:
        parser.error("--quarantine needs the ROOT of the runs")
    if root is not None and not root.is_dir():
        raise FileNotFoundError(f"{root}: no such folder of runs; check the name")
    groups = [machine_checks(root or Path()), package_checks()]
    if root is not None:
        groups.append(result_checks(root, quarantine=options.quarantine))
    checks: list[Check] = []
    for check in chain.from_iterable(groups):
        print(check.line, flush=True)
        checks.append(check)
    failed = sum(check.severity is Severity.FAILED for check in checks)
    warned = sum(check.severity is Severity.WARNING for check in checks)
    print(f"{len(checks)} checks: {failed} failed, {warned} warnings")
    return SOME_FAILED if failed else OK


def main() -> None:
    """Diagnose, and exit with the exit code."""
    run_and_exit(diagnose)


if __name__ == "__main__":
    main()
