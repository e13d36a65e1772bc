"""How far to trust an identification: intervals, identifiability, validation, as text and a page.

python -m experiments.report runs/identify                     # the best run of each problem
python -m experiments.report runs/identify/PROBLEM/METHOD/ID   # one run
python -m experiments.report runs/identify --bootstrap 1000    # with bootstrap intervals
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from experiments.build import ConfigError, rebuild
from experiments.cli import OK, SOME_FAILED, guarded, one_line
from miho.analysis.page import Section, page, png
from miho.analysis.quantities import interval, scaled, with_error, written
from miho.analysis.report_figures import Column, fit_figure, profile_figure, residual_figure
from miho.identification import CurveFit, Report, make_report
from miho.models.identified import Identified, Value, parameters_text
from miho.study import StoredRun, load_runs, read_run, single_thread, write_text

GRID = 200
PAGE, PARAMETERS = "report.html", "parameters.json"


def reported(problem: CurveFit, stored: StoredRun, **settings: Any) -> Report:
    """The report on a finished run of a problem; `settings` are those of `make_report`."""
    if not sys.stderr.isatty():
        print(f"report of {problem.name}: running", file=sys.stderr, flush=True)
    with tqdm(leave=False, disable=None, bar_format="report: {desc}{n_fmt}") as bar:

        def each(stage: str) -> None:
            bar.set_description_str(f"{stage} ", refresh=False)
            bar.update()

        with single_thread():
            return make_report(problem, np.array(stored.result["theta"]), each=each, **settings)


def parameter_table(report: Report) -> pd.DataFrame:
    """The parameters as text, with their digits cut to what their errors leave."""
    chosen = _interval_name(report.parameters)
    rows = []
    for row in report.parameters.to_dict("records"):
        error = row["standard error"]
        rows.append(
            {
                "parameter": row["parameter"],
                "value": written(row["value"], error),
                "unit": row["unit"],
                "standard error": "held" if math.isnan(error) else written(error, error),
                f"{100 * report.level:g} % interval ({chosen})": interval(
                    row[f"{chosen} low"], row[f"{chosen} high"], error
                ),
            }
        )
    return pd.DataFrame(rows)


def derived_table(report: Report) -> pd.DataFrame:
    """The derived quantities as text, in handy units."""
    rows = []
    chosen = _interval_name(report.derived)
    for row in report.derived.to_dict("records"):
        if math.isnan(row["value"]):
            continue
        factor, unit = scaled(row["value"], row["unit"])
        value, error = row["value"] * factor, row["standard error"] * factor
        low, high = (row[f"{chosen} {end}"] * factor for end in ("low", "high"))
        rows.append(
            {
                "derived": row["quantity"],
                "value": with_error(value, error) if error > 0 else "-",
                "unit": unit,
                f"{100 * report.level:g} % interval ({chosen})": interval(low, high, error),
            }
        )
    return pd.DataFrame(rows)


def correlation_table(report: Report) -> pd.DataFrame:
    """The correlation matrix as text."""
    text = report.correlation.map(lambda r: "-" if math.isnan(r) else f"{r:+.2f}")
    return text.rename_axis("").reset_index()


def text(report: Report) -> str:
    """The report for a terminal: parameters, derived quantities and what the numbers mean."""
    parts = [parameter_table(report).to_string(index=False)]
    quantities = derived_table(report)
    if len(quantities):
        parts.append(quantities.to_string(index=False))
    if report.notes:
        parts.append("\n".join(f"- {sentence}" for sentence in report.notes))
    return "\n\n".join(parts)


def write(report: Report, stored: StoredRun, folder: Path) -> Path:
    """Write the page, the tables, the figures and parameters.json; the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in report.tables.items():
        write_text(folder / f"{name}.csv", table.to_csv(index=False))
    settings = stored.config["model"]
    write_text(folder / PARAMETERS, parameters_text(identified(report, stored), settings))
    figures = _figures(report)
    for name, picture in figures.items():
        (folder / f"{name}.png").write_bytes(picture)
    write_text(folder / PAGE, _page(report, stored, figures))
    return folder / PAGE


