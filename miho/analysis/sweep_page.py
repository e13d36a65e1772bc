"""One self-contained HTML page of a sweep: tables, and curves that answer the pointer."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from typing import Any

import pandas as pd

from miho.analysis.styles import MethodStyle, styles_of
from miho.analysis.sweep_curves import Detail, overall_order, problem_curves
from miho.analysis.sweep_markup import (
    Choice,
    buttons,
    data,
    facts,
    items,
    link,
    policy,
    table,
)
from miho.analysis.sweep_origins import environment_table
from miho.analysis.sweep_runs import Sweep
from miho.analysis.sweep_tables import (
    final_errors,
    methods_table,
    printed,
    problems_table,
    warnings,
)
from miho.analysis.timing import Clock, clock_of

CHOICES = (
    Choice("Horizontal", "x", (("log", "log"), ("linear", "linear")), "log"),
    Choice("Vertical", "y", (("log", "log"), ("linear", "linear")), "log"),
    Choice("Show", "quantity", (("error", "error"), ("gap", "gap to the best")), "error"),
)
MANY_METHODS = 12
"""With more methods than this the page opens with the first ten only."""
FIRST = 10
BANDS = 4
"""Up to so many methods the page opens with bands."""
OPEN = 3
"""Up to so many problems their tables are open from the start."""
PIXELS = 4 / 3
"""CSS pixels of a point, the unit of line widths."""


@dataclass(frozen=True)
class Best:
    """The best run of a problem: its parameters, what to say of them, and the page with the rest.

    `page` is a path from the folder of the sweep's page, empty if there is none.
    """

    method: str
    seed: int
    parameters: pd.DataFrame
    notes: Sequence[str]
    page: str = ""


@dataclass(frozen=True)
class Told:
    """What the page says beside the runs: title, facts of its head, further warnings and tables.

    `references` holds the best known error of each problem, in the unit of its runs; of those in
    `unrecorded` no optimum is recorded, so that it is the best of these runs.
    """

    title: str
    facts: Sequence[tuple[str, str]] = ()
    warnings: Sequence[str] = ()
    leaderboard: pd.DataFrame | None = None
    leaderboard_note: str = ""
    claims: pd.DataFrame | None = None
    claims_note: str = ""
    references: Mapping[str, float] = field(default_factory=dict)
    unrecorded: Collection[str] = ()


def sweep_page(sweep: Sweep, told: Told, best: Mapping[str, Best]) -> str:
    """The page's HTML; `best` by the names of the problems, which may be fewer than all."""
    script, style = _web("sweep.js"), _web("sweep.css")
    parts = [_head(sweep, told), _leaderboard(told), _curves(sweep, told)]
    parts += [_problems(sweep, best), _claims(told), _origin(sweep), _skipped(sweep)]
    title = escape(told.title)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"{policy(style, script)}\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="referrer" content="no-referrer">\n'
        f"<title>{title}</title>\n<style>{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(part for part in parts if part)
        + f"\n</main>\n<script>{script}</script>\n</body>\n</html>\n"
    )


def _web(name: str) -> str:
    return files("miho.analysis").joinpath("web", name).read_text(encoding="utf-8")


def _section(identity: str, heading: str, *parts: str) -> str:
    body = "\n".join(part for part in parts if part)
    return (
        f'<section id="{identity}" aria-labelledby="{identity}-title">\n'
        f'<h2 id="{identity}-title">{escape(heading)}</h2>\n{body}\n</section>'
    )


def _note(text: str) -> str:
    return f'<p class="note">{escape(text)}</p>' if text else ""


def _head(sweep: Sweep, told: Told) -> str:
    runs = sweep.runs
    counts = [
        ("runs", len(runs)),
        ("problems", runs["problem"].nunique()),
        ("methods", runs["optimizer"].nunique()),
        ("seeds", runs["seed"].nunique()),
    ]
    said = [*warnings(sweep), *told.warnings]
    parts = {"leaderboard": told.leaderboard is not None, "curves": True, "problems": True}
    parts |= {"claims": told.claims is not None, "origin": True}
    present = [name for name, there in parts.items() if there]
    contents = "".join(f'<li><a href="#{name}">{name.capitalize()}</a></li>' for name in present)
    big = "".join(
        f"<div><dt>{name.removesuffix('s' * (count == 1))}</dt><dd>{count:,}</dd></div>"
        for name, count in counts
    )
    return (
        f'<header>\n<h1>{escape(told.title)}</h1>\n<dl class="counts">{big}</dl>\n'
        f"{facts(told.facts)}\n</header>\n"
        + _section("warnings", "Before you read on", items(said or ["Nothing to warn of."]))
        + f'\n<nav aria-label="Contents"><ul>{contents}</ul></nav>'
    )


def _leaderboard(told: Told) -> str:
    if told.leaderboard is None:
        return ""
    names = printed(told.leaderboard["method"])
    frame = told.leaderboard.assign(method=told.leaderboard["method"].map(names))
    return _section("leaderboard", "Leaderboard", table(frame), _note(told.leaderboard_note))


def _over(clock: Clock) -> Choice:
    axes = (("evaluations", "evaluations"), ("seconds", clock.unit))
    return Choice("Over", "axis", axes, "evaluations")


