"""Figure of an experimental design: the chosen rows, and the intervals that they narrow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from miho.analysis.figures.house import new_figure
from miho.figures.style import BLUE, RED

BINS = 40
GREY, PALE = "#6e6e6e", "#cfcfcf"


def design_figure(rows: pd.DataFrame, table: pd.DataFrame) -> Figure:
    """Two panels: the rows over one or two inputs, and half widths before and after.

    Parameters
    ----------
    rows : DataFrame
        A column for each input, of which the first two that vary are drawn, and the column `row`:
        present, candidate or chosen.
    table : DataFrame
        The column `quantity` and the half widths of `miho.identification.Design.table`.

    Returns
    -------
    Figure
        The panels.
    """
    every = [name for name in rows.columns if name != "row"]
    inputs = [name for name in every if rows[name].nunique() > 1] or every[:1]
    with new_figure(max(2.4, 0.8 + 0.22 * len(table))) as figure:
        left, right = figure.subplots(1, 2)
        if len(inputs) == 1:
            plot_rows_over_input(rows, inputs[0], left)
        else:
            plot_rows_over_inputs(rows, inputs[0], inputs[1], left)
        plot_narrowing(table, right)
        figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=3)
        figure.legend(*right.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure


def plot_rows_over_input(rows: pd.DataFrame, name: str, ax: Axes) -> Axes:
    """Numbers of present and chosen rows along one input."""
    edges = np.histogram_bin_edges(rows[name], BINS).tolist()
    present, chosen = (rows.loc[rows["row"] == part, name] for part in ("present", "chosen"))
    ax.hist(present, edges, color=PALE, label="present rows")
    ax.hist(chosen, edges, color=RED, alpha=0.8, label="chosen rows")
    candidates = rows.loc[rows["row"] == "candidate", name]
    ax.plot(candidates, np.zeros(len(candidates)), "|", color=GREY, markersize=3,
            label="candidates", clip_on=False)  # fmt: skip
    ax.set(xlabel=name, ylabel="rows")
    return ax


def plot_rows_over_inputs(rows: pd.DataFrame, x: str, y: str, ax: Axes) -> Axes:
    """The rows over two inputs; rows that are chosen more often have larger marks."""
    styles: dict[str, dict[str, Any]] = {
        "candidate": {"s": 3, "color": PALE, "label": "candidates"},
        "present": {"s": 5, "color": GREY, "alpha": 0.6, "label": "present rows"},
    }
    for part, style in styles.items():
        points = rows[rows["row"] == part]
        ax.scatter(points[x], points[y], linewidths=0, rasterized=True, **style)
    times = rows[rows["row"] == "chosen"].groupby([x, y]).size()
    places = times.index.to_frame()
    ax.scatter(places[x], places[y], s=10 * np.sqrt(times), facecolors="none", edgecolors=RED,
               linewidths=0.9, label="chosen rows")  # fmt: skip
    ax.set(xlabel=x, ylabel=y)
    return ax


def plot_narrowing(table: pd.DataFrame, ax: Axes) -> Axes:
    """Half widths in % of the present ones, a line per quantity, from the top.

    A quantity that the present data do not determine has no present half width: it is labelled, not
    drawn.
    """
    present = table["present half width"]
    finite = np.isfinite(present) & (present > 0)
    place = [-float(i) for i in range(len(table))]
    expected, evenly = (
        (100 * table[f"{state} half width"] / present).where(finite)
        for state in ("expected", "evenly")
    )
    ax.hlines(place, expected, 100, color=PALE, linewidth=1.5, zorder=1)
    ax.scatter(
        evenly, place, s=18, facecolors="white", edgecolors=GREY, label="with rows spread evenly"
    )
    ax.scatter(expected, place, s=18, color=BLUE, label="with chosen rows")
    for at, row in zip(place, table.to_dict("records"), strict=True):
        if np.isinf(row["present half width"]):
            determined = np.isfinite(row["expected half width"])
            ax.text(3, at, "determined for the first time" if determined else "not determined",
                    va="center", fontsize=7, color=GREY)  # fmt: skip
    ax.set_yticks(place, table["quantity"])
    ax.set(xlim=(0, 105), xlabel="half width [% of the present one]")
    return ax
