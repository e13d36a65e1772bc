"""Figures of the cost of evaluations and runs, from the benchmarks' tidy frames."""

from __future__ import annotations

import pandas as pd
import seaborn as sns
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from miho.analysis.tidy import require_columns
from miho.figures.style import WIDTH, house_style

BLUE, ORANGE, GREEN, RED = sns.color_palette("colorblind").as_hex()[:4]
BLACK = "#222222"
ARRIVAL_COLOURS = {
    "miho_gn": RED, "miho_qn": ORANGE, "least_squares": BLUE, "one look": BLACK,
}  # fmt: skip
SENSITIVITY_COLOURS = {
    "values": BLUE, "values, batch": GREEN, "and sensitivities": RED, "and differences": ORANGE,
}  # fmt: skip
BAR_HEIGHT = 0.22  # inches
LABEL_ROOM = 2.2
"""Factor by which a logarithmic axis extends beyond its longest bar, so that its label fits."""


def arrival_figure(frame: pd.DataFrame) -> Figure:
    """Median milliseconds to the optimum over the rows. Frame: rows, method, ms; a row per run."""
    require_columns(frame, {"rows", "method", "ms"}, "frame")
    median = frame.groupby(["rows", "method"])["ms"].median().reset_index()
    return _over_rows(median, "ms", ARRIVAL_COLOURS, "time to within 1 % of the optimum [ms]")


def sensitivity_figure(frame: pd.DataFrame) -> Figure:
    """Microseconds per evaluation of a simulated car over the rows. Frame: rows, method, us."""
    require_columns(frame, {"rows", "method", "us"}, "frame")
    return _over_rows(frame, "us", SENSITIVITY_COLOURS, "time per evaluation [µs]")


def _over_rows(frame: pd.DataFrame, value: str, colours: dict[str, str], label: str) -> Figure:
    """A line per method, half a page wide."""
    with house_style():
        figure = Figure(figsize=(WIDTH / 2, 3.0), layout="constrained")
        ax = figure.subplots()
        _lines(frame, ax, "method", value, colours)
        ax.set_ylabel(label)
        ax.legend()
        figure.draw_without_rendering()
    return figure


def run_figure(frame: pd.DataFrame) -> Figure:
    """Seconds of a run by its form, and speed-ups. Frame: form, seconds, speedup."""
    require_columns(frame, {"form", "seconds", "speedup"}, "frame")
    texts = [f"{s:.3g} s, {x:.3g} times" for s, x in zip(frame["seconds"], frame["speedup"],
             strict=True)]  # fmt: skip
    with house_style():
        figure = Figure(figsize=(WIDTH, 1 + BAR_HEIGHT * len(frame)), layout="constrained")
        ax = _bars(figure.subplots(), frame["form"], frame["seconds"], texts)
        ax.set_xlabel("time of one run [s]")
        figure.draw_without_rendering()
    return figure


def overhead_figure(frame: pd.DataFrame) -> Figure:
    """Microseconds per evaluation of each method without the loss. Frame: kind, name, us."""
    require_columns(frame, {"kind", "name", "us"}, "frame")
    rows = frame[(frame["kind"] == "method") & frame["us"].gt(0)].sort_values("us")
    with house_style():
        figure = Figure(figsize=(WIDTH, 1 + BAR_HEIGHT * len(rows)), layout="constrained")
        texts = [f"{us:.3g}" for us in rows["us"]]
        ax = _bars(figure.subplots(), rows["name"], rows["us"], texts)
        ax.set_xlabel("time per evaluation without the loss [µs]")
        figure.draw_without_rendering()
    return figure


def _lines(frame: pd.DataFrame, ax: Axes, by: str, value: str, colours: dict[str, str]) -> None:
    for name, colour in colours.items():
        rows = frame[frame[by] == name].sort_values("rows")
        ax.plot(rows["rows"], rows[value], color=colour, marker="o", markersize=3, label=name)
    ax.set(xscale="log", yscale="log", xlabel="rows of the data")


def _bars(ax: Axes, names: pd.Series, values: pd.Series, texts: list[str]) -> Axes:
    """Horizontal bars on a logarithmic axis, the first on top, each with its text."""
    bars = ax.barh(range(len(names)), values, color=BLUE, height=0.7)
    ax.set_yticks(range(len(names)), labels=list(names))
    ax.invert_yaxis()
    ax.set_xscale("log")
    ax.set_xlim(right=LABEL_ROOM**2 * float(values.max()))
    ax.bar_label(bars, labels=texts, padding=3, fontsize=8)
    ax.grid(False, axis="y")
    return ax