def _curves(sweep: Sweep, told: Told) -> str:
    order = overall_order(sweep.runs)
    styles = styles_of(order)
    pairs = sweep.runs.groupby(["problem", "optimizer"]).ngroups
    detail = Detail.fitting(pairs)
    problems = [str(name) for name in sweep.runs["problem"].unique()]
    runs = dict(iter(sweep.runs.groupby("problem", sort=False)))
    finite = sweep.curves[sweep.curves["error"].notna()]
    curves = dict(iter(finite.groupby("problem", sort=False)))
    clock = clock_of(sweep.runs)
    drawn = []
    for name in problems:
        best, steps = told.references.get(name, math.nan), curves.get(name, finite.iloc[:0])
        one = problem_curves(runs[name], clock, steps, best, detail)
        drawn.append(one | {"recorded": name not in told.unrecorded})
    most = int(sweep.runs.groupby(["problem", "optimizer"]).size().max())
    shown = order if len(order) <= MANY_METHODS else order[:FIRST]
    mode = "median" if most == 1 or len(shown) > BANDS else "band"
    about = {
        "methods": {name: _look(style) for name, style in styles.items()},
        "problems": problems,
        "shown": shown,
        "time": clock.unit,
    }
    options = "".join(f'<option value="{i}">{escape(n)}</option>' for i, n in enumerate(problems))
    choice = Choice(
        "Curves", "mode", (("median", "median"), ("band", "median, band"), ("seeds", "each seed")),
        mode,
    )  # fmt: skip
    picker = (
        f'<label class="choice"><span>Problem</span><select id="problem">{options}</select></label>'
    )
    controls = "".join(map(buttons, (_over(clock), *CHOICES, choice)))
    blocks = [data("about", about)]
    blocks += [data(f"curves-{number}", one) for number, one in enumerate(drawn)]
    return _section(
        "curves",
        "Error over effort",
        "<noscript><p>The curves need JavaScript; the tables do without.</p></noscript>",
        f'<form class="controls">{picker}{controls}</form>',
        FIGURE,
        _note(_explained(len(order), len(shown), most, detail)),
        *blocks,
    )


FIGURE = (
    '<figure class="explorer">\n'
    '<div id="plot" tabindex="0" role="slider" aria-label="Position of the crosshair" '
    'aria-valuemin="0" aria-valuemax="0" aria-valuenow="0"></div>\n'
    '<div class="legend"><p id="readout"></p><ol id="legend"></ol>'
    '<p class="choice"><button type="button" id="all">show all</button>'
    '<button type="button" id="none">hide all</button></p></div>\n</figure>'
)


def _explained(methods: int, shown: int, most: int, detail: Detail) -> str:
    said = [
        "Best error so far, as steps; after its end (dot) a method keeps its answer. Methods stand "
        "in the order of their final median. Move over the figure, or give it the focus and use "
        "the arrow keys, to read the values; press a method to hide or show it."
    ]
    if most > 1:
        said.append("The line is the median over seeds, the band reaches from 10 to 90 %.")
    if most > detail.seeds:
        said.append(
            f"Of {most} seeds at most {detail.seeds} are drawn one by one, evenly over their final "
            f"errors; median and band are of all."
        )
    if shown < methods:
        said.append(f"Of {methods} methods the best {shown} are shown at first.")
    said.append(f"Curves are kept at {detail.positions} positions of an axis.")
    return " ".join(said)


def _look(style: MethodStyle) -> dict[str, Any]:
    width = style.width * PIXELS
    pattern = style.dashes[1] or ()
    return {
        "name": style.name,
        "color": style.color,
        "dash": " ".join(f"{width * length:.3g}" for length in pattern),
        "width": round(width, 2),
    }


def _problems(sweep: Sweep, best: Mapping[str, Best]) -> str:
    methods = printed(sweep.runs["optimizer"])
    opened = " open" if sweep.runs["problem"].nunique() <= OPEN else ""
    parts = []
    for name, runs in sweep.runs.groupby("problem", sort=False):
        found = final_errors(runs)
        first = best.get(str(name))
        parts.append(
            f"<details{opened}><summary><h3>{escape(str(name))}</h3> <span>"
            f"{escape(_summary(found))}</span></summary>\n"
            + table(found, "Final errors, the best median first")
            + (_best(first, methods) if first else "")
            + "</details>"
        )
    note = (
        "Final errors are over seeds; intervals are bootstrap intervals of the median. Evaluations "
        "and seconds are medians over whole runs. Parameters are those of the best run."
    )
    return _section("problems", "Problems", _note(note), *parts)


def _summary(found: pd.DataFrame) -> str:
    first = found.iloc[0]
    median = next(name for name in found.columns if name.startswith("median error"))
    unit = median.partition("[")[2].rstrip("]")
    return f"{first['method']} {first[median]} {unit}".replace(" -", "")


def _best(best: Best, methods: Mapping[str, str]) -> str:
    name = methods.get(best.method, best.method)
    caption = f"Parameters of the best run: {name}, seed {best.seed}"
    more = link(best.page, "Fit, validation, correlations and profiles") if best.page else ""
    return table(best.parameters, caption) + items(best.notes) + f"<p>{more}</p>" * bool(more)


def _claims(told: Told) -> str:
    if told.claims is None:
        return ""
    return _section("claims", "Claims of the paper", table(told.claims), _note(told.claims_note))


def _origin(sweep: Sweep) -> str:
    return _section(
        "origin",
        "Origin",
        _note("Digests are the first digits of SHA-256: equal digests mean equal code and data."),
        table(problems_table(sweep), "Problems"),
        table(methods_table(sweep), "Methods"),
        table(environment_table(sweep.origins.values()), "Environment of the runs"),
    )


def _skipped(sweep: Sweep) -> str:
    if sweep.damaged.empty:
        return ""
    return _section("damaged", "Damaged runs", table(sweep.damaged), _note("They are left out."))
