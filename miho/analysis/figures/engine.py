"""The paper's figure of the engine: learned torque curves and the engine map that contains them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from miho.analysis.figures.house import caption, legend_below, new_figure
from miho.analysis.figures.paper import Points
from miho.figures.style import BLUE, COLORS
from miho.quantities import Array

LEVELS = np.arange(-200, 801, 50)
DASHED = (0, (4, 2))


def fig5(
    samples: Mapping[float, Points],
    curves: Mapping[float, Points],
    *,
    rpm: Array,
    throttle: Array,
    torque: Array,
    learned: Array,
    truth: Mapping[float, Points] | None = None,
    dyno: Mapping[float, Points] | None = None,
    errors: Mapping[float, float] | None = None,
    note: str = "",
) -> Figure:
    """Fig. 5: samples and learned torque curves (left), the integrated engine map (right).

    Parameters
    ----------
    samples, curves : mapping of float to (ndarray, ndarray)
        For each throttle opening in percent, engine speed [rpm] and torque [Nm], both (n,).
    rpm : ndarray of shape (M,)
        Engine speeds of the map [rpm].
    throttle : ndarray of shape (K,)
        Openings of the map [%].
    torque : ndarray of shape (K, M)
        Torque of the map [Nm].
    learned : ndarray of shape (K, M)
        Weight of the learned curves in the map; the interpolation uses them in the blue area.
    truth : mapping, optional
        True curves of the data, like `curves`.
    dyno : mapping, optional
        Measurements of a dyno, like `samples`.
    errors : mapping of float to float, optional
        Errors of the curves [Nm] for the legend.
    note : str
        Small text below the figure.

    Returns
    -------
    Figure
        Two panels.

    Raises
    ------
    ValueError
        If the map has the wrong shape.
    """
    shape = (throttle.size, rpm.size)
    for name, table in (("torque", torque), ("learned", learned)):
        if table.shape != shape:
            raise ValueError(
                f"{name} of the map has shape {table.shape}; expected {shape}, throttle by speed"
            )
    with new_figure(3.7) as figure:
        left, right = figure.subplots(1, 2)
        plot_torque_curves(
            samples, curves, left, truth=truth or {}, dyno=dyno or {}, errors=errors or {}
        )
        left.set_title("learned torque curves", loc="left")
        plot_engine_map(rpm, throttle, torque, learned, right)
        right.set_title("integrated engine map, torque [Nm]", loc="left")
        caption(figure, note)
    return figure


def plot_torque_curves(
    samples: Mapping[float, Points],
    curves: Mapping[float, Points],
    ax: Axes,
    *,
    truth: Mapping[float, Points],
    dyno: Mapping[float, Points],
    errors: Mapping[float, float],
) -> Axes:
    """Samples as light points, dyno points as crosses and learned curves as lines, as in `fig5`."""
    openings = sorted(set(samples) | set(curves))
    for opening, color in zip(openings, COLORS, strict=False):
        label = f"{opening:g} %"
        if opening in errors:
            label += f", error {errors[opening]:.1f} Nm"
        if opening in samples:
            ax.scatter(
                *samples[opening], s=3, color=color, alpha=0.16, linewidths=0, rasterized=True
            )
        if opening in dyno:
            ax.scatter(*dyno[opening], s=9, marker="x", color=color, linewidths=0.6, alpha=0.7)
        if opening in curves:
            ax.plot(*curves[opening], color="white", linewidth=3.2)
            ax.plot(*curves[opening], color=color, linewidth=1.8, label=label)
        if opening in truth:
            ax.plot(*truth[opening], color="black", linewidth=0.9, linestyle=DASHED)
    handles, _ = ax.get_legend_handles_labels()
    if truth:
        handles.append(Line2D([], [], color="black", linewidth=0.9, linestyle=DASHED, label="true"))
    if dyno:
        cross = Line2D([], [], color="#444444", linestyle="", marker="x", markersize=3)
        cross.set_label("dyno")
        handles.append(cross)
    legend_below(ax, handles, columns=2)
    ax.set(xlabel="engine speed [rpm]", ylabel="engine torque [Nm]")
    return ax


def plot_engine_map(rpm: Array, throttle: Array, torque: Array, learned: Array, ax: Axes) -> Axes:
    """Contours of the torque over engine speed and throttle; blue where learned curves are used.

    Parameters
    ----------
    rpm : ndarray of shape (M,)
        Engine speeds [rpm].
    throttle : ndarray of shape (K,)
        Openings [%].
    torque : ndarray of shape (K, M)
        Torque [Nm].
    learned : ndarray of shape (K, M)
        Weight of the learned curves, as in `EngineMap`.
    ax : Axes
        The panel.

    Returns
    -------
    Axes
        The panel.
    """
    inside = np.logical_and(torque.min() < LEVELS, torque.max() > LEVELS)
    ax.contourf(rpm, throttle, learned, levels=[1e-6, 1.5], colors=[BLUE], alpha=0.3)
    lines = ax.contour(
        rpm, throttle, torque, levels=LEVELS[inside], cmap="Greys", vmin=-400, linewidths=0.9
    )
    ax.clabel(lines, fontsize=7, colors="black", fmt="%g")
    for row, weight in zip(throttle, learned, strict=True):
        is_learned = weight > 0.999
        if is_learned.any():
            ax.plot(rpm[is_learned], np.full(is_learned.sum(), row), color=BLUE, linewidth=1.4)
    handles = [
        Patch(facecolor=BLUE, alpha=0.3, label="interpolated with learned curves"),
        Line2D([], [], color=BLUE, linewidth=1.4, label="learned curve"),
    ]
    legend_below(ax, handles)
    ax.set(xlabel="engine speed [rpm]", ylabel="throttle [%]", ylim=(0, 100))
    ax.grid(visible=False)
    return ax
