"""The paper's figures of identification, for print at about 180 mm width: 4 and 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from miho.analysis.curves import Axis, log_grid, on_grid, summary, until
from miho.analysis.figures.house import (
    AXIS_LABELS,
    NARROW,
    EndLabel,
    caption,
    draw_end_labels,
    legend_below,
    new_figure,
    time_label,
)
from miho.analysis.styles import MethodStyle, distinct, styles_of
from miho.analysis.text import number
from miho.analysis.tidy import one_problem, shown_unit
from miho.analysis.timing import clock_of
from miho.analysis.variants import named_apart
from miho.figures.style import BLUE, RED
from miho.quantities import Array

Points = tuple[NDArray[np.float64], NDArray[np.float64]]
TIRE_NAMES = {"LF": "left front", "RF": "right front", "LR": "left rear", "RR": "right rear"}
TIRE_PANELS = (("LF", "RF"), ("LR", "RR"))


def fig4(
    samples: Mapping[str, Points],
    curves: Mapping[str, Points],
    *,
    errors: Mapping[str, float] | None = None,
    axle: tuple[Points, Mapping[str, AxleCurve]] | None = None,
    note: str = "",
) -> Figure:
    """Fig. 4: samples and learned curves of front and rear tires, and the front axle on a drive.

    Parameters
    ----------
    samples, curves : mapping of str to (ndarray, ndarray)
        For LF, RF, LR, RR, slip angle [deg] and lateral force [kN], both (n,). Tires without a
        curve show only samples, and the reverse.
    errors : mapping of str to float, optional
        Root mean square errors over the samples [kN] for the legends.
    axle : optional
        Data and curves of `plot_axle`; without them there are two panels.
    note : str
        Small text below the figure.

    Returns
    -------
    Figure
        Two or three panels.

    Raises
    ------
    ValueError
        For an unknown tire.
    """
    unknown = sorted((set(samples) | set(curves)) - set(TIRE_NAMES))
    if unknown:
        raise ValueError(f"tires {', '.join(unknown)} are unknown; expected LF, RF, LR or RR")
    with new_figure(3.7) as figure:
        panels = figure.subplots(1, 2 if axle is None else 3)
        panels[1].sharey(panels[0])
        for ax, tires, title in zip(panels, TIRE_PANELS, ("front", "rear"), strict=False):
            plot_tires(samples, curves, ax, tires=tires, errors=errors or {})
            ax.set_title(f"{title} tires", loc="left")
        panels[1].set_ylabel("")
        panels[1].tick_params(labelleft=False)
        if axle is not None:
            plot_axle(*axle, panels[2])
            panels[2].set_xlim(panels[0].get_xlim())
            panels[2].set_title("front axle, unseen drive", loc="left")
        caption(figure, note)
    return figure


def plot_tires(
    samples: Mapping[str, Points],
    curves: Mapping[str, Points],
    ax: Axes,
    *,
    tires: Sequence[str],
    errors: Mapping[str, float],
) -> Axes:
    """Samples as light points and learned curves as lines, for one or two tires, as in `fig4`.

    Parameters
    ----------
    samples, curves
        See `fig4`.
    ax : Axes
        The panel.
    tires : sequence of str
        Tires to draw.
    errors
        See `fig4`.

    Returns
    -------
    Axes
        The panel.
    """
    for tire, color, dashes in zip(tires, (BLUE, RED), ("-", "--"), strict=False):
        label = TIRE_NAMES[tire]
        if tire in errors:
            label += f", error {errors[tire]:.2f} kN"
        if tire in samples:
            alpha, force = samples[tire]
            ax.scatter(
                alpha, force, s=3, color=color, alpha=0.16, linewidths=0, rasterized=True, zorder=1
            )
        if tire in curves:
            alpha, force = curves[tire]
            ax.plot(alpha, force, dashes, color="white", linewidth=3.2, zorder=2)
            ax.plot(alpha, force, dashes, color=color, linewidth=1.8, label=label, zorder=3)
            legend_below(ax)
    ax.set(xlabel="slip angle [deg]", ylabel="lateral force [kN]")
    return ax


def fig6(runs: pd.DataFrame, curves: pd.DataFrame, *, note: str = "") -> Figure:
    """Fig. 6: mean error over time, and below it over evaluations, which no machine changes.

    Time is wall time, or CPU time if other work disturbed the runs, as `timing.clock_of` decides
    for the whole figure; the axis says which. The mean final error of each method is printed next
    to its curve in its colour; "-" if a run has no finite error, which leaves the mean undefined.
    A method with fewer runs than others has the number of them, as in "(2 of 5)".
    The grey band is the interval of the estimated irreducible error.

    Parameters
    ----------
    runs, curves : DataFrame
        As in `miho.load_runs`, of one problem. Runs of one method with different settings are drawn
        as different methods, for example `MIHO R=300`.
    note : str
        Small text below: sizes, repetitions, budget; by default empty.

    Returns
    -------
    Figure
        Two panels, 140 mm wide.

    Raises
    ------
    ValueError
        If there are several problems or units.
    """
    runs, curves = one_problem(runs, curves)
    unit = str(runs["unit"].iloc[0])
    shown_in, factor = shown_unit(unit)
    # The irreducible error, the common clock, and a hue for each method.
    low, high = float(runs["irreducible_low"].min()), float(runs["irreducible_high"].max())
    irreducible = (low, high) if np.isfinite(low) else None
    clock, styles = clock_of(runs), distinct(runs["optimizer"])
    ends = f"{_rounded(low * factor)} to {_rounded(high * factor)} {shown_in}"
    band = f"grey: irreducible error, {ends}"
    plot = partial(plot_error_over, unit=unit, irreducible=irreducible, styles=styles)
    with new_figure(6.1, NARROW) as figure:
        above, below = figure.subplots(2, 1, sharey=True, height_ratios=[1.15, 1])
        # Above over time, for comparable runs; below over evaluations, for all runs.
        timed = curves[curves["id"].isin(clock.runs["id"])]
        plot(timed, clock.axis, above)
        above.set_xlabel(time_label(clock))
        plot(curves, "evaluations", below)
        wall = clock.axis == "seconds"
        above.set_title("as in the paper: over time" if wall else "over CPU time", loc="left")
        below.set_title("the same over evaluations", loc="left")
        plain_log_ticks(above.yaxis)
        lines = "lines: mean over repetitions, bands: 10 to 90 %"
        disturbed = clock.note if wall else ""
        caption(figure, lines, band if irreducible else "", disturbed, note)
        draw_end_labels(above, _final_labels(runs, factor, styles), size=9)
    return figure


def plot_error_over(
    curves: pd.DataFrame,
    axis: Axis,
    ax: Axes,
    *,
    unit: str = "N",
    irreducible: tuple[float, float] | None = None,
    grid: Array | None = None,
    styles: Mapping[str, MethodStyle] | None = None,
) -> Axes:
    """Mean error of each method over the axis, with a band from the 10 % to the 90 % quantile.

    Both scales are logarithmic. After the last row of a method's runs its line continues thin, at
    the final value. Runs without rows are unknown here: see `tidy.with_silent_runs`.

    Parameters
    ----------
    curves : DataFrame
        As in `miho.load_runs`, of one problem.
    axis : {'evaluations', 'seconds', 'cpu_seconds'}
        The axis.
    ax : Axes
        The panel.
    unit : str
        Unit of `curves` and `irreducible`; forces are drawn in kN.
    irreducible : tuple of float, optional
        Interval of the irreducible error, drawn as a grey band.
    grid : ndarray, optional
        Positions on the axis; by default `log_grid`.
    styles : mapping of str to MethodStyle, optional
        By default the fixed styles of all methods.

    Returns
    -------
    Axes
        The panel.
    """
    curves = named_apart(curves, of_problem=())
    grid = log_grid(curves, axis) if grid is None else grid
    shown_in, factor = shown_unit(unit)
    means = summary(on_grid(curves, axis, grid), axis)
    ends = curves.groupby("optimizer")[axis].max()
    looks = styles_of(means["optimizer"]) if styles is None else styles
    looks = {method: style for method, style in looks.items() if method in ends}
    for order, (method, style) in enumerate(looks.items()):
        rows = means[means["optimizer"] == method]
        at = rows[axis].to_numpy(dtype=float)
        mean, low, high = (rows[c].to_numpy(dtype=float) * factor for c in ("mean", "low", "high"))
        running = until(at, ends[method])
        layer = 3 - 0.01 * order
        ax.fill_between(
            at[running], low[running], high[running], color=style.color, alpha=0.13, linewidth=0
        )
        ax.plot(at[running], mean[running], label=style.name, zorder=layer, **style.line)
        after_end = slice(running.stop - 1, None)
        ax.plot(at[after_end], mean[after_end], color=style.color, linewidth=0.6, zorder=layer)
    ax.set(xscale="log", yscale="log", xlim=(grid[0], grid[-1]))
    ax.xaxis.set_minor_formatter(NullFormatter())  # labels such as 2 x 10^-3 would overlap
    if grid[-1] < SHORT * grid[0]:
        plain_log_ticks(ax.xaxis)
    ax.set(xlabel=AXIS_LABELS[axis], ylabel=f"error [{shown_in}]")
    if irreducible is not None:
        low_end, high_end = (end * factor for end in irreducible)
        ax.axhspan(low_end, high_end, color="black", alpha=0.1, linewidth=0, zorder=0)
    ax.margins(y=0.06)
    return ax


def _final_labels(
    runs: pd.DataFrame, factor: float, styles: Mapping[str, MethodStyle]
) -> list[EndLabel]:
    """Mean final error per method, NaN if a run has none.

    A method with fewer runs than others has the number of them.
    """
    labels = []
    counts = runs["optimizer"].value_counts()
    most = counts.max()
    for method, style in styles.items():
        errors = runs.loc[runs["optimizer"] == method, "error"].to_numpy(dtype=float) * factor
        final = float(errors.mean()) if np.isfinite(errors).all() else float("nan")
        fewer = f" ({counts[method]} of {most})" * bool(counts[method] < most)
        labels.append(EndLabel(final, f"{_rounded(final)}  {style.name}{fewer}", style))
    return labels


def _rounded(error: float) -> str:
    """Two decimals from 0.1 to 10, as in the paper; three significant digits beyond."""
    return f"{error:.2f}" if 0.1 <= error < 10 else number(error)


def plain_log_ticks(axis: XAxis | YAxis) -> None:
    """Ticks at 1, 2, 5 times powers of ten, written as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


