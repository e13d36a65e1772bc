"""A self-contained HTML page of a sweep: tables and interactive curves."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from miho.analysis.figures.house import png
from miho.analysis.figures.paper import plot_error_over
from miho.analysis.pages.html import PAGE, asset, render
from miho.analysis.pages.run_tables import values_table
from miho.analysis.pages.sweep_contents import Configured, Contents, best_runs, contents
from miho.analysis.pages.sweep_curves import CHART, Detail, overall_order, problem_curves
from miho.analysis.pages.sweep_runs import Sweep, environment_table
from miho.analysis.pages.sweep_tables import (
    final_errors,
    methods_table,
    printed,
    problems_table,
    warnings,
)
from miho.analysis.styles import MethodStyle, styles_of
from miho.analysis.text import rounded
from miho.analysis.timing import clock_of
from miho.figures.style import house_style
from miho.study import StoredRun, load_runs, read_run, write_text
from miho.study.identity import sha256

MANY_METHODS = 12
"""With more methods than this, the page initially shows only the first ten."""
FIRST = 10
BANDS = 4
"""Largest number of methods with which the page initially shows bands."""
PACKAGE = "vl-convert-python"
STILL = (
    f"Lines are means over seeds, bands extend from 10 to 90 %. For interactive curves, "
    f"pip install {PACKAGE} and create the report again."
)
PIXELS = 4 / 3
"""CSS pixels of a point, the unit of line widths."""


@dataclass(frozen=True)
class Best:
    """The best run of a problem: its parameters, notes on them, and a page with details.

    `page` is a path from the folder of the sweep's page; empty if there is none.
    """

    method: str
    seed: int
    parameters: pd.DataFrame
    notes: Sequence[str]
    page: str = ""


def save_sweep_page(
    root: str | Path,
    path: Path | None = None,
    *,
    sweep: Sweep | None = None,
    best: Mapping[str, Best] | None = None,
    configured: Configured | None = None,
    warnings: Sequence[str] = (),
    made_by: str = "miho.analysis.save_sweep_page",
) -> Path:
    """Write the page of all runs of a root.

    Parameters
    ----------
    root : path
        Folder of runs.
    path : Path, optional
        The page; by default report.html in the root.
    sweep : Sweep, optional
        The runs, if they were read already.
    best : mapping of str to Best, optional
        Results of the best run of each problem; by default its values.
    configured : callable, optional
        Returns the runs of a comparison with the optima and families that are configured now.
    warnings : sequence of str
        Shown before the warnings about the runs.
    made_by : str
        Shown in the head of the page.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    ValueError
        If there is no finished run.
    """
    root = Path(root)
    path = root / PAGE if path is None else path
    sweep = Sweep.of(load_runs(root)) if sweep is None else sweep
    if sweep.runs.empty:
        raise ValueError(f"{root}: has no finished run that can be read")
    if best is None:
        best = {name: _values(read_run(folder)) for name, folder in best_runs(sweep).items()}
    page = sweep_page(sweep, contents(sweep, root, configured, warnings, made_by), best)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, page)
    return path


def _values(stored: StoredRun) -> Best:
    result = stored.result
    return Best(str(result["optimizer"]), int(result["seed"]), values_table(stored), ())


def sweep_page(sweep: Sweep, about: Contents, best: Mapping[str, Best]) -> str:
    """The page's HTML; `best` by the names of problems, possibly not all."""
    runs = sweep.runs
    order = overall_order(runs)
    detail = Detail.fitting(runs.groupby(["problem", "optimizer"]).ngroups)
    # With many methods the chart initially shows only the best, without bands.
    seeds = int(runs.groupby(["problem", "optimizer"]).size().max())
    first_methods = order if len(order) <= MANY_METHODS else order[:FIRST]
    board = about.leaderboard
    if board is not None:
        board = board.assign(method=board["method"].map(printed(board["method"])))
    explained = _explained(len(order), len(first_methods), seeds, detail)
    # Without the chart library there is a figure of each problem and no script.
    library = vega()
    script = None if library is None else library + Markup("\n") + asset("sweep.js")
    # The contents of the template, from the top of the page to its end.
    return render(
        "sweep.html",
        title=about.title,
        about=about,
        style=asset("sweep.css"),
        script=script,
        counts=[
            ("runs", len(runs)),
            ("problems", runs["problem"].nunique()),
            ("methods", runs["optimizer"].nunique()),
            ("seeds", runs["seed"].nunique()),
        ],
        warnings=[*warnings(sweep), *about.warnings],
        leaderboard=board,
        shared={
            "methods": {name: _look(style) for name, style in styles_of(order).items()},
            "problems": [str(name) for name in runs["problem"].unique()],
            "shown": first_methods,
            "time": clock_of(runs).unit,
            "chart": CHART,
        },
        mode="median" if seeds == 1 or len(first_methods) > BANDS else "band",
        drawn=[] if script is None else _curves(sweep, about, detail),
        stills=_stills(sweep) if script is None else [],
        explanation=STILL if script is None else explained,
        problems=_problems(sweep, best),
        origin={
            "problems": problems_table(sweep),
            "methods": methods_table(sweep),
            "environment": environment_table(sweep.origins.values()),
        },
        damaged=sweep.damaged,
    )


