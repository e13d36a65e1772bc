"""Reports on stored runs for the commands, with progress and with the facts in conf/."""

import csv
import io
import json
import os
import sys
import tempfile
from argparse import ArgumentTypeError, Namespace
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.app.build import ConfigError, rebuild, stored_part
from experiments.app.configured import as_configured
from experiments.app.console import OK, SOME_FAILED
from experiments.app.explain import as_config_error, one_line
from experiments.app.instantiation import MissingLibraryError
from experiments.app.optimum import check_optimum, report_of, save_run
from experiments.app.progress import at_work
from miho.analysis.figures.design import design_figure
from miho.analysis.figures.house import png
from miho.analysis.pages.html import PAGE
from miho.analysis.pages.run import report_folder
from miho.analysis.pages.run_tables import error_table, parameter_table, report_text, values_table
from miho.analysis.pages.sweep import Best, save_sweep_page
from miho.analysis.pages.sweep_contents import best_runs
from miho.analysis.pages.sweep_runs import Sweep
from miho.analysis.text import csv_text, without_formula
from miho.data.csv import TextFormat, TextTable
from miho.data.measurements import Layout
from miho.identification import Report, optimal_design, sample_posterior
from miho.identification.line_wrapping import for_terminal
from miho.identification.stated import marked
from miho.parallel.cluster import is_address
from miho.parallel.pool import number_of
from miho.study import StoredRun, load_runs, read_run, write_bytes, write_text
from miho.study.identity import inside
from miho.study.index import without_runs
from miho.study.manifest import missing_runs
from miho.study.provenance import provenance
from miho.units import UNITS

ROWS, TABLE, FIGURE = "next_rows.csv", "next.csv", "next.png"


def check_candidates(path: Path, rows: int) -> None:
    """Raise ConfigError if there is no such file, or if fewer than one row is requested."""
    if rows < 1:
        raise ConfigError(f"--rows is {rows}; expected at least 1")
    if not path.is_file():
        raise ConfigError(f"--next: there is no file {path}; give a CSV of candidates")


def advise(report: Report, stored: StoredRun, options: Namespace, folder: Path) -> str:
    """Choose rows and return the advice as text; write the rows, a table and a figure to `folder`.

    The `options` of `experiments.report` have the file of the candidates, the number of rows or
    groups to choose, and the goal.
    If the data of the run are from a file, the candidates have the same columns, headers, units and
    signs; else the columns are the inputs of the model in its units. Raises ConfigError and
    CSVError.
    """
    path, groups = options.candidates, options.groups
    table, frame = read_candidates(report, stored, path, groups)
    with as_config_error(f"--next {path}"):
        design = optimal_design(report, frame, options.rows, goal=options.goal, groups=groups)
    lines = [table.lines[0], *(table.lines[table.first + row] for row in design.chosen.index)]
    write_text(folder / ROWS, "".join(f"{_without_formulas(line, table)}\n" for line in lines))
    write_text(folder / TABLE, csv_text(design.table))
    write_bytes(folder / FIGURE, png(design_figure(design.rows, design.table)))
    return f"what to measure next: {design}\n\nrows {folder / ROWS}\nfigure {folder / FIGURE}\n"


def read_candidates(
    report: Report, stored: StoredRun, path: Path, groups: str | None
) -> tuple[TextTable, pd.DataFrame]:
    """Read the file; return it, and its rows: the inputs of the model, and the column of groups."""
    inputs = report.problem.model.inputs
    settings = stored_part(stored, "dataset")
    columns = list(inputs)
    units = [unit if unit in UNITS else f"own:{unit}" for unit in inputs.values()]
    headers, reading, text = list(columns), dict[str, Any](), TextFormat()
    joint = bool(stored_part(stored, "problem").get("parts"))  # the parts have different files
    if "columns" in settings and "units" in settings and not joint:
        named = list(settings["columns"])
        spelled = dict(zip(named, settings["units"], strict=True))
        called = dict(zip(named, settings.get("headers") or named, strict=True))
        units, headers = [spelled[name] for name in columns], [called[name] for name in columns]
        reading = {
            "convention": settings.get("convention", "iso-w"),
            "flip": [name for name in settings.get("flip") or () if name in columns],
            "ranges": {k: v for k, v in (settings.get("ranges") or {}).items() if k in columns},
        }
        written = {field.name for field in fields(TextFormat)} - {"drop_rows", "missing"}
        text = TextFormat(**{name: settings[name] for name in written & set(settings)})
    layout = Layout(columns, units, columns[0], headers, **reading)
    extra = [groups] if groups is not None and groups not in headers else []
    table = TextTable(path, [*headers, *extra], header=True, text=text)
    numbers = table.numbers()
    frame = pd.DataFrame(layout.si_columns(numbers, table.fault)[0])
    return table, frame if groups is None else frame.assign(**{groups: numbers[groups]})


def _without_formulas(line: str, table: TextTable) -> str:
    """The line with an apostrophe before each cell that a spreadsheet would evaluate."""
    cells = next(csv.reader([line], delimiter=table.delimiter))
    plain = [cell if _is_number(cell, table.decimal) else without_formula(cell) for cell in cells]
    if plain == cells:
        return line
    text = io.StringIO()
    csv.writer(text, delimiter=table.delimiter, lineterminator="").writerow(plain)
    return text.getvalue()


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True