SHORT = 100
"""Ratio of the ends of a logarithmic axis that may show a single power of ten."""
MARGIN = 1.5
"""Range of slip angles of drawn curves, relative to the driving data."""


@dataclass(frozen=True)
class AxleCurve:
    """A curve: slip angles [deg] and forces [kN], and its root mean square error [kN] on the data.

    `learned` is the range of slip angles [deg] that identified it; outside it the curve is dashed.
    """

    points: Points
    error: float
    learned: tuple[float, float]


def fig4_right(data: Points, curves: Mapping[str, AxleCurve], *, note: str = "") -> Figure:
    """Fig. 4, right: driving data as light points, and curves by name.

    `data` are slip angles [deg] and lateral forces [kN] of the axle, both tires, (n,) each; no
    curve was identified from them.
    """
    with new_figure(3.6, 4.6) as figure:
        plot_axle(data, curves, figure.subplots())
        caption(figure, note)
    return figure


def plot_axle(data: Points, curves: Mapping[str, AxleCurve], ax: Axes) -> Axes:
    """Driving data and curves of an axle, as in `fig4_right`."""
    alpha, force = data
    opacity = min(max(500 / alpha.size, 0.12), 0.5)
    ax.scatter(alpha, force, s=4, color=BLUE, alpha=opacity, linewidths=0, rasterized=True)
    for (name, curve), color in zip(curves.items(), (RED, "black"), strict=False):
        at, forces = curve.points
        inside = (at >= curve.learned[0]) & (at <= curve.learned[1])
        label = f"{name}, error {curve.error:.2f} kN"
        ax.plot(at, forces, color=color, linewidth=0.9, linestyle=(0, (4, 2)))
        ax.plot(at[inside], forces[inside], color=color, linewidth=1.4, label=label)
    reach = MARGIN * float(np.abs(alpha).max())
    largest = 1.3 * float(np.abs(force).max())
    ax.set(xlim=(-reach, reach), ylim=(-largest, largest))
    ax.set(xlabel="slip angle [deg]", ylabel="lateral force, both tires [kN]")
    legend_below(ax)
    return ax