def _curves(sweep: Sweep, about: Contents, detail: Detail) -> list[dict[str, Any]]:
    """Curves of each problem, in the order of the runs."""
    finite = sweep.curves[sweep.curves["error"].notna()]
    curves = dict(iter(finite.groupby("problem", sort=False)))
    clock = clock_of(sweep.runs)
    charts = []
    for name, runs in sweep.runs.groupby("problem", sort=False):
        best = about.references.get(str(name), math.nan)
        steps = curves.get(str(name), finite.iloc[:0])
        recorded = {"recorded": name not in about.unrecorded}
        charts.append(problem_curves(runs, clock, steps, best, detail) | recorded)
    return charts


def _stills(sweep: Sweep) -> list[tuple[str, bytes]]:
    """Name and figure of errors of each problem that logarithmic axes can show."""
    finite = sweep.curves[sweep.curves["error"].notna() & (sweep.curves["evaluations"] > 0)]
    stills = []
    for name, curves in finite.groupby("problem", sort=False):
        if curves["evaluations"].nunique() == 1 or not curves["error"].any():
            continue
        runs = sweep.runs[sweep.runs["problem"] == name]
        with house_style():
            figure = Figure(figsize=(7.0, 3.6), layout="constrained")
            ax = figure.subplots()
            plot_error_over(curves, "evaluations", ax, unit=str(runs["unit"].iloc[0]))
            figure.legend(loc="outside right upper")
        stills.append((str(name), png(figure)))
    return stills


def _explained(methods: int, first_methods: int, seeds: int, detail: Detail) -> str:
    sentences = [
        "Best error so far, as steps; after its end (dot) a method keeps its answer. Methods are "
        "in the order of their final median. To read values, move the pointer over the figure or "
        "focus it and use the arrow keys; press a method to hide or show it."
    ]
    if seeds > 1:
        sentences.append("The line is the median over seeds, the band extends from 10 to 90 %.")
    if seeds > detail.seeds:
        sentences.append(
            f"At most {detail.seeds} of {seeds} seeds are drawn separately, evenly over their "
            "final errors; median and band include all."
        )
    if first_methods < methods:
        sentences.append(f"Initially the best {first_methods} of {methods} methods are shown.")
    sentences.append(f"Curves have {detail.positions} positions on an axis.")
    return " ".join(sentences)


def _look(style: MethodStyle) -> dict[str, Any]:
    width = style.width * PIXELS
    return {
        "name": style.name,
        "color": style.color,
        "dash": [rounded(width * length, 3) for length in style.dashes[1] or ()],
        "width": round(width, 2),
    }


def _problems(sweep: Sweep, best: Mapping[str, Best]) -> list[dict[str, Any]]:
    """Tables of each problem: final errors and the best run."""
    methods = printed(sweep.runs["optimizer"])
    problems = []
    for name, runs in sweep.runs.groupby("problem", sort=False):
        errors, first = final_errors(runs), best.get(str(name))
        method = "" if first is None else methods.get(first.method, first.method)
        problems.append(
            {"name": str(name), "summary": _summary(errors), "errors": errors, "best": first,
             "method": method}
        )  # fmt: skip
    return problems


def _summary(errors: pd.DataFrame) -> str:
    first = errors.iloc[0]
    median = next(name for name in errors.columns if name.startswith("median error"))
    unit = median.partition("[")[2].rstrip("]")
    return f"{first['method']} {first[median]} {unit}".replace(" -", "")


SNIPPET = "window.vegaEmbed = vegaEmbed;"
"""Export of the bundle to the script of the page."""


def vega(cache: Path | None = None) -> Markup | None:
    """The chart library, Vega with Vega-Lite and Vega-Embed, as one script.

    vl-convert bundles it in seconds, so it is kept in the user's cache folder. None if vl-convert
    is not installed.
    """
    try:
        import vl_convert
    except ImportError:
        return None
    import pooch  # slow to import

    cache = Path(pooch.os_cache("miho")) if cache is None else cache
    path = cache / f"vega-{version(PACKAGE)}-{sha256(SNIPPET)[:12]}.js"
    script = _stored(path)
    if script is None:
        bundle = vl_convert.javascript_bundle(SNIPPET)
        script = bundle.replace("</script", "<\\/script")  # equivalent in a string
        with contextlib.suppress(OSError):  # without a cache it is bundled again
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, f"{_head(script)}\n{script}")
    return Markup(script)  # noqa: S704 - nothing in it closes the element


def _stored(path: Path) -> str | None:
    """The script in a file that begins with its digest; None if it is missing or damaged."""
    try:
        head, _, script = path.read_text(encoding="utf-8").partition("\n")
    except (OSError, UnicodeDecodeError):
        return None
    return script if head == _head(script) else None


def _head(script: str) -> str:
    return f"// sha256 {sha256(script)}"
