"""The paper's comparison (Fig. 6), once per reading of settings that it does not specify."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from miho.analysis.curves import log_grid
from miho.analysis.figures.house import caption, new_figure
from miho.analysis.figures.paper import plain_log_ticks, plot_error_over
from miho.analysis.styles import styles_of

COLUMNS = 3
TITLE_WIDTH = 34


def readings_figure(readings: Mapping[str, pd.DataFrame], *, note: str = "") -> Figure:
    """Mean error of the paper's five methods over evaluations, a panel per reading.

    `readings` has the curves of each reading by its words, as from
    `baselines.arena.readings.frames_of`. Errors are in N and drawn in kN.
    """
    rows = -(-len(readings) // COLUMNS)
    curves = pd.concat(readings.values(), ignore_index=True)
    grid = log_grid(curves, "evaluations", 250)
    with new_figure(0.6 + 1.75 * rows) as figure:
        panels = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
        axes = list(panels.flat)
        for ax, (words, of_reading) in zip(axes, readings.items(), strict=False):
            plot_error_over(of_reading, "evaluations", ax, grid=grid)
            ax.set_title(textwrap.fill(words, TITLE_WIDTH), loc="left", fontsize=8)
            for level in (0.5, 1.0):
                ax.axhline(level, color="#888888", linewidth=0.6, linestyle=":")
            ax.set(xlabel="", ylabel="")
            plain_log_ticks(ax.yaxis)
        for ax in axes[: len(readings)][-COLUMNS:]:
            ax.tick_params(labelbottom=True)
            ax.set_xlabel("evaluations of the full loss", fontsize=8)
        for ax in axes[len(readings) :]:
            ax.set_visible(False)
        figure.supylabel("mean error [kN]", fontsize=9)
        styles = styles_of(curves["optimizer"])
        handles = [Line2D([], [], label=style.name, **style.line) for style in styles.values()]
        figure.legend(handles=handles, loc="outside upper left", ncols=len(handles))
        caption(figure, "lines: mean over repetitions, bands: 10 to 90 %", note)
    return figure
