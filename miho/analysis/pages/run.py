"""The report of one run in a folder: page, tables, figures and `parameters.json`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from miho.analysis.figures.house import png
from miho.analysis.pages.html import PAGE, asset, render
from miho.analysis.pages.run_tables import (
    correlation_table,
    derived_table,
    error_table,
    parameter_table,
)
from miho.analysis.text import csv_text, ends, significant
from miho.figures.report import (
    Column,
    curve_of,
    fit_figure,
    profile_figure,
    residual_figure,
    waterfall_figure,
)
from miho.identification import Report, identified
from miho.models.identified import parameters_text
from miho.models.joint import rows_of_parts
from miho.models.layout import OUTPUT, PART
from miho.study import StoredRun, write_bytes, write_text
from miho.study.identity import inside
from miho.study.provenance import flattened, provenance

PARAMETERS = "parameters.json"


@dataclass(frozen=True)
class Section:
    """A heading and its contents, in this order; empty parts are omitted.

    `figure` is a picture as from `png`.
    """

    heading: str
    sentences: Sequence[str] = ()
    table: pd.DataFrame | None = None
    figure: bytes | None = None
    caption: str = ""


def save_report(
    report: Report,
    folder: str | Path,
    stored: StoredRun | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> Path:
    """Write the page, the tables as CSV, the figures and parameters.json.

    Parameters
    ----------
    report : Report
        The report.
    folder : path
        Folder of the files; it is created if necessary.
    stored : StoredRun, optional
        The stored run of the report. The page and parameters.json then say how to regenerate it.
    progress : callable
        Called with the name of every step.

    Returns
    -------
    Path
        The page.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    progress("tables")
    for name, table in report.tables.items():
        write_text(folder / f"{name}.csv", csv_text(table))
    settings = {} if stored is None else stored.config["model"]
    model = identified(report, _origin(report, stored))
    write_text(folder / PARAMETERS, parameters_text(model, settings))
    progress("figures")
    figures = figures_of(report)
    for name, picture in figures.items():
        write_bytes(folder / f"{name}.png", picture)
    write_text(folder / PAGE, page_of(report, stored, figures))
    return folder / PAGE


def report_folder(stored: StoredRun) -> Path:
    """Folder of a run's report: below reports/ in its root.

    Raises PermissionError if a link leads out of the root.
    """
    result = stored.result
    root = stored.folder.parent.parent.parent
    return inside(root, "reports", result["problem"], f"{result['optimizer']}-{result['id'][:12]}")


