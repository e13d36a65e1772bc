"""Figures with a row per method: areas, ranks, and speed-ups over rivals."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter

from miho.analysis.figures.house import caption, new_figure
from miho.analysis.styles import MethodStyle, styles_of
from miho.analysis.text import number
from miho.analysis.tidy import require_columns
from miho.quantities import Array
from miho.validate import one_of

ROW = 0.19  # inches per method where a row is one line of 8 pt text
DARK, LIGHT, GUIDE = "#222222", "#9a9a9a", "#d8d8d8"


def area_figure(areas: pd.DataFrame, *, note: str = "") -> Figure:
    """Area over the convergence curve of each method, best mean first.

    The frame has the columns problem, optimizer, aocc, with a row per run. Grey points are the
    means of the problems, the box shows their quartiles and median, the diamond their mean; all
    problems have the same weight.
    """
    height = ROW * areas["optimizer"].nunique() + 0.9
    with new_figure(height) as figure:
        plot_areas(areas, figure.subplots())
        text = "points: problems (mean over runs), boxes: quartiles, diamonds and numbers: means"
        caption(figure, text, note)
    return figure


def plot_areas(areas: pd.DataFrame, ax: Axes) -> Axes:
    """The rows of `area_figure`."""
    require_columns(areas, ["problem", "optimizer", "aocc"], "areas")
    table = areas.groupby(["optimizer", "problem"])["aocc"].mean().unstack()
    mean = table.mean(axis="columns").sort_values(ascending=False, kind="stable")
    styles = method_rows(ax, mean.index)
    for row, method in enumerate(mean.index):
        values, color = table.loc[method].dropna().to_numpy(dtype=float), styles[method].color
        ax.boxplot(
            values, positions=[row], orientation="horizontal", widths=0.55, manage_ticks=False,
            showfliers=False, patch_artist=True, medianprops={"color": color, "linewidth": 1.4},
            boxprops={"facecolor": "white", "edgecolor": color, "linewidth": 0.9},
            whiskerprops={"color": color, "linewidth": 0.9}, showcaps=False,
        )  # fmt: skip
        ax.scatter(values, np.full(values.size, row), s=5, color="#777777", linewidths=0, zorder=3)
        ax.scatter(mean[method], row, s=26, marker="D", color=color, edgecolors="white", zorder=4,
                   clip_on=False)  # fmt: skip
        ax.text(1.01, row, f"{mean[method]:.2f}", transform=ax.get_yaxis_transform(),
                fontsize=8, va="center_baseline")  # fmt: skip
    ax.set(xlim=(0, 1), xlabel="area over the convergence curve (1: at the optimum at once)")
    return ax


def critical_difference_diagram(
    ranks: pd.DataFrame,
    cd: float,
    cliques: Sequence[Collection[str]],
    *,
    sample: str = "",
    note: str = "",
) -> Figure:
    """Mean ranks and cliques that are not separated (Demsar 2006, Fig. 1), with a row per method.

    A bar next to the rows joins the methods of a clique, between which the test finds no
    difference; methods without a common bar differ.

    Parameters
    ----------
    ranks : DataFrame
        Columns optimizer and rank (1 is best).
    cd : float
        Critical difference, drawn to scale at the top.
    cliques : sequence of collection of str
        Groups of methods that the test does not separate.
    sample : str, optional
        Describes the sample of the mean ranks, for example "12 problems".
    note : str, optional
        Text below the figure.

    Returns
    -------
    Figure
        The diagram.
    """
    with new_figure(ROW * len(ranks) + 1.1) as figure:
        wide = min(0.4, 0.05 + 0.025 * len(cliques))
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=[1 - wide, wide])
        plot_ranks(ranks, cd, left)
        plot_cliques(ranks, cliques, right)
        over = f" over {sample}" if sample else ""
        left.set_xlabel(f"mean rank{over} (1: best)")
        caption(figure, "bars at the right join methods that the test does not separate", note)
    return figure


def plot_ranks(ranks: pd.DataFrame, cd: float, ax: Axes) -> Axes:
    """Mean ranks as dots in rows, best first, with the critical difference from the best."""
    require_columns(ranks, ["optimizer", "rank"], "ranks")
    rank = ranks.set_index("optimizer")["rank"].sort_values(kind="stable")
    styles = method_rows(ax, rank.index)
    for row, (method, value) in enumerate(rank.items()):
        color = styles[str(method)].color
        ax.axhline(row, color=GUIDE, linewidth=0.6, zorder=1)
        ax.scatter(value, row, s=24, color=color, zorder=3)
        ax.annotate(f"{value:.1f}", (value, row), xytext=(5, 0), textcoords="offset points",
                    fontsize=8, va="center_baseline")  # fmt: skip
    first = float(rank.iloc[0])
    ax.axvspan(first, first + cd, color="#e8eef5", zorder=0, linewidth=0)
    ax.plot([first, first + cd], [-1, -1], color=DARK, linewidth=1.2, marker="|", markersize=6)
    ax.text(first, -1.3, f"critical difference {cd:.2f}", fontsize=8, va="bottom")
    ax.set_ylim(len(rank) - 0.5, -2.2)
    largest = max(len(rank), first + cd)
    ax.set_xlim(1 - 0.02 * largest, 1.04 * largest)
    spacing = 5 if len(rank) > 9 else 1
    ticks = [place for place in range(1, len(rank) + 1) if place == 1 or place % spacing == 0]
    ax.xaxis.set_major_locator(FixedLocator(ticks))
    return ax


def plot_cliques(ranks: pd.DataFrame, cliques: Sequence[Collection[str]], ax: Axes) -> Axes:
    """A vertical bar per clique, on the rows of `plot_ranks`, with a dot at each member."""
    rank = ranks.set_index("optimizer")["rank"].sort_values(kind="stable")
    spans = sorted(
        sorted(rank.index.get_indexer(pd.Index(list(clique))))
        for clique in cliques
        if len(clique) > 1
    )
    for column, rows in enumerate(spans):
        if rows[0] < 0:
            raise ValueError(
                f"a clique has a method without a rank; expected some of {', '.join(rank.index)}"
            )
        ax.plot([column] * len(rows), rows, color=DARK, linewidth=1.3, marker="o", markersize=3)
    for row in range(len(rank)):
        ax.axhline(row, color=GUIDE, linewidth=0.6, zorder=0)
    ax.set_xlim(-0.7, max(1, len(spans)) - 0.3)
    ax.tick_params(left=False, labelleft=False, bottom=False, labelbottom=False)
    ax.spines[:].set_visible(False)
    ax.grid(visible=False)
    return ax


def speed_up_figure(speed_ups: pd.DataFrame, *, method: str, note: str = "") -> Figure:
    """How many times faster `method` is than each rival, with 95 % intervals.

    The frame has the columns method, rival, ratio (rival's expected running time / the method's),
    low, high, problems (that both solve), only_method and only_rival. Above 1 `method` is faster;
    grey and hollow marks mean that the interval contains 1.
    """
    rivals = int((speed_ups["method"] == method).sum())
    with new_figure(ROW * rivals + 1.1) as figure:
        plot_speed_up(speed_ups, figure.subplots(), method=method)
        caption(figure, "hollow and grey: undecided, the 95 % interval contains 1", note)
    return figure


def plot_speed_up(speed_ups: pd.DataFrame, ax: Axes, *, method: str) -> Axes:
    """The rows of `speed_up_figure`, largest ratio first."""
    require_columns(
        speed_ups,
        ["method", "rival", "ratio", "low", "high", "problems", "only_method", "only_rival"],
        "speed_ups",
    )
    rows = speed_ups[speed_ups["method"] == method].sort_values("ratio", ascending=False)
    one_of("method", method, sorted(speed_ups["method"].unique()))
    method_rows(ax, rows["rival"])
    values = rows[["ratio", "low", "high"]].to_numpy(dtype=float)
    finite = values[np.isfinite(values) & (values > 0)]
    low, high = min(0.5, finite.min(initial=1)) / 1.3, max(2, finite.max(initial=1)) * 1.3
    solved = rows[["problems", "only_method", "only_rival"]].to_numpy(dtype=int)
    beside: dict[str, Any] = {"transform": ax.get_yaxis_transform(), "fontsize": 8, "ha": "right"}
    for row, (interval, counts) in enumerate(zip(values, solved, strict=True)):
        _speed_up_row(ax, row, interval, (low, high))
        text = "-" if np.isnan(interval[0]) else f"{number(interval[0])}×"
        for x, words in ((1.11, text), (1.28, " / ".join(map(str, counts)))):
            ax.text(x, row, words, va="center_baseline", **beside)
    name = styles_of([method])[method].name
    ax.text(1.28, -0.7, f"solved by both /\n{name} / rival only", va="bottom", **beside)
    ax.axvline(1, color=DARK, linewidth=1)
    ax.set(xscale="log", xlim=(low, high))
    ax.set_xlabel(f"expected evaluations of the rival / of {name} (right of 1: {name} is faster)")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 100 * low else (1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    return ax


def _speed_up_row(ax: Axes, row: int, interval: Array, limits: tuple[float, float]) -> None:
    """A ratio with its interval (3,); a triangle if it extends beyond the panel."""
    ratio, low, high = interval
    if np.isnan(ratio):
        return
    undecided = low <= 1 <= high
    color = LIGHT if undecided else DARK
    ends = np.clip([low, high], *limits)
    ax.plot(ends, [row, row], color=color, linewidth=1.6, solid_capstyle="butt", zorder=2)
    face = "white" if undecided else color
    ax.scatter(ratio, row, s=26, color=face, edgecolors=color, linewidths=1.2, zorder=3)
    for value, end, marker in ((low, limits[0], "<"), (high, limits[1], ">")):
        if not limits[0] <= value <= limits[1]:
            ax.scatter(end, row, s=22, marker=marker, color=color, clip_on=False, zorder=3)


def method_rows(ax: Axes, methods: Collection[str]) -> dict[str, MethodStyle]:
    """Set up a row per method, first at the top, its name in its colour; return their styles."""
    styles = styles_of(methods)
    ax.yaxis.set_major_locator(FixedLocator(list(range(len(methods)))))
    ax.set_yticklabels([styles[method].name for method in methods])
    for tick, method in zip(ax.get_yticklabels(), methods, strict=True):
        tick.set_color(styles[method].color)
    ax.set_ylim(len(methods) - 0.4, -0.6)
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)
    return styles
