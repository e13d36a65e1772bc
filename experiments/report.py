"""Report on an identification as text and a page: intervals, identifiability, validation.

python -m experiments.report runs/identify                     # ROOT/report.html: all runs, and
                                                               # the best run of each problem
python -m experiments.report runs/identify --quick             # without intervals
python -m experiments.report runs/identify/PROBLEM/METHOD/ID   # one run
python -m experiments.report runs/identify --bootstrap 1000    # with bootstrap intervals
python -m experiments.report runs/identify/PROBLEM/METHOD/ID --check  # is there a better optimum?
python -m experiments.report runs/identify/PROBLEM/METHOD/ID --next candidates.csv --rows 200
python -m experiments.report runs/identify/PROBLEM/METHOD/ID --posterior
"""

import argparse
from pathlib import Path

from experiments.app.console import OK, SOME_FAILED, root_folder, run_and_exit
from experiments.app.optimum import CHECK_SECONDS, LEAST_SECONDS
from experiments.app.reports import check_candidates, report_on_root, report_on_run, workers
from miho.identification.report_steps import SECONDS
from miho.study import read_run


def main() -> int:
    """Report on the run or the runs in a folder; return 3 if a report failed."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.report",
        description="Report on finished runs: intervals, evidence for the optimum, checks.",
    )
    parser.add_argument("path", type=root_folder, help="folder of one run, or root of all runs")
    parser.add_argument("--bootstrap", type=int, default=0, metavar="N", help="replicates (0)")
    parser.add_argument(
        "--profile", action=argparse.BooleanOptionalAction, default=None,
        help="intervals by profile likelihood (by default for up to 10 parameters)",
    )  # fmt: skip
    parser.add_argument(
        "--check", type=float, nargs="?", const=CHECK_SECONDS, metavar="SECONDS",
        help=f"search for a better optimum from new starting points ({CHECK_SECONDS:g} s)",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=float,
        help="time limit of steps that no option requests (the run's budget, "
        f"{LEAST_SECONDS:g} to {SECONDS:g} s)",
    )  # fmt: skip
    parser.add_argument(
        "--next", type=Path, dest="candidates", metavar="CSV",
        help="for one run: candidate rows for the next measurement (docs/next-measurement.md)",
    )  # fmt: skip
    parser.add_argument("--rows", type=int, help="number of rows, or of groups, to choose")
    parser.add_argument("--goal", help="parameter or derived quantity to narrow (all parameters)")
    parser.add_argument("--groups", metavar="COLUMN", help="column that numbers the groups of rows")
    parser.add_argument("--posterior", action="store_true", help="for one run: write posterior.nc")
    parser.add_argument("--workers", type=workers, default="1", help="processes for refits (1)")
    parser.add_argument("--level", type=float, default=0.95, help="level of the intervals (0.95)")
    parser.add_argument("--trust", action="store_true", help="run code from the files of models")
    parser.add_argument(
        "--quick", "--no-detail", action="store_true", help="for a root: no intervals, no run pages"
    )
    parser.add_argument("--output", type=Path, help="folder of the pages (ROOT/reports)")
    # Options that are out of range, or do not fit the path, are refused before anything is read.
    arguments = parser.parse_args()
    if arguments.bootstrap < 0 or not 0 < arguments.level < 1:
        parser.error("--bootstrap must be at least 0 and --level between 0 and 1")
    if any(limit is not None and not limit > 0 for limit in (arguments.seconds, arguments.check)):
        parser.error("--seconds and --check must be above 0")
    if (arguments.candidates is None) != (arguments.rows is None):
        parser.error("--next needs --rows (how many candidates to choose), and --rows needs --next")
    if ((path := arguments.path) / "result.json").is_file():
        if arguments.quick:
            parser.error("--quick is for a root of runs; this is the folder of one run")
        if arguments.rows is not None:
            check_candidates(arguments.candidates, arguments.rows)
        return SOME_FAILED if report_on_run(read_run(path), arguments)[1] else OK
    if arguments.candidates is not None or arguments.posterior:
        option = "--posterior" if arguments.posterior else "--next"
        parser.error(f"{option} is for one run; name its folder, ROOT/PROBLEM/METHOD/ID")
    return report_on_root(path, arguments)


def run() -> None:
    """Report, and exit with the exit code."""
    run_and_exit(main)


if __name__ == "__main__":
    run()