def page(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    """The page's HTML. All text is escaped; nothing is loaded, and no script runs."""
    widths = {len(section.table.columns) for section in sections if section.table is not None}
    columns = Markup("").join(f".columns-{n} {{ --columns: {n}; }}\n" for n in sorted(widths))
    style = asset("run.css") + columns
    parts = {"subtitle": subtitle, "sections": sections}
    return render("run.html", title=title, **parts, style=style, script=None)


def figures_of(report: Report) -> dict[str, bytes]:
    """The pictures by name."""
    problem = report.problem
    dataset, model = problem.dataset, problem.model
    errors = Column("error", problem.unit, problem.errors(report.at.theta))
    predicted = model.predict(report.at.theta[None], *problem.inputs)[0]
    # Parts of a joint problem and outputs have colors, so their columns need no panels.
    parts = rows_of_parts(model, problem.inputs)
    label = "output" if parts else dataset.output
    measured = Column(label, problem.unit, dataset[dataset.output])
    hidden = {dataset.output, PART, OUTPUT} if parts else {dataset.output}
    if isinstance(problem.sigma, str) and len(np.unique(dataset[problem.sigma])) <= len(parts):
        hidden.add(problem.sigma)
    columns = [
        Column(name, dataset.units[name], values)
        for name, values in dataset.columns.items()
        if name not in hidden
    ]
    # Over a single input, or over time, the fit is a curve, with a band for its uncertainty.
    inputs = [Column(name, unit, dataset[name]) for name, unit in model.inputs.items()]
    x, band = curve_of(inputs, model.ordered, report.band)
    profiles = {
        name: (curve.values, curve.tau)
        for name, curve in zip(report.space.names, report.profiles, strict=True)
        if curve is not None
    }
    figures = {
        "fit": fit_figure(measured, predicted, x, band, parts),
        "residuals": residual_figure(errors, columns, parts),
    }
    # Optional figures: several ends of descents, and computed profiles.
    if len(report.descents) > 1:
        figures["descents"] = waterfall_figure(
            report.descents["error"].to_numpy(),
            (report.descents["ended here"] == "yes").to_numpy(),
            problem.unit,
            None if report.best_known is None else math.sqrt(report.best_known),
            math.sqrt(problem.rounding),
            report.search.kind(2),
            report.search.dropped,
        )
    if profiles:
        quantile = report.at.quantile(report.level)
        units = {parameter.name: parameter.unit for parameter in report.space.parameters}
        figures["profiles"] = profile_figure(profiles, units, quantile)
    return {name: png(figure) for name, figure in figures.items()}


def page_of(report: Report, stored: StoredRun | None, figures: Mapping[str, bytes]) -> str:
    """The page's HTML, with the pictures from `figures_of`."""
    problem = report.problem
    kinds = [k for k in ("linearised", "profile", "bootstrap") if f"{k} low" in report.parameters]
    kinds += ["sandwich"] * report.uneven
    # First the parameters and whether they are the optimum, on which everything else depends; then
    # the quality of the fit, trends in the errors, and the origin.
    sections = [
        Section("Parameters", table=_all_intervals(report, kinds), caption=_explained(report)),
        Section(
            "Interpretation",
            report.notes
            if report.conclusion.doubt
            else [report.conclusion.statement, *report.notes],
        ),
        Section(
            "Optima that the data cannot distinguish",
            table=_rounded(report.optima),
            caption="excess: chi-squared minus its value at the first optimum. Intervals extend "
            "from the lowest optimum to the highest.",
        ),
        Section(
            f"Final errors of the {report.search.kind(2)}",
            figure=figures.get("descents"),
            caption=_searched(report),
        ),
        Section(
            "Fit",
            figure=figures["fit"],
            caption=f"{len(problem.dataset)} rows of {problem.dataset.name}.",
        ),
        Section("Derived quantities", table=derived_table(report)),
        Section(
            "Errors",
            table=error_table(report),
            caption="Root mean squares. The residual standard deviation is the square root of the "
            "sum of squares divided by the degrees of freedom.",
        ),
        Section(
            "Cross-validation by group",
            table=_rounded(report.left_out),
            caption="Each group in turn is left out of the fit and predicted.",
        ),
        Section(
            "Trends in the errors",
            table=_rounded(report.trends),
            figure=figures["residuals"],
            caption="explained: share of the errors' variance that means over groups of rows "
            "explain; for a condition, groups also depend on the first input. p: probability "
            "that chance alone explains as much, which accounts for correlated neighbouring rows "
            "if the report does. Errors are model minus data. Lines are means over rows of a "
            "part, or over rows with the first input below and above its median.",
        ),
        Section("Correlation of the estimates", table=correlation_table(report)),
        Section(
            "Profiles",
            figure=figures.get("profiles"),
            caption="Signed root of the likelihood ratio; a straight line if the linearised "
            "interval is accurate. The interval is between the dashed lines.",
        ),
        Section("Origin", table=_origin_table(report, stored)),
    ]
    by = ""
    if stored is not None:
        by = f", identified by {stored.result['optimizer']}, seed {stored.result['seed']}"
    subtitle = (
        f"{type(problem.model.whole).__name__} on {problem.dataset.name}{by}: error "
        f"{significant(report.error)} {problem.unit} (root mean square)."
    )
    full = [section for section in sections if _full(section)]
    return page(f"Identification of {problem.name}", subtitle, full)


def _full(section: Section) -> bool:
    has_rows = section.table is not None and len(section.table) > 0
    return bool(section.sentences or has_rows or section.figure)


def _all_intervals(report: Report, kinds: list[str]) -> pd.DataFrame:
    table = parameter_table(report).iloc[:, :4]
    for kind in kinds:
        table[kind] = [
            ends(row[f"{kind} low"], row[f"{kind} high"], row["standard error"])
            for row in report.parameters.to_dict("records")
        ]
    return table


def _explained(report: Report) -> str:
    least = "" if report.at.dependence is None else "at least "
    doubt = " of this local optimum, which is in doubt" * bool(report.conclusion.doubt)
    return (
        f"{100 * report.level:g} % intervals{doubt}: linearised (Student's t with "
        f"{least}{report.at.freedom} degrees of freedom), by profile likelihood"
        + (f", by {len(report.replicates)} bootstrap replicates." if report.replicates is not None
           else ".")
    )  # fmt: skip


def _searched(report: Report) -> str:
    """Caption of the figure of the descents."""
    search = report.search
    finished, dropped = search.finished - search.dropped, search.dropped
    which = f"the best {len(report.descents):,} " * (finished > len(report.descents))
    starts = f", from the best of {search.screened:,} configurations" * bool(search.screened)
    caption = (
        f"Errors (roots of the loss) at which {which and which + 'of '}{finished:,} "
        f"{search.kind(2)} ended{starts}, sorted: a horizontal section is one optimum."
    )
    if dropped:
        caption += (
            f" {dropped:,} more were dropped on fewer rows, because they were no better there "
            "than a known optimum; their errors on all rows are unknown."
        )
    return caption


def _rounded(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.map(lambda value: significant(value, 4) if isinstance(value, float) else value)


def _origin(report: Report, stored: StoredRun | None) -> dict[str, Any]:
    """The provenance of the stored run, or else the problem and its data."""
    if stored is not None:
        return provenance(stored)
    return {"problem": report.problem.name, "data": report.problem.dataset.digest}


def _origin_table(report: Report, stored: StoredRun | None) -> pd.DataFrame:
    place = {} if stored is None else {"run": str(stored.folder)}
    facts = flattened(place | _origin(report, stored))
    return pd.DataFrame({"what": list(facts), "value": [str(value) for value in facts.values()]})