def identified(report: Report, stored: StoredRun) -> Identified:
    """What a user of the model needs to know."""
    problem = report.problem
    chosen = _interval_name(report.parameters)
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
        provenance={"error": report.error, **_provenance(stored), "interval": chosen},
        level=report.level,
    )  # fmt: skip


def report_folder(stored: StoredRun) -> Path:
    """Where a run's report goes: reports/ beside the problems of its root."""
    result = stored.result
    root = stored.folder.parent.parent.parent
    return Path(root, "reports", result["problem"], f"{result['optimizer']}-{result['id'][:12]}")


def _provenance(stored: StoredRun) -> dict[str, Any]:
    result = stored.result
    return {
        **{key: result[key] for key in ("problem", "optimizer", "seed", "id", "code", "data")},
        "dataset": stored.config["dataset"],
        "environment": {key: value for key, value in stored.environment.items() if key != "load"},
    }


def _interval_name(frame: pd.DataFrame) -> str:
    """The best kind of interval a table has."""
    kinds = ("profile", "bootstrap", "linearised")
    return next((kind for kind in kinds if f"{kind} low" in frame.columns), "")


def _figures(report: Report) -> dict[str, bytes]:
    """The pictures by name."""
    problem = report.problem
    dataset, model = problem.dataset, problem.model
    errors = Column("error", problem.unit, problem.errors(report.found))
    measured = Column(dataset.output, problem.unit, dataset[dataset.output])
    columns = [
        Column(name, dataset.units[name], values)
        for name, values in dataset.columns.items()
        if name != dataset.output
    ]
    x = band = None
    if len(model.inputs) == 1:
        (name,) = model.inputs
        x = Column(name, model.inputs[name], dataset[name])
        grid = np.linspace(x.values.min(), x.values.max(), GRID)
        band = (grid, *report.band(grid))
    profiles = {
        name: (found.values, found.tau)
        for name, found in zip(problem.space.names, report.profiles, strict=True)
        if found is not None
    }
    figures = {
        "fit": fit_figure(measured, measured.values + errors.values, x, band),
        "residuals": residual_figure(errors, columns),
    }
    if profiles:
        quantile = report.at.quantile(report.level)
        figures["profiles"] = profile_figure(profiles, model.parameters, quantile)
    return {name: png(figure) for name, figure in figures.items()}


def _page(report: Report, stored: StoredRun, figures: Mapping[str, bytes]) -> str:
    problem, result = report.problem, stored.result
    kinds = [k for k in ("linearised", "profile", "bootstrap") if f"{k} low" in report.parameters]
    sections = [
        Section("Parameters", table=_all_intervals(report, kinds), caption=_explained(report)),
        Section("What these numbers mean", report.notes or ["Nothing to warn of."]),
        Section(
            "Fit",
            figure=figures["fit"],
            caption=f"{len(problem.dataset)} rows of {problem.dataset.name}.",
        ),
        Section("Derived quantities", table=derived_table(report)),
        Section("Errors", table=_rounded(report.errors), caption="Root mean squares."),
        Section(
            "Errors by group, left out and seen",
            table=_rounded(report.left_out),
            caption="Each group in turn is left out of the fit, and predicted.",
        ),
        Section(
            "What the errors still follow",
            table=_rounded(report.trends),
            figure=figures["residuals"],
            caption="explained: share of the errors' variance that the means of groups of rows "
            "explain, those of a condition together with the first input; p: how often chance "
            "alone explains as much. Errors are model minus data; lines are means over rows with "
            "the first input below and above its median.",
        ),
        Section("Correlation of the estimates", table=correlation_table(report)),
        Section(
            "Profiles",
            figure=figures.get("profiles"),
            caption="Signed root of the likelihood ratio; a straight line where the linearised "
            "interval is right. The interval lies between the dashed lines.",
        ),
        Section("Origin", table=_origin(stored)),
    ]
    subtitle = (
        f"{type(problem.model).__name__} on {problem.dataset.name}, identified by "
        f"{result['optimizer']}, seed {result['seed']}: error {report.error:.5g} "
        f"{problem.unit} (root mean square)."
    )
    return page(f"Identification of {problem.name}", subtitle, [s for s in sections if _full(s)])


