"""Figures of parameters that are tracked while rows arrive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from miho.analysis.figures.driving import ALARM, AMBER, DASHED, in_kmh
from miho.analysis.figures.house import caption, legend_above, new_figure
from miho.figures.style import BLUE, GREEN, PURPLE

COLORS = {"the offline value": PURPLE, "the tracker": BLUE, "the oracle": GREEN}
"""Colours of drivers by their source of the friction."""


def plot_parameter(
    states: pd.DataFrame, name: str, ax: Axes, *, alarms: Sequence[float] = ()
) -> Axes:
    """A tracked parameter with its 95 % interval over time [s], and its truth if it is known.

    Parameters
    ----------
    states : DataFrame
        Columns time, NAME, NAME_low and NAME_high, and NAME_true if the truth is known.
    name : str
        Name of the parameter.
    ax : Axes
        Panel.
    alarms : sequence of float, optional
        Times [s] of alarms, marked by vertical lines.

    Returns
    -------
    Axes
        The panel.
    """
    time = states["time"]
    ax.fill_between(
        time, states[f"{name}_low"], states[f"{name}_high"],
        color=BLUE, alpha=0.25, linewidth=0, label="95 % interval",
    )  # fmt: skip
    ax.plot(time, states[name], color=BLUE, linewidth=1.1, label="estimate")
    if f"{name}_true" in states:
        truth = states[f"{name}_true"]
        ax.plot(time, truth, color="black", linewidth=0.9, linestyle=DASHED, label="truth")
    for k, at in enumerate(alarms):
        label = "alarm" if k == 0 else None
        ax.axvline(at, color=ALARM, linewidth=1.2, label=label)
    ax.margins(x=0)
    ax.set_ylabel(name.replace("_", " "))
    legend_above(ax)
    return ax


def states_figure(
    states: pd.DataFrame, units: Mapping[str, str], alarms: Mapping[float, str]
) -> Figure:
    """Tracked parameters with their intervals over time, a panel for each.

    Parameters
    ----------
    states : DataFrame
        Columns of `plot_parameter`.
    units : mapping of str to str
        Unit of each parameter to draw.
    alarms : mapping of float to str
        Times [s] of alarms, and their words.

    Returns
    -------
    Figure
        The panels.
    """
    with new_figure(0.8 + 1.5 * len(units)) as figure:
        panels = figure.subplots(len(units), 1, sharex=True, squeeze=False)[:, 0]
        for (name, unit), ax in zip(units.items(), panels, strict=True):
            plot_parameter(states, name, ax, alarms=list(alarms))
            ax.set_ylabel(f"{ax.get_ylabel()} [{unit or '-'}]")
            if ax is not panels[0]:
                ax.get_legend().remove()
        panels[-1].set_xlabel("time [s]")
        caption(figure, "; ".join(alarms.values()))
    return figure


def grip_figure(
    states: pd.DataFrame, laps: Mapping[str, pd.DataFrame], alarms: Mapping[float, str],
    fall: float, *, note: str = "",
) -> Figure:  # fmt: skip
    """A lap in which the grip falls: tracked grip, speeds, and use of the true friction.

    Parameters
    ----------
    states : DataFrame
        Columns of `plot_parameter` for front_grip, relative to the known car.
    laps : mapping of str to DataFrame
        For each source of the friction a log with the columns time [s], vx [m/s] and use [-].
    alarms : mapping of float to str
        Times [s] of alarms, and their words.
    fall : float
        Time at which the grip begins to fall [s].
    note : str, optional
        Text below the figure.

    Returns
    -------
    Figure
        Three panels.
    """
    with new_figure(5.4) as figure:
        grip, velocity, use = figure.subplots(3, 1, sharex=True)
        plot_parameter(states, "front_grip", grip, alarms=list(alarms))
        grip.set_ylabel("front grip,\nrelative [-]")
        for name, lap in laps.items():
            style = {"color": COLORS.get(name, AMBER), "linewidth": 1.1, "label": name}
            velocity.plot(lap["time"], lap["vx"], **style)
            use.plot(lap["time"], lap["use"], **style)
        velocity.set_ylabel("velocity\n[m/s]")
        in_kmh(velocity)
        use.axhline(1.0, color="black", linewidth=0.8, linestyle=DASHED, label="limit")
        use.set(ylabel="use of the true\nfriction [-]", ylim=(0, 1.2), xlabel="time [s]")
        for ax in (velocity, use):
            ax.margins(x=0)
            legend_above(ax)
        for ax in (grip, velocity, use):
            ax.axvline(fall, color="#888888", linewidth=0.9, linestyle=":")
        words = "; ".join(alarms.values())
        caption(figure, f"dotted: the grip falls; red line: alarm, {words}", note)
    return figure


SCORES = {
    "error": ("mean error [%]", 100.0),
    "within_10": ("until within 10 % [s]", 1.0),
    "alarm": ("until the alarm [s]", 1.0),
}
"""For each score, its label and its factor."""


def scores_figure(scores: pd.DataFrame) -> Figure:
    """A panel per score of `SCORES`: seeds as light points, medians as dark ones, per tracker."""
    trackers = scores.groupby("tracker")["error"].median().sort_values().index.tolist()
    with new_figure(1.2 + 0.32 * len(trackers)) as figure:
        panels = figure.subplots(1, len(SCORES), sharey=True)
        for ax, (column, (label, factor)) in zip(panels, SCORES.items(), strict=True):
            for line, tracker in enumerate(trackers):
                values = factor * scores.loc[scores["tracker"] == tracker, column].astype(float)
                ax.scatter(values, np.full(len(values), line), s=9, color=BLUE, alpha=0.35)
                ax.plot(values.median(), line, "o", color="black", markersize=4)
            ax.margins(x=0.08)
            ax.set_xlabel(label)
            ax.set_xlim(left=0)
            ax.grid(axis="y", visible=False)
        panels[0].set_yticks(range(len(trackers)), trackers)
        panels[0].set_ylim(len(trackers) - 0.5, -0.5)
        caption(figure, "light points: seeds; dark: median; no point: never")
    return figure
