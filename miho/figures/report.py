"""Figures of one identification: the fit, its descents, trends in the errors, and its profiles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from miho.figures.style import BLUE, COLORS, GREEN, ORANGE, RED, WIDTH, house_style
from miho.quantities import Array

BLACK = "#222222"
POINTS = (BLUE, RED, GREEN, ORANGE, *COLORS[4:6])
"""Colors of parts, used cyclically."""
BINS = 10
PANELS = 3
LOGARITHMIC = 5.0
CROWDED = 50.0
"""Rows are crowded on a linear axis if the largest value is this multiple of their median."""
LEAST_RANGE = 0.1
GRID = 400
"""Number of points of a drawn curve."""


def _opacity(points: int) -> float:
    """Few points are opaque, many show their density."""
    return float(np.clip(150 / points, 0.15, 0.7))


def _size(points: int) -> float:
    """Area of a point [pt^2]: few points are large."""
    return float(np.clip(1200 / points, 4, 16))


@dataclass(frozen=True)
class Column:
    """Values (N,) with the name and unit of their axis."""

    name: str
    unit: str
    values: Array

    @property
    def label(self) -> str:
        """Name and unit for an axis."""
        return in_unit(self.name, self.unit)

    @property
    def scale(self) -> str:
        """The scale of an axis: "log" if half of positive values are far below the largest."""
        low, middle, high = np.quantile(self.values, [0, 0.5, 1])
        return "log" if low > 0 and CROWDED * middle < high else "linear"


def in_unit(name: str, unit: str) -> str:
    """A name with its unit in brackets, if the unit is known."""
    return f"{name} [{unit}]" if unit else name


def curve_of(
    inputs: Sequence[Column], ordered: bool, band: Callable[..., tuple[Array, Array]]
) -> tuple[Column, tuple[Array, Array, Array]] | tuple[None, None]:
    """The input over which a fit is a curve, with x, values and half widths of the curve.

    This is a single input, or the first input of a model that needs all rows in order, if it rises
    from row to row, as the time of a simulation does. Otherwise both are None. `band` gives values
    and half widths at inputs (N,); an ordered model needs them at its rows, others on an even grid.
    """
    x, *others = inputs
    if not ordered and not others:
        grid_of = np.geomspace if x.scale == "log" else np.linspace
        grid = grid_of(x.values.min(), x.values.max(), GRID)
        return x, (grid, *band(grid))
    if not ordered or (others and (np.diff(x.values) <= 0).any()):
        return None, None
    curve, half = band(*(column.values for column in inputs))
    rising = np.argsort(x.values, kind="stable")
    return x, (x.values[rising], curve[rising], half[rising])


def fit_figure(
    measured: Column,
    predicted: Array,
    x: Column | None,
    band: tuple[Array, Array, Array] | None,
    parts: Mapping[str, NDArray[np.bool_]] | None = None,
) -> Figure:
    """Data and fit: over an input `x` with the curve's `band` (x, curve, half width).

    Without `x`, measured over predicted values (N,): the points of a perfect model are on the
    diagonal. Rows of each of the `parts` (N,) of a joint problem have a separate color.
    """
    with house_style():
        figure = Figure(figsize=(WIDTH * 0.75, 3.0), layout="constrained")
        plot_fit(measured, predicted, x, band, parts, figure.subplots())
    return figure


def plot_fit(
    measured: Column,
    predicted: Array,
    x: Column | None,
    band: tuple[Array, Array, Array] | None,
    parts: Mapping[str, NDArray[np.bool_]] | None,
    ax: Axes,
) -> Axes:
    """Draw the content of `fit_figure` into existing axes."""
    opacity, size = _opacity(len(measured.values)), _size(len(measured.values))
    style: dict[str, Any] = {"s": size, "alpha": opacity, "linewidths": 0, "rasterized": True}
    if x is not None and band is not None:
        ax.scatter(x.values, measured.values, label="data", color=BLUE, **style)
        at, curve, half = band
        ax.fill_between(at, curve - half, curve + half, color=RED, alpha=0.3, linewidth=0)
        ax.plot(at, curve, color=RED, linewidth=1.5, label="fit, with the curve's interval")
        ax.set(xlabel=x.label, ylabel=measured.label, xscale=x.scale)
    else:
        shown = parts or {"rows of data": np.ones(len(predicted), dtype=bool)}
        for (label, part), color in zip(shown.items(), cycle(POINTS), strict=False):
            ax.scatter(predicted[part], measured.values[part], label=label, color=color, **style)
        both = np.append(predicted, measured.values)
        ends = [both.min(), both.max()]
        color = BLACK if parts else RED
        ax.plot(ends, ends, color=color, linewidth=1, label="prediction = measurement")
        ax.set(xlabel=f"predicted {measured.label}", ylabel=f"measured {measured.label}")
    for handle in ax.legend(loc="best", markerscale=4 / size**0.5).legend_handles:
        if handle is not None:
            handle.set_alpha(1)
    return ax


def waterfall_figure(
    errors: Array,
    ended_here: NDArray[np.bool_],
    unit: str,
    best_known: float | None,
    rounding: float,
    kind: str = "descents",
    dropped: int = 0,
) -> Figure:
    """Final errors (n,) of the descents of a run, ascending: each optimum is a step.

    Parameters
    ----------
    errors : ndarray of shape (n,)
        Final errors of the descents.
    ended_here : bool ndarray of shape (n,)
        Descents that ended in this optimum, drawn with filled marks.
    unit : str
        Unit of the errors.
    best_known : float or None
        Error of the best known optimum.
    rounding : float
        Smaller errors are drawn at this value.
    kind : str
        Kind of the descents, for example brackets.
    dropped : int
        Number of descents that were dropped on fewer rows, whose errors are unknown; the legend
        shows it.

    Returns
    -------
    Figure
        The axis is logarithmic if errors differ by a factor of LOGARITHMIC. Otherwise it spans at
        least LEAST_RANGE of them, so that equal errors are level.
    """
    heights = np.maximum(errors, rounding)
    number = np.arange(1, len(errors) + 1)
    with house_style():
        figure = Figure(figsize=(WIDTH * 0.75, 2.4), layout="constrained")
        ax = figure.subplots()
        ax.plot(number, heights, color="#999999", linewidth=0.8, zorder=1)
        size = float(np.clip(900 / len(errors), 6, 24))
        for part, label, color, filled in ((ended_here, "ended here", BLUE, True),
                                           (~ended_here, "elsewhere", RED, False)):  # fmt: skip
            if part.any():
                ax.scatter(
                    number[part], heights[part], s=size, edgecolors=[color], linewidths=0.8,
                    color=[color] if filled else "white", label=f"{label}: {part.sum():,}",
                )  # fmt: skip
        if dropped:
            ax.plot([], [], " ", label=f"dropped on fewer rows: {dropped:,}")
        low, high = float(heights[0]), float(heights[-1])
        if best_known is not None:
            low = min(low, max(best_known, rounding))
            ax.axhline(max(best_known, rounding), color="#222222", linewidth=0.9, linestyle="--",
                       zorder=0, label="best known optimum")  # fmt: skip
        if high > LOGARITHMIC * low > 0:
            ax.set_yscale("log")
            ax.yaxis.set_major_locator(LogLocator(subs=(1,) if high > 100 * low else (1, 2, 5)))
            ax.yaxis.set_major_formatter("{x:g}")
            ax.yaxis.set_minor_formatter(NullFormatter())
        else:
            middle, half = (low + high) / 2, 0.6 * max(high - low, LEAST_RANGE * high)
            ax.set_ylim(middle - half, middle + half)
        ax.set(xlabel=f"{kind}, the best first", ylabel=in_unit("error", unit))
        ax.set_xlim(0.5, len(errors) + 0.5)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]))
        figure.legend(*ax.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure


def residual_figure(
    errors: Column, columns: Sequence[Column], parts: Mapping[str, NDArray[np.bool_]] | None = None
) -> Figure:
    """Errors (model minus data) over each column, with means of groups of rows.

    The `parts` (N,) of a joint problem are drawn separately, or else the rows with the first column
    below and above its median: the effect of a load on a force has the sign of the slip, and would
    cancel in the mean over both.
    """
    has_legend = bool(parts) or len(columns) > 1
    if not parts:
        name, above = columns[0].name, columns[0].values > np.median(columns[0].values)
        parts = {f"{name} below its median": ~above, f"{name} above it": above}
    with house_style():
        rows = -(-len(columns) // PANELS)
        width = WIDTH if len(columns) > 1 else WIDTH * 0.6
        figure = Figure(figsize=(width, 2.3 * rows), layout="constrained")
        across = min(PANELS, len(columns))
        panels = np.ravel(figure.subplots(rows, across, squeeze=False, sharey=True))
        for ax, column in zip(panels, columns, strict=False):
            plot_errors_over(errors, column, parts, ax)
        for ax in panels[len(columns) :]:
            ax.remove()
        for place in range(1, len(columns)):
            if place % PANELS:
                panels[place].set_ylabel("")
        if has_legend:
            handles = panels[0].lines[: len(parts)]
            figure.legend(handles, list(parts), loc="outside upper right", ncols=4)
    return figure


def plot_errors_over(
    errors: Column, column: Column, parts: Mapping[str, NDArray[np.bool_]], ax: Axes
) -> Axes:
    """Errors over one column as points, in `parts` (N,), each with means of equally many rows."""
    opacity = _opacity(len(errors.values))
    for part, color in zip(parts.values(), cycle(POINTS), strict=False):
        rows = np.flatnonzero(part)
        rows = rows[np.argsort(column.values[rows], kind="stable")]
        groups = [group for group in np.array_split(rows, BINS) if group.size]
        x = [column.values[group].mean() for group in groups]
        y = [errors.values[group].mean() for group in groups]
        ax.plot(x, y, color=color, marker="o", markersize=2.5, linewidth=1, zorder=3)
        ax.scatter(
            column.values[rows], errors.values[rows], s=3, color=color, alpha=opacity,
            linewidths=0, rasterized=True,
        )  # fmt: skip
    ax.axhline(0, color="#444444", linewidth=0.6)
    ax.set(xlabel=column.label, ylabel=errors.label, xscale=column.scale)
    return ax


def profile_figure(
    profiles: Mapping[str, tuple[Array, Array]], units: Mapping[str, str], quantile: float
) -> Figure:
    """Signed root of the likelihood ratio over each parameter; straight lines for a linear model.

    `profiles` maps names to (values, tau). The interval is between the lines at +-`quantile`.
    """
    with house_style():
        rows = -(-len(profiles) // PANELS)
        figure = Figure(figsize=(WIDTH, 1.9 * rows), layout="constrained")
        panels = np.ravel(figure.subplots(rows, PANELS, squeeze=False, sharey=True))
        for ax, (name, (values, tau)) in zip(panels, profiles.items(), strict=False):
            ax.axhline(-quantile, color="#888888", linewidth=0.7, linestyle="--")
            ax.axhline(quantile, color="#888888", linewidth=0.7, linestyle="--")
            ax.plot(values, tau, color=BLUE, marker="o", markersize=2.5, linewidth=1.2)
            ax.set(xlabel=in_unit(name, units[name]))
            ax.locator_params(axis="x", nbins=4, steps=[1, 2, 5, 10])
            ax.ticklabel_format(axis="x", scilimits=(-2, 4), useMathText=True)
        for ax in panels[len(profiles) :]:
            ax.remove()
        for ax in panels[: len(profiles) : PANELS]:
            ax.set_ylabel("signed root")
    return figure
