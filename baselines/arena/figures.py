"""Figures of many methods on many problems: errors, targets reached and running times."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, PercentFormatter
from numpy.typing import NDArray

from miho.analysis.compare.running_time import NEAR_BEST, at_factor, references
from miho.analysis.compare.significance import ranks
from miho.analysis.curves import log_grid, positions, step, until
from miho.analysis.figures.house import (
    AXIS_LABELS,
    NARROW,
    EndLabel,
    caption,
    draw_end_labels,
    new_figure,
    time_label,
)
from miho.analysis.styles import MethodStyle, styles_of, with_emphasis
from miho.analysis.tidy import comparison, require_columns
from miho.analysis.timing import Clock
from miho.quantities import Array

COLUMNS = 3
GAP_FLOOR = 1e-6
GAP_CEILING = 1e3
"""Limits of the relative gap that is drawn. Below them sums of the loss differ between methods;
above them a curve has not begun to improve."""
QUANTILES = (0.1, 0.5, 0.9)
LOWER, LABEL = 2.4, 0.17
"""Heights [inches] of a panel without labels of methods, and of a label."""


def error_curves(runs: pd.DataFrame, curves: pd.DataFrame, *, note: str = "") -> Figure:
    """Relative gap to the best known error: a panel per problem, all on one scale.

    Lines are medians over repetitions. The methods in `styles.MAIN` are in colour
    and have a band from the 10 % to the 90 % quantile; the others are grey. A problem without a
    known optimum is compared with the best error of all its runs (`running_time.references`) and
    marked with a star.

    Parameters
    ----------
    runs, curves : DataFrame
        As in `miho.load_runs`.
    note : str, optional
        Text below the figure.

    Returns
    -------
    Figure
        The panels.
    """
    runs, curves = comparison(runs, curves)
    best_known = references(runs)
    starred = set(best_known.index[best_known["source"] != "known"])
    styles = with_emphasis(runs["optimizer"])
    problems = list(dict.fromkeys(runs["problem"]))
    grid = log_grid(curves, "evaluations", 200)
    columns = min(COLUMNS, len(problems))
    rows = -(-len(problems) // columns)
    with new_figure(1.45 * rows + 1.7, NARROW) as figure:
        panels = np.ravel(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True))
        for ax, problem in zip(panels, problems, strict=False):
            of_problem = runs[runs["problem"] == problem]
            best = float(best_known.loc[problem, "error"])
            plot_gap(of_problem, curves[curves["problem"] == problem], ax, best, grid, styles)
            title = f"{problem} *" if problem in starred else problem
            title = textwrap.fill(title.replace("_", "_ "), 25).replace("_ ", "_")
            ax.set_title(title, loc="left", fontsize=8)
        low, high = panels[0].get_ylim()  # limits of the curves in all panels
        panels[0].set_ylim(max(low, GAP_FLOOR / 2), min(high, GAP_CEILING))
        for ax in panels[len(problems) :]:
            ax.remove()
        for ax in panels[len(problems) - columns : len(problems)]:
            ax.tick_params(labelbottom=True)
        for ax in panels[(rows - 1) * columns : len(problems)]:
            ax.set_xlabel(textwrap.fill(AXIS_LABELS["evaluations"], 20), fontsize=8)
        figure.supylabel("relative gap", fontsize=9)
        _legend(figure, styles)
        text = "error / best known error - 1, gaps below $10^{-6}$ are drawn there"
        lines = "lines: median over repetitions, bands: 10 to 90 %"
        caption(figure, text, lines, "*: best of all runs" if starred else "", note)
    return figure


def plot_gap(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    ax: Axes,
    best: float,
    grid: Array,
    styles: dict[str, MethodStyle],
) -> Axes:
    """error / `best` - 1 of one problem on `grid`, on two logarithmic scales, clipped to the range.

    A run without a value counts as infinitely bad, so a median begins when more than half of the
    runs have a value, and a band when more than 90 % have one. A line ends with the method's last
    run.
    """
    gaps = {key: rows / best - 1 for key, rows in _errors(runs, curves, grid).items()}
    ends = runs.groupby("optimizer")["evaluations"].max()
    for order, (method, style) in enumerate(styles.items()):
        if method not in gaps:
            continue
        low, median, high = np.quantile(gaps[method], QUANTILES, axis=0, method="higher")
        running = until(grid, ends[method])
        low, median, high = (
            np.where(np.isfinite(q), q.clip(GAP_FLOOR), np.nan)[running]
            for q in (low, median, high)
        )
        ax.plot(grid[running], median, zorder=2 + 0.01 * order, **style.line)
        if style != style.muted:
            ax.fill_between(grid[running], low, high, color=style.color, alpha=0.15, linewidth=0)
    ax.set(xscale="log", yscale="log", xlim=(grid[0], grid[-1]))
    _powers_of_ten(ax.xaxis)
    _powers_of_ten(ax.yaxis)
    return ax


def ecdf_figure(
    over_evaluations: pd.DataFrame, over_time: pd.DataFrame, clock: Clock, *, note: str = ""
) -> Figure:
    """Share of all (problem, repetition, target) reached, over evaluations and over time.

    The frames have the columns optimizer, the axis and share (runtime distributions as in COCO).
    The share of each method at the end of its evaluations is printed next to its curve. The axis of
    `over_time` is the axis of the clock, whose note says which runs are excluded.
    """
    with _stacked(over_evaluations) as (figure, above, below):
        plot_shares(over_evaluations, "evaluations", above)
        above.set(xlabel=AXIS_LABELS["evaluations"], ylabel="targets reached")
        plot_shares(over_time, clock.axis, below)
        below.set(xlabel=time_label(clock), ylabel="targets reached")
        explanation = "a target is one problem, repetition and distance to the optimum"
        caption(figure, explanation, clock.note if clock.axis == "seconds" else "", note)
        label_shares(over_evaluations, "evaluations", above)
    return figure


def profiles_figure(
    data_profile: pd.DataFrame, performance_profile: pd.DataFrame, *, note: str = ""
) -> Figure:
    """Performance profile (Dolan and More 2002) and data profile (More and Wild 2009).

    The shares at the end of the performance profile are printed.

    Parameters
    ----------
    data_profile : DataFrame
        Columns optimizer, kappa (evaluations per d + 1) and share.
    performance_profile : DataFrame
        Columns optimizer, tau (ratio to the best method of each problem) and share.
    note : str, optional
        Text below the figure.

    Returns
    -------
    Figure
        Two panels.
    """
    with _stacked(performance_profile) as (figure, above, below):
        plot_shares(performance_profile, "tau", above)
        plot_shares(data_profile, "kappa", below)
        above.set_title("performance profile", loc="left")
        above.set(xlabel="running time / best method's", ylabel="problems solved")
        below.set_title("data profile", loc="left")
        below.set(xlabel="evaluations / (dimension + 1)", ylabel="runs that succeed")
        caption(figure, note)
        label_shares(performance_profile, "tau", above)
    return figure


@contextmanager
def _stacked(frame: pd.DataFrame) -> Iterator[tuple[Figure, Axes, Axes]]:
    """Two panels that a phone can show; the upper one has room for a label of each method."""
    upper = max(LOWER, LABEL * frame["optimizer"].nunique())
    with new_figure(upper + LOWER + 1.7, NARROW) as figure:
        above, below = figure.subplots(2, 1, sharey=True, height_ratios=[upper, LOWER])
        yield figure, above, below


def plot_shares(frame: pd.DataFrame, x: str, ax: Axes) -> Axes:
    """The step function `share` over column `x` of each method, on a logarithmic scale of x."""
    require_columns(frame, ["optimizer", x, "share"], "frame")
    for order, (method, style) in enumerate(with_emphasis(frame["optimizer"]).items()):
        rows = frame[frame["optimizer"] == method].sort_values(x)
        ax.step(rows[x], rows["share"], where="post", zorder=2 + 0.01 * order, **style.line)
    at = frame[x].to_numpy(dtype=float)
    at = at[np.isfinite(at) & (at > 0)]
    ax.set(xscale="log", ylim=(0, 1.02))
    if at.size and at.min() < at.max():
        ax.set_xlim(at.min(), at.max())
    ax.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    _powers_of_ten(ax.xaxis)
    return ax


def label_shares(frame: pd.DataFrame, x: str, ax: Axes) -> None:
    """Print the last share of each method and its name at the right edge of its panel.

    Of equal shares the method with the larger mean share, which reached it earlier, is higher.
    """
    shares = frame.sort_values(x, kind="stable").groupby("optimizer")["share"]
    last, mean = shares.last(), shares.mean()
    styles = with_emphasis(frame["optimizer"])
    labels = [
        # The share has three digits, padded by spaces as wide as a digit.
        EndLabel(last[name], f"{100 * last[name]:\u2007>3.0f} %  {styles[name].name}", styles[name])
        for name in sorted(styles, key=lambda method: (last[method], mean[method]))
    ]
    draw_end_labels(ax, labels)


def _errors(
    runs: pd.DataFrame, curves: pd.DataFrame, grid: Array
) -> dict[str, NDArray[np.float64]]:
    """Errors (n, g) of each method's n runs on the grid; inf before a run has a value."""
    at, errors = positions(curves, "evaluations"), curves["error"].to_numpy(dtype=float)
    rows = curves.groupby("id").indices
    no_value = np.full(grid.size, np.inf)
    by_method: dict[str, list[Array]] = {}
    for method, run in zip(runs["optimizer"], runs["id"], strict=True):
        index = rows.get(run)
        run_errors = no_value if index is None else step(at[index], errors[index], grid)
        by_method.setdefault(method, []).append(np.where(np.isnan(run_errors), np.inf, run_errors))
    return {method: np.array(of_method) for method, of_method in by_method.items()}


