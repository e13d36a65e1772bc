"""The table of expected running times as a heat map: methods by problems."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from miho.analysis.figures import WIDTH, caption, house_style
from miho.analysis.ranks import ranks
from miho.analysis.running_time import at_factor
from miho.analysis.styles import styles_of
from miho.analysis.tidy import require_columns

ROW = 0.27  # inches per method, two lines of text
LETTER = 0.075  # inches of 8 pt text
PALEST = 3.15  # log10 of the ratio, so that 1000 is still told from white
DARK_UP_TO = 16.0


def ert_table(
    ert: pd.DataFrame,
    *,
    factor: float = 1.01,
    axis: str = "evaluations",
    order: pd.DataFrame | None = None,
    note: str = "",
) -> Figure:
    """Expected running time to `factor` times the optimum, by method and problem.

    Frame: as from `expected_running_time`. `order` (optimizer, rank) orders the methods and is
    printed, such as the ranks of the leaderboard; by default the ranks of the running times, of
    which all that are infinite on a problem share the last. Darker is faster, and the last line is
    what the best method of each problem needs, in the unit of `axis`.
    """
    rows = at_factor(ert, factor)
    methods = rows["optimizer"].nunique()
    with house_style():
        height = ROW * methods + LETTER * rows["problem"].str.len().max() + 1.2
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        ax = figure.subplots()
        mesh = plot_ert(rows, ax, axis=axis, order=order)
        bar = figure.colorbar(mesh, ax=ax, orientation="horizontal", aspect=50, pad=0.02)
        bar.set_label(f"expected {axis} to {factor:g} times the optimum / the best method's")
        bar.set_ticks([0, 1, 2, 3], labels=["1", "10", "100", "1000 or more"])
        text = "small: share of runs that arrived, if not all; -: never"
        caption(figure, text, note)
        figure.draw_without_rendering()
    return figure


def plot_ert(
    rows: pd.DataFrame, ax: Axes, *, axis: str, order: pd.DataFrame | None = None
) -> QuadMesh:
    """The cells of `ert_table`, for the rows of one factor; returns the coloured mesh.

    Its values (methods, problems) are log10 of the ratio to the best method's running time, NaN
    where there is none. A pair without runs stays empty and ranks as one that never arrives.
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
    ax.set_xlabel(f"expected {axis} of the best method", fontsize=8)
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
    """The text of one cell: the ratio, and below it the share of successes if that is not 1."""
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
    scale, suffix = next((one for one in scales if value < 999.5 * one[0]), scales[-1])
    shown = value / scale
    return f"{shown:.1f}{suffix}" if shown < 9.95 else f"{shown:.0f}{suffix}"
