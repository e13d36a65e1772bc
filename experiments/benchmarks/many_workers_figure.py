"""Figure of the duration of a search by many workers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from miho.analysis.figures.house import new_figure
from miho.analysis.tidy import require_columns
from miho.figures.style import COLORS

DASHES = ("solid", (0, (4, 1.5)), (0, (1, 1.2)), "dashdot")
MARKERS = ("o", "s", "^", "D")
GREY = "#777777"
PANELS = {
    "equal": "evaluations of equal length",
    "log-normal": "spread log-normally (σ = 0.7)",
    "measured": "spread as in a simulation",
}


def many_workers_figure(frame: pd.DataFrame) -> Figure:
    """Wall time over workers, a line per method with quartiles, a panel per spread of durations.

    The frame has the columns kind, method, workers, spread, seed and seconds (NaN if the optimum
    was not reached); rows of a kind other than `simulated` are ignored.
    """
    require_columns(frame, {"kind", "method", "workers", "spread", "seed", "seconds"}, "frame")
    with new_figure(3.8) as figure:
        panels = figure.subplots(1, len(PANELS), sharex=True, sharey=True)
        for ax, (spread, title) in zip(panels, PANELS.items(), strict=True):
            rows = frame[(frame["spread"] == spread) & (frame["kind"] == "simulated")]
            for k, (name, line) in enumerate(rows.groupby("method", sort=False)):
                _band(ax, line, str(name), k)
            _ideal(ax, rows)
            ax.set(xscale="log", yscale="log", xlabel="workers")
            ax.set_title(title, loc="left")
        panels[0].set_ylabel("time to 1.01 of the optimum\n[mean evaluations]")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _band(ax: Axes, line: pd.DataFrame, name: str, k: int) -> None:
    """The median over seeds, with the quartiles as a band."""
    quartiles, look = _quartiles(line), _look(k)
    ax.fill_between(
        quartiles.index, quartiles[0.25], quartiles[0.75], color=look["color"], alpha=0.18, lw=0
    )
    ax.plot(quartiles.index, quartiles[0.5], label=name, **look)


def _quartiles(line: pd.DataFrame) -> pd.DataFrame:
    """Quartiles over seeds by workers; a run that missed the target counts as the slowest."""
    seconds = line.assign(seconds=line["seconds"].fillna(float("inf"))).groupby("workers")
    return (
        seconds["seconds"].quantile(np.array([0.25, 0.5, 0.75]), interpolation="nearest").unstack()
    )


def _ideal(ax: Axes, rows: pd.DataFrame) -> None:
    """The time of the first method with one worker, divided by the workers."""
    line = _quartiles(rows[rows["method"] == rows["method"].iloc[0]])[0.5]
    ideal = line.iloc[0] * line.index[0] / line.index.to_series()
    ideal = ideal[ideal >= rows["seconds"].min()]
    ax.plot(ideal.index, ideal, color=GREY, linewidth=0.8, label="MIHO with ideal workers")


def _look(k: int) -> dict[str, Any]:
    """Colour, dashes and marker, so that lines also differ in print without colours."""
    return {
        "color": COLORS[k % len(COLORS)],
        "linestyle": DASHES[k % len(DASHES)],
        "marker": MARKERS[k % len(MARKERS)],
        "markersize": 3.5,
    }
