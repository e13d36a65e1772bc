"""How far to trust an identification: intervals, identifiability, validation, as text and a page.

python -m experiments.report runs/identify                     # ROOT/report.html: all runs, and
                                                               # the best run of each problem
python -m experiments.report runs/identify --quick             # without intervals
python -m experiments.report runs/identify/PROBLEM/METHOD/ID   # one run
python -m experiments.report runs/identify --bootstrap 1000    # with bootstrap intervals
python -m experiments.report runs/identify/PROBLEM/METHOD/ID --check  # is there a better optimum?
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

from experiments.app.build import ConfigError, rebuild
from experiments.app.console import OK, SOME_FAILED, guarded
from experiments.app.explain import one_line
from experiments.app.progress import at_work
from experiments.optimum import CHECK_SECONDS, check, descents_of, remedy
from experiments.report_page import figures_of, page_of, provenance
from experiments.report_sweep import best_runs, read_sweep, write_sweep
from experiments.report_tables import (
    error_table,
    interval_kind,
    parameter_table,
    text,
    values_table,
)
from miho.analysis.sweep_page import Best
from miho.identification import CurveFit, Report, make_report
from miho.identification.report import SECONDS
from miho.models.identified import Identified, Value, parameters_text
from miho.study import StoredRun, read_run, single_thread, write_bytes, write_text
from miho.study.places import inside

LEAST_SECONDS = 10.0
"""A report may take as long as the run's budget, but this at least and `SECONDS` at most."""
PAGE, PARAMETERS = "report.html", "parameters.json"
NO_INTERVALS = "Intervals were not computed; without --quick they are, and a page of their own."


def reported(problem: CurveFit, stored: StoredRun, **settings: Any) -> Report:
    """The report on a finished run of a problem; `settings` are those of `make_report`."""
    if not sys.stderr.isatty():
        print(f"report of {problem.name}: running", file=sys.stderr, flush=True)
    result = stored.result
    budget = stored.config["budget"].get("seconds")
    known = {
        "seconds": SECONDS if budget is None else min(SECONDS, max(LEAST_SECONDS, budget)),
        "descents": descents_of(stored),
        "best_known": result.get("facts", {}).get("optimum"),
        "remedy": remedy(problem, stored, checked="check" in settings),
    }
    with at_work("report") as each, single_thread():
        return make_report(problem, np.array(result["theta"]), each=each, **known | settings)


