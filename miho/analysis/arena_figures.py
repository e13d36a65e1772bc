"""Curves of many methods on many problems: errors by problem, and shares of targets reached."""

from __future__ import annotations

import textwrap
from collections.abc import Collection

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, PercentFormatter
from numpy.typing import NDArray

from miho.analysis.curves import Array, Axis, log_grid, positions, step
from miho.analysis.end_labels import EndLabel, draw_end_labels
from miho.analysis.figures import AXIS_LABELS, WIDTH, caption, house_style, time_label
from miho.analysis.running_time import references
from miho.analysis.styles import MethodStyle, with_emphasis
from miho.analysis.tidy import comparison, require_columns
from miho.analysis.timing import Clock

COLUMNS = 4
GAP_FLOOR = 1e-6
GAP_CEILING = 1e3
"""Range of the relative gap that is drawn: below it sums of the loss differ between methods, above
it a curve says only that it has not begun."""
QUANTILES = (0.1, 0.5, 0.9)


def error_curves(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    *,
    axis: Axis = "evaluations",
    highlight: Collection[str] | None = None,
    note: str = "",
) -> Figure:
    """Relative gap to the best known error over the axis: a panel per problem, all on one scale.

    Lines are medians over repetitions; those to highlight (default: `styles.MAIN`) are in colour
    and have a band from the 10 % to the 90 % quantile, the others are grey. A problem without a
    known optimum is measured against the best error of all its runs (`running_time.references`)
    and has a star.
    """
    runs, curves = comparison(runs, curves)
    best_known = references(runs)
    starred = set(best_known.index[best_known["source"] != "known"])
    styles = with_emphasis(runs["optimizer"], highlight)
    problems = list(dict.fromkeys(runs["problem"]))
    grid = log_grid(curves, axis, 200)
    columns = min(COLUMNS, len(problems))
    rows = -(-len(problems) // columns)
    with house_style():
        figure = Figure(figsize=(WIDTH, 1.45 * rows + 1.1), layout="constrained")
        panels = np.ravel(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True))
        for ax, problem in zip(panels, problems, strict=False):
            mine = runs[runs["problem"] == problem]
            best = float(best_known.loc[problem, "error"])
            plot_gap(mine, curves[curves["problem"] == problem], axis, ax, best, grid, styles)
            title = textwrap.fill(f"{problem} *" if problem in starred else problem, 27)
            ax.set_title(title, loc="left", fontsize=8)
        for ax in panels[len(problems) :]:
            ax.remove()
        for ax in panels[len(problems) - columns : len(problems)]:
            ax.tick_params(labelbottom=True)
        for ax in panels[(rows - 1) * columns : len(problems)]:
            ax.set_xlabel(textwrap.fill(AXIS_LABELS[axis], 20), fontsize=8)
        figure.supylabel("relative gap", fontsize=9)
        _legend(figure, styles)
        text = "error / best known error - 1, gaps below $10^{-6}$ are drawn there"
        lines = "lines: median over repetitions, bands: 10 to 90 %"
        caption(figure, text, lines, "*: best of all runs" if starred else "", note)
        figure.draw_without_rendering()
    return figure


def plot_gap(
    runs: pd.DataFrame,
    curves: pd.DataFrame,
    axis: Axis,
    ax: Axes,
    best: float,
    grid: Array,
    styles: dict[str, MethodStyle],
) -> Axes:
    """error / `best` - 1 of one problem on `grid`, on two logarithmic scales, clipped to the range.

    A run without a value counts as infinitely bad, so a median begins where more than half of
    the runs have one, and a band where more than 90 % have. A line ends where the method's last
    run ended.
    """
    gaps = {key: rows / best - 1 for key, rows in _errors(runs, curves, axis, grid).items()}
    ends = runs.groupby("optimizer")[axis].max()
    for order, (method, style) in enumerate(styles.items()):
        if method not in gaps:
            continue
        low, median, high = np.quantile(gaps[method], QUANTILES, axis=0, method="higher")
        low, median, high = (
            np.where((grid <= ends[method]) & np.isfinite(one), one.clip(GAP_FLOOR), np.nan)
            for one in (low, median, high)
        )
        ax.plot(grid, median, zorder=2 + 0.01 * order, **style.line)
        if style != style.muted:
            ax.fill_between(grid, low, high, color=style.color, alpha=0.15, linewidth=0)
    ax.set(xscale="log", yscale="log", xlim=(grid[0], grid[-1]))
    ax.set_ylim(GAP_FLOOR / 2, GAP_CEILING)
    _powers_of_ten(ax.xaxis)
    _powers_of_ten(ax.yaxis)
    return ax