POSTERIOR = "posterior.nc"
NO_INTERVALS = "Intervals were not computed; without --quick, they are on a separate page."


def workers(text: str) -> str:
    """Check the argument: a number of processes, -1 for one per core, or an address."""
    try:
        if not is_address(text):
            number_of(text)
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from None
    return text


def read_sweep(root: Path) -> Sweep:
    """Read all runs of a root, with folders relative to the root."""
    stored = load_runs(root)
    if stored.runs.empty:
        raise ConfigError(without_runs(root))
    count = len(stored.runs)
    if not sys.stderr.isatty():
        print(f"report of {count:,} runs: running", file=sys.stderr, flush=True)
    sweep = Sweep.of(stored)
    if sweep.runs.empty:
        raise ConfigError(f"{root}: none of its {count} runs can be read; repeat the sweep")
    inside = sweep.damaged.map(lambda text: str(text).replace(f"{root}{os.sep}", ""))
    return replace(sweep, damaged=inside)


def save_sweep(sweep: Sweep, root: Path, path: Path, best: Mapping[str, Best]) -> Path:
    """Write the page of the runs of a root, judged by the facts in conf/; return its path."""
    missing = missing_runs(root)
    warnings = []
    if missing is not None:
        print(missing, file=sys.stderr)
        warnings.append(f"{missing}.".replace(f"{root}{os.sep}", ""))
    options = [argument for argument in sys.argv[1:] if argument.startswith("--")]
    made_by = " ".join(["python -m experiments.report", root.resolve().name, *options])
    with at_work("report") as show_stage:
        show_stage("page of all runs")
        return save_sweep_page(
            root, path, sweep=sweep, best=best, configured=as_configured, warnings=warnings,
            made_by=made_by,
        )  # fmt: skip


def report_on_root(root: Path, options: Namespace) -> int:
    """Write the page of all runs of a root, and reports on the best ones; return the exit code."""
    sweep = read_sweep(root)
    reports = {
        problem: report_on_run(read_run(folder), options)
        for problem, folder in best_runs(sweep).items()
    }
    best = {problem: entry for problem, (entry, _) in reports.items()}
    path = (options.output or root) / PAGE
    print(f"all runs {save_sweep(sweep, root, path, best)}")
    return SOME_FAILED if any(failed for _, failed in reports.values()) else OK


def report_on_run(stored: StoredRun, options: Namespace) -> tuple[Best, bool]:
    """Report on one run; return its entry on a page of all runs, and whether the report failed.

    `options` are the arguments of `experiments.report`.
    """
    result = stored.result
    folder = report_folder(stored)
    if options.output is not None:
        folder = inside(options.output, folder.parent.name, folder.name)
    start = folder.parent.parent.parent if options.output is None else options.output
    name = str(result["optimizer"]), int(result["seed"])
    page = (folder / PAGE).relative_to(start).as_posix()
    earlier = page if (folder / PAGE).is_file() else ""
    if options.quick:
        return Best(*name, values_table(stored), [NO_INTERVALS], earlier), False
    try:
        report = _report(stored, options)
    except (ConfigError, ValueError) as error:
        where = f"{stored.folder}: "
        print(f"error: {where}{one_line(error).removeprefix(where)}", file=sys.stderr)
        return Best(
            *name, values_table(stored), [f"No intervals: {one_line(error)}."], earlier
        ), True
    errors = error_table(report).to_string(index=False, header=False)
    path = save_run(report, stored, folder)
    marks = ", ".join(marked(report.problem, report.at.theta, report.at))
    limits = f"limits: {marks}\n" * bool(marks)
    print(
        for_terminal(
            f"{result['problem']}: {stored.folder}\n\n{report_text(report)}\n\n{errors}\n"
            f"{limits}{report.conclusion.statement}\nreport {path}\n"
        )
    )
    if options.candidates is not None:
        print(advise(report, stored, options, folder))
    if options.posterior:
        print(save_posterior(report, stored, folder))
    return Best(*name, parameter_table(report), report.notes, page), False


def _report(stored: StoredRun, options: Namespace) -> Report:
    if stored.result["theta"] is None:
        raise ConfigError("the run found no finite value, so there is no report")
    problem = rebuild(stored, trusted=options.trust)
    settings: dict[str, Any] = {}
    if options.seconds is not None:
        settings["seconds"] = options.seconds
    if options.check is not None:
        record = check_optimum(problem, options.check, int(stored.result["seed"]))
        settings |= {"check": record.descents, "better": record.theta}
    return report_of(
        problem,
        stored,
        replicates=options.bootstrap,
        profiles=options.profile,
        level=options.level,
        workers=options.workers,
        **settings,
    )


def save_posterior(report: Report, stored: StoredRun, folder: Path) -> str:
    """Sample and write the posterior next to the report; return its path and its limitations."""
    seed = int(stored.result["seed"])
    try:
        posterior = sample_posterior(report.problem, report.at.theta, seed=seed)
    except ImportError as error:
        raise MissingLibraryError(f"--posterior: {error}") from None
    posterior.attrs["provenance"] = json.dumps(provenance(stored))
    with tempfile.TemporaryDirectory(prefix="miho-") as temporary:
        posterior.to_netcdf(Path(temporary, POSTERIOR))
        write_bytes(folder / POSTERIOR, Path(temporary, POSTERIOR).read_bytes())
    return "\n".join([f"posterior {folder / POSTERIOR}", *posterior.attrs["notes"].splitlines()])
