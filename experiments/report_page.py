"""The page of a report: its sections, its figures and where it comes from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from experiments.report_tables import (
    correlation_table,
    derived_table,
    error_table,
    parameter_table,
)
from miho.analysis.page import Section, page, png
from miho.analysis.quantities import interval
from miho.analysis.report_figures import (
    Column,
    fit_figure,
    profile_figure,
    residual_figure,
    waterfall_figure,
)
from miho.identification import Report
from miho.identification.evidence import kind_of
from miho.study import StoredRun

GRID = 200


def figures_of(report: Report) -> dict[str, bytes]:
    """The pictures by name."""
    problem = report.problem
    dataset, model = problem.dataset, problem.model
    errors = Column("error", problem.unit, problem.errors(report.at.theta))
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
        name: (curve.values, curve.tau)
        for name, curve in zip(problem.space.names, report.profiles, strict=True)
        if curve is not None
    }
    figures = {
        "fit": fit_figure(measured, measured.values + errors.values, x, band),
        "residuals": residual_figure(errors, columns),
    }
    if len(report.descents) > 1:
        figures["descents"] = waterfall_figure(
            report.descents["error"].to_numpy(),
            (report.descents["ended here"] == "yes").to_numpy(),
            problem.unit,
            None if report.best_known is None else math.sqrt(report.best_known),
            math.sqrt(problem.rounding),
            kind_of(report.searches),
            sum(each.dropped for each in report.searches),
        )
    if profiles:
        quantile = report.at.quantile(report.level)
        figures["profiles"] = profile_figure(profiles, model.parameters, quantile)
    return {name: png(figure) for name, figure in figures.items()}


def page_of(report: Report, stored: StoredRun, figures: Mapping[str, bytes]) -> str:
    """The page's HTML, with the pictures that `figures_of` made."""
    problem, result = report.problem, stored.result
    kinds = [k for k in ("linearised", "profile", "bootstrap") if f"{k} low" in report.parameters]
    sections = [
        Section("Parameters", table=_all_intervals(report, kinds), caption=_explained(report)),
        Section(
            "What these numbers mean",
            report.notes
            if report.standing.doubt
            else [f"optimum: {report.standing.evidence}.", *report.notes],
        ),
        Section(
            f"Where the {kind_of(report.searches)} ended",
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
            caption="Root mean squares; the residual standard deviation is the root of the sum of "
            "squares by the degrees of freedom.",
        ),
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
        f"{100 * report.level:g} % intervals{_where(report)}: linearised (Student's t with "
        f"{report.at.freedom} degrees of freedom), by profile likelihood"
        + (f", by {len(report.replicates)} bootstrap replicates." if report.replicates is not None
           else ".")
    )  # fmt: skip


def _searched(report: Report) -> str:
    """What the picture of the descents shows."""
    dropped = sum(each.dropped for each in report.searches)
    finished = sum(each.finished for each in report.searches) - dropped
    kind = kind_of(report.searches)
    screened = sum(each.screened for each in report.searches)
    which = f"the best {len(report.descents):,} " * (finished > len(report.descents))
    starts = f", from the best of {screened:,} configurations" * bool(screened)
    caption = (
        f"Errors (roots of the loss) at which {which and which + 'of '}{finished:,} {kind} "
        f"ended{starts}, sorted: a level stretch is one optimum."
    )
    if kind == "brackets":
        caption += (
            " A bracket looks at several starts, halves them as they descend, and ends where the "
            "last one does."
        )
    if dropped:
        caption += (
            f" {dropped:,} more came to an end on fewer rows, as no better there than an optimum "
            "that was known; their errors on all rows are not known."
        )
    return caption


def _where(report: Report) -> str:
    return " of this local optimum, which is in doubt" * bool(report.standing.doubt)


def _rounded(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.map(lambda value: f"{value:.4g}" if isinstance(value, float) else value)


def _origin(stored: StoredRun) -> pd.DataFrame:
    facts = _flat({"run": str(stored.folder), **provenance(stored)})
    return pd.DataFrame({"what": list(facts), "value": [str(value) for value in facts.values()]})


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def provenance(stored: StoredRun) -> dict[str, Any]:
    """What regenerates a run, and what it ran on."""
    result = stored.result
    return {
        **{key: result[key] for key in ("problem", "optimizer", "seed", "id", "code", "data")},
        "dataset": stored.config["dataset"],
        "environment": {
            key: value for key, value in stored.environment.items() if key not in ("load", "timing")
        },
    }