def _legend(figure: Figure, styles: dict[str, MethodStyle]) -> None:
    """One legend above the panels: the methods in the foreground, and the others together."""
    front = [style for style in styles.values() if style != style.muted]
    back = [style for style in styles.values() if style == style.muted]
    handles = [Line2D([], [], label=style.name, **style.line) for style in front]
    if back:
        label = back[0].name if len(back) == 1 else f"{len(back)} others"
        handles.append(Line2D([], [], label=label, **back[0].line))
    figure.legend(handles=handles, loc="outside upper left", ncols=3, handlelength=2.6)


def _powers_of_ten(axis: XAxis | YAxis) -> None:
    """At most six labelled ticks, none between powers of ten."""
    axis.set_major_locator(LogLocator(numticks=6))
    axis.set_minor_formatter(NullFormatter())


ROW = 0.27  # inches per method, two lines of text
LETTER = 0.075  # inches of 8 pt text
PALEST = 3.15  # log10 of the ratio, so that 1000 differs visibly from white
DARK_UP_TO = 16.0


def ert_table(
    ert: pd.DataFrame,
    *,
    factor: float = NEAR_BEST,
    order: pd.DataFrame | None = None,
    note: str = "",
) -> Figure:
    """Expected running time to `factor` times the optimum, by method and problem.

    Darker cells are faster, and the last line is the cost of the best method of each problem, in
    evaluations.

    Parameters
    ----------
    ert : DataFrame
        As from `expected_running_time`.
    factor : float, optional
        Target, as a multiple of the best known error.
    order : DataFrame, optional
        Columns optimizer and rank, which order the methods and are printed, for example the ranks
        of the leaderboard. By default the ranks of the running times; infinite times on a problem
        share the last rank.
    note : str, optional
        Text below the figure.

    Returns
    -------
    Figure
        The table.
    """
    rows = at_factor(ert, factor)
    methods = rows["optimizer"].nunique()
    height = ROW * methods + LETTER * rows["problem"].str.len().max() + 1.2
    with new_figure(height) as figure:
        ax = figure.subplots()
        mesh = plot_ert(rows, ax, order=order)
        bar = figure.colorbar(mesh, ax=ax, orientation="horizontal", aspect=50, pad=0.02)
        bar.set_label(f"expected evaluations to {factor:g} times the optimum / the best method's")
        bar.set_ticks([0, 1, 2, 3], labels=["1", "10", "100", "1000 or more"])
        text = "small: share of successful runs, if not all; -: never"
        caption(figure, text, note)
    return figure