def ecdf_figure(
    over_evaluations: pd.DataFrame,
    over_time: pd.DataFrame,
    clock: Clock,
    *,
    highlight: Collection[str] | None = None,
    note: str = "",
) -> Figure:
    """Share of all (problem, repetition, target) reached, over evaluations and over time.

    Frames hold optimizer, the axis and share (runtime distributions as in COCO). The share of
    each method at the end of its evaluations stands at the right. The axis of `over_time` is that
    of the clock, which says which runs are left out.
    """
    with house_style():
        figure = Figure(figsize=(WIDTH, 4.3), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        plot_shares(over_evaluations, "evaluations", left, highlight=highlight)
        left.set(xlabel=AXIS_LABELS["evaluations"], ylabel="targets reached")
        plot_shares(over_time, clock.axis, right, highlight=highlight)
        right.set_xlabel(time_label(clock))
        said = "a target is one problem, repetition and distance to the optimum"
        caption(figure, said, clock.note if clock.axis == "seconds" else "", note)
        label_shares(over_evaluations, "evaluations", right, highlight=highlight)
    return figure


def profiles_figure(
    data_profile: pd.DataFrame,
    performance_profile: pd.DataFrame,
    *,
    highlight: Collection[str] | None = None,
    note: str = "",
) -> Figure:
    """Data profile (More and Wild 2009) and performance profile (Dolan and More 2002).

    Frames hold optimizer, kappa or tau, and share. kappa counts evaluations per (d + 1); tau is
    the ratio to the best method of each problem. The shares at the right end are written out.
    """
    with house_style():
        figure = Figure(figsize=(WIDTH, 4.3), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        plot_shares(data_profile, "kappa", left, highlight=highlight)
        plot_shares(performance_profile, "tau", right, highlight=highlight)
        left.set_title("data profile", loc="left")
        left.set(xlabel="evaluations / (dimension + 1)", ylabel="share solved")
        right.set_title("performance profile", loc="left")
        right.set_xlabel("expected running time / best method's")
        caption(figure, "left: share of runs, right: share of problems", note)
        label_shares(performance_profile, "tau", right, highlight=highlight)
    return figure


def plot_shares(
    frame: pd.DataFrame, x: str, ax: Axes, *, highlight: Collection[str] | None = None
) -> Axes:
    """The step function `share` over column `x` of each method, on a logarithmic scale of x."""
    require_columns(frame, ["optimizer", x, "share"], "frame")
    for order, (method, style) in enumerate(with_emphasis(frame["optimizer"], highlight).items()):
        one = frame[frame["optimizer"] == method].sort_values(x)
        ax.step(one[x], one["share"], where="post", zorder=2 + 0.01 * order, **style.line)
    at = frame[x].to_numpy(dtype=float)
    at = at[np.isfinite(at) & (at > 0)]
    ax.set(xscale="log", ylim=(0, 1.02))
    if at.size and at.min() < at.max():
        ax.set_xlim(at.min(), at.max())
    ax.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    _powers_of_ten(ax.xaxis)
    return ax


def label_shares(
    frame: pd.DataFrame, x: str, ax: Axes, *, highlight: Collection[str] | None = None
) -> None:
    """The last share of each method, with its name, beside the right edge of its panel.

    Of equal ones the method with the larger mean share, which was there earlier, stands higher.
    """
    shares = frame.sort_values(x, kind="stable").groupby("optimizer")["share"]
    last, mean = shares.last(), shares.mean()
    styles = with_emphasis(frame["optimizer"], highlight)
    labels = [
        EndLabel(last[one], f"{100 * last[one]:3.0f} %  {styles[one].name}", styles[one])
        for one in sorted(styles, key=lambda method: (last[method], mean[method]))
    ]
    draw_end_labels(ax, labels)


def _errors(
    runs: pd.DataFrame, curves: pd.DataFrame, axis: Axis, grid: Array
) -> dict[str, NDArray[np.float64]]:
    """Errors (n, g) of each method's n runs on the grid; inf where a run has no value yet."""
    at, errors = positions(curves, axis), curves["error"].to_numpy(dtype=float)
    rows = curves.groupby("id").indices
    none = np.full(grid.size, np.inf)
    found: dict[str, list[Array]] = {}
    for method, run in zip(runs["optimizer"], runs["id"], strict=True):
        index = rows.get(run)
        one = none if index is None else step(at[index], errors[index], grid)
        found.setdefault(method, []).append(np.where(np.isnan(one), np.inf, one))
    return {method: np.array(ones) for method, ones in found.items()}


def _legend(figure: Figure, styles: dict[str, MethodStyle]) -> None:
    """One legend above the panels: the methods in the foreground, and the rest as one."""
    front = [style for style in styles.values() if style != style.muted]
    back = [style for style in styles.values() if style == style.muted]
    handles = [Line2D([], [], label=style.name, **style.line) for style in front]
    if back:
        handles.append(Line2D([], [], label=f"{len(back)} others", **back[0].line))
    figure.legend(handles=handles, loc="outside upper left", ncols=5, handlelength=2.6)


def _powers_of_ten(axis: XAxis | YAxis) -> None:
    """At most six labelled ticks, none between powers of ten."""
    axis.set_major_locator(LogLocator(numticks=6))
    axis.set_minor_formatter(NullFormatter())