def _full(section: Section) -> bool:
    has_rows = section.table is not None and len(section.table) > 0
    return bool(section.sentences or has_rows or section.figure)


def _all_intervals(report: Report, kinds: list[str]) -> pd.DataFrame:
    table = parameter_table(report).iloc[:, :4]
    for kind in kinds:
        table[kind] = [
            interval(row[f"{kind} low"], row[f"{kind} high"], row["standard error"])
            for row in report.parameters.to_dict("records")
        ]
    return table


def _explained(report: Report) -> str:
    return (
        f"{100 * report.level:g} % intervals, linearised at the optimum nearby (Student's t with "
        f"{report.at.freedom} degrees of freedom), by profile likelihood"
        + (f", by {len(report.replicates)} bootstrap replicates." if report.replicates is not None
           else ".")
    )  # fmt: skip


def _rounded(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.map(lambda value: f"{value:.4g}" if isinstance(value, float) else value)


def _origin(stored: StoredRun) -> pd.DataFrame:
    facts = _flat({"run": str(stored.folder), **_provenance(stored)})
    return pd.DataFrame({"what": list(facts), "value": [str(value) for value in facts.values()]})


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _best_runs(path: Path) -> list[StoredRun]:
    """The run in a folder, or the best run of each problem below a root.

    Runs compete if they have the same data, model and loss.
    """
    if (path / "result.json").is_file():
        return [read_run(path)]
    runs = load_runs(path).runs
    runs = runs[runs["error"].notna()] if len(runs) else runs
    if not len(runs):
        raise ConfigError(f"{path}: holds no finished run; run python -m experiments.identify")
    best: dict[str, StoredRun] = {}
    for folder in runs.sort_values(["problem", "error"], kind="stable")["folder"]:
        run = read_run(Path(folder))
        asked = [run.result["data"], *(run.config[key] for key in ("model", "loss"))]
        best.setdefault(json.dumps([run.result["problem"], *asked], sort_keys=True), run)
    return list(best.values())


def _report(stored: StoredRun, arguments: argparse.Namespace) -> str:
    """Write the report of one run; its text, and where the page is."""
    if stored.result["theta"] is None:
        raise ConfigError("the run found no finite value, so there is nothing to report")
    problem = rebuild(stored, trusted=arguments.trust)
    made = reported(
        problem,
        stored,
        replicates=arguments.bootstrap,
        profiles=arguments.profile,
        level=arguments.level,
    )
    folder = report_folder(stored)
    if arguments.output is not None:
        folder = arguments.output / folder.parent.name / folder.name
    errors = "\n".join(
        f"error {row['on']}: {row['error']:.5g} {row['unit']} ({row['rows']} rows)"
        for row in made.errors.to_dict("records")
    )
    return f"{text(made)}\n\n{errors}\nreport {write(made, stored, folder)}\n"


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
    parser.add_argument("--level", type=float, default=0.95, help="of the intervals (0.95)")
    parser.add_argument("--trust", action="store_true", help="run models in files of your own")
    parser.add_argument("--output", type=Path, help="folder; by default reports/ in the root")
    arguments = parser.parse_args()
    if arguments.bootstrap < 0 or not 0 < arguments.level < 1:
        parser.error("--bootstrap must be at least 0 and --level between 0 and 1")
    failed = 0
    for stored in _best_runs(arguments.path):
        try:
            print(f"{stored.result['problem']}: {stored.folder}\n\n{_report(stored, arguments)}")
        except (ConfigError, ValueError) as error:
            print(f"error: {stored.folder}: {one_line(error)}", file=sys.stderr)
            failed += 1
    return SOME_FAILED if failed else OK


def run() -> None:
    """Report, and exit with the code that fits."""
    codes: list[int] = []
    guarded(lambda: codes.append(main()), lambda: codes[0])


if __name__ == "__main__":
    run()