def plot_ert(rows: pd.DataFrame, ax: Axes, *, order: pd.DataFrame | None = None) -> QuadMesh:
    """The cells of `ert_table`, for the rows of one factor; returns the coloured mesh.

    Its values (methods, problems) are log10 of the ratio to the best method's running time, NaN if
    there is none. A pair without runs stays empty and ranks like a method that never reaches the
    target.
    """
    require_columns(rows, ["problem", "optimizer", "success", "ert"], "ert")
    cost = rows.pivot(index="optimizer", columns="problem", values="ert")
    order = ranks(cost.fillna(np.inf).T) if order is None else order
    rank = order.set_index("optimizer")["rank"].sort_values(kind="stable")
    cost = cost.loc[rank.index, list(dict.fromkeys(rows["problem"]))]
    success = rows.pivot(index="optimizer", columns="problem", values="success")
    success = success.loc[cost.index, cost.columns]
    best = cost.min().where(lambda value: np.isfinite(value))
    ratio = (cost / best).replace(np.inf, np.nan).to_numpy(dtype=float)
    mesh = ax.pcolormesh(np.log10(ratio), cmap="Blues_r", vmin=0, vmax=PALEST,
                         edgecolors="white", linewidth=1)  # fmt: skip
    for (row, column), share in np.ndenumerate(success.to_numpy(dtype=float)):
        if not np.isnan(share):
            _write(ax, column + 0.5, row, float(ratio[row, column]), share)
    styles = styles_of(rank.index)
    names = [f"{styles[str(method)].name}  {value:4.1f}" for method, value in rank.items()]
    ax.set_yticks(np.arange(len(names)) + 0.5, labels=names)
    places = np.arange(len(best)) + 0.5
    ax.set_xticks(places, labels=[short(value) for value in best])
    ax.set_xlabel("expected evaluations of the best method", fontsize=8)
    top = ax.secondary_xaxis("top")
    top.set_xticks(places, labels=list(cost.columns), rotation=90)
    ax.text(-0.01, 1.01, "mean rank", transform=ax.transAxes, ha="right", va="bottom", fontsize=8)
    for side in (ax, top):
        side.tick_params(length=0)
        side.spines[:].set_visible(False)
    ax.grid(visible=False)
    ax.invert_yaxis()
    return mesh


def _write(ax: Axes, x: float, row: int, ratio: float, share: float) -> None:
    """Write the text of one cell: the ratio, and below it the share of successes unless it is 1."""
    partly = 0 < share < 1
    place: dict[str, Any] = {"ha": "center", "va": "center"}
    place["color"] = "white" if ratio < DARK_UP_TO else "black"
    ax.text(x, row + (0.32 if partly else 0.5), short(ratio), fontsize=8, **place)
    if partly:
        ax.text(x, row + 0.73, f"{100 * share:.0f} %", fontsize=7, **place)


def short(value: float) -> str:
    """Two or three significant digits with k, M or G: four characters below 1e12; "-" for NaN."""
    if np.isnan(value):
        return "-"
    scales = ((1.0, ""), (1e3, "k"), (1e6, "M"), (1e9, "G"))
    scale, suffix = next((entry for entry in scales if value < 999.5 * entry[0]), scales[-1])
    mantissa = value / scale
    return f"{mantissa:.1f}{suffix}" if mantissa < 9.95 else f"{mantissa:.0f}{suffix}"