def write(report: Report, stored: StoredRun, folder: Path) -> Path:
    """Write the page, the tables, the figures and parameters.json; the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    with at_work("report") as each:
        each("tables")
        for name, table in report.tables.items():
            write_text(folder / f"{name}.csv", table.to_csv(index=False))
        settings = stored.config["model"]
        write_text(folder / PARAMETERS, parameters_text(identified(report, stored), settings))
        each("figures")
        figures = figures_of(report)
        for name, picture in figures.items():
            write_bytes(folder / f"{name}.png", picture)
        write_text(folder / PAGE, page_of(report, stored, figures))
    return folder / PAGE


def identified(report: Report, stored: StoredRun) -> Identified:
    """What a user of the model needs to know."""
    problem = report.problem
    chosen = interval_kind(report.parameters)
    return Identified(
        model=problem.model,
        parameters={
            row["parameter"]: Value(
                row["value"], row["unit"], row["standard error"],
                row[f"{chosen} low"], row[f"{chosen} high"],
            )
            for row in report.parameters.to_dict("records")
        },
        correlation=report.at.correlation,
        ranges={
            name: (float(problem.dataset[name].min()), float(problem.dataset[name].max()))
            for name in problem.model.inputs
        },
        derived={
            row["quantity"]: Value(
                row["value"], row["unit"], row["standard error"],
                row["linearised low"], row["linearised high"],
            )
            for row in report.derived.to_dict("records")
            if math.isfinite(row["value"])
        },
        provenance={
            "error": report.error,
            "residual_standard_deviation": report.residual_standard_deviation,
            "degrees_of_freedom": report.freedom,
            "optimum": (report.standing.doubt and f"in doubt: {report.standing.doubt}")
            or report.standing.evidence,
            **provenance(stored),
            "interval": chosen,
        },
        level=report.level,
    )  # fmt: skip


def report_folder(stored: StoredRun) -> Path:
    """Where a run's report goes: reports/ beside the problems of its root.

    Raises PermissionError where a link leads out of the root.
    """
    result = stored.result
    root = stored.folder.parent.parent.parent
    return inside(root, "reports", result["problem"], f"{result['optimizer']}-{result['id'][:12]}")


def _report(stored: StoredRun, folder: Path, arguments: argparse.Namespace) -> tuple[str, Report]:
    """Write the report of one run; its text, and where the page is."""
    result = stored.result
    if result["theta"] is None:
        raise ConfigError("the run found no finite value, so there is nothing to report")
    problem = rebuild(stored, trusted=arguments.trust)
    settings: dict[str, Any] = {}
    if arguments.seconds is not None:
        settings["seconds"] = arguments.seconds
    if arguments.check is not None:
        record = check(problem, arguments.check, int(result["seed"]))
        settings |= {"check": record.descents, "better": record.theta}
    made = reported(
        problem,
        stored,
        replicates=arguments.bootstrap,
        profiles=arguments.profile,
        level=arguments.level,
        **settings,
    )
    errors = error_table(made).to_string(index=False, header=False)
    page = write(made, stored, folder)
    return f"{text(made)}\n\n{errors}\noptimum: {made.standing.evidence}\nreport {page}\n", made


def _of_run(stored: StoredRun, arguments: argparse.Namespace) -> tuple[Best, bool]:
    """Report on one run; what a page of all runs says of it, and whether that failed."""
    result = stored.result
    folder = report_folder(stored)
    if arguments.output is not None:
        folder = inside(arguments.output, folder.parent.name, folder.name)
    start = folder.parent.parent.parent if arguments.output is None else arguments.output
    run_ = str(result["optimizer"]), int(result["seed"])
    page = (folder / PAGE).relative_to(start).as_posix()
    there = (folder / PAGE).is_file()
    if arguments.quick:
        return Best(*run_, values_table(stored), [NO_INTERVALS], page if there else ""), False
    try:
        told, made = _report(stored, folder, arguments)
    except (ConfigError, ValueError) as error:
        print(f"error: {stored.folder}: {one_line(error)}", file=sys.stderr)
        said = f"No intervals: {one_line(error)}."
        return Best(*run_, values_table(stored), [said], page if there else ""), True
    print(f"{result['problem']}: {stored.folder}\n\n{told}")
    return Best(*run_, parameter_table(made), made.notes, page), False


def main() -> int:
    """Report on what a folder holds; 3 if that failed for some of its runs."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.report",
        description="Intervals, identifiability and validation of finished runs.",
    )
    parser.add_argument("path", type=Path, help="a run's folder, or a root: its best runs")
    parser.add_argument("--bootstrap", type=int, default=0, metavar="N", help="replicates: 1000")
    parser.add_argument(
        "--profile", action=argparse.BooleanOptionalAction, default=None,
        help="profile likelihood; by default for up to 10 parameters",
    )  # fmt: skip
    parser.add_argument(
        "--check", type=float, nargs="?", const=CHECK_SECONDS, metavar="SECONDS",
        help=f"look for a better optimum from independent starts ({CHECK_SECONDS:g} s)",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=float,
        help="for what is not asked for by name (those of the run's budget, "
        f"{LEAST_SECONDS:g} to {SECONDS:g})",
    )  # fmt: skip
    parser.add_argument("--level", type=float, default=0.95, help="of the intervals (0.95)")
    parser.add_argument("--trust", action="store_true", help="run models in files of your own")
    parser.add_argument(
        "--quick", "--no-detail", action="store_true", help="of a root: no intervals, no page each"
    )
    parser.add_argument("--output", type=Path, help="folder; by default reports/ in the root")
    arguments = parser.parse_args()
    if arguments.bootstrap < 0 or not 0 < arguments.level < 1:
        parser.error("--bootstrap must be at least 0 and --level between 0 and 1")
    if any(limit is not None and not limit > 0 for limit in (arguments.seconds, arguments.check)):
        parser.error("--seconds and --check must be above 0")
    if (arguments.path / "result.json").is_file():
        if arguments.quick:
            parser.error("--quick is for a root of runs; this is the folder of one run")
        return SOME_FAILED if _of_run(read_run(arguments.path), arguments)[1] else OK
    sweep = read_sweep(arguments.path)
    found = {
        problem: _of_run(read_run(folder), arguments)
        for problem, folder in best_runs(sweep).items()
    }
    best = {problem: one for problem, (one, _) in found.items()}
    path = (arguments.output or arguments.path) / PAGE
    print(f"all runs {write_sweep(sweep, arguments.path, path, best)}")
    return SOME_FAILED if any(failed for _, failed in found.values()) else OK


def run() -> None:
    """Report, and exit with the code that fits."""
    guarded(main)


if __name__ == "__main__":
    run()
