"""Figures of the field tests: obstacle avoidance, laps at speed, and comparisons of laps."""

from __future__ import annotations

import math
import textwrap

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from miho.analysis.compare.bootstrap import mean_error
from miho.analysis.figures.house import caption, legend_above, new_figure
from miho.figures.style import BLUE, GREEN, RED

AMBER = "#f0b756"
ALARM = "#b00020"
DASHED = (0, (4, 2))
KMH = 3.6
LEAST_RANGE = 5.0
"""Smallest range of the axis of velocities [m/s], so that noise does not fill it."""
BANDS = (
    (40.0, math.inf, "#dfe6ee", "above 40 m/s (144 km/h)"),
    (42.0, 52.0, "#f6d9a8", "42-52 m/s (151-187 km/h)"),
)
"""Velocities [m/s] that the paper analyses separately (Sec. V-B.2), with their background
colours."""


def fig7(
    log: pd.DataFrame, *, obstacle: float | None = None,
    departure: tuple[float, str] | None = None, excess: str = "", note: str = "",
) -> Figure:  # fmt: skip
    """Fig. 7: velocity, lateral acceleration within its limits, and steering, over time.

    An additional panel, which the paper lacks, shows the use of the planned friction.

    Parameters
    ----------
    log : DataFrame
        The columns of `miho.vehicle.driving.simulation.Drive`, and planned_use [-].
    obstacle : float, optional
        Time [s] when the car passes it, marked in all panels.
    departure : (float, str), optional
        Time [s] when the car left the road, marked in all panels, and its label.
    excess : str
        Description of how the car exceeded the planned friction.
    note : str
        Text below the figure.

    Returns
    -------
    Figure
        Four panels.
    """
    with new_figure(5.8) as figure:
        velocity, lateral, steering, friction = figure.subplots(4, 1, sharex=True)
        plot_velocity(log, velocity, over="time")
        plot_lateral(log, lateral)
        plot_steering(log, steering)
        plot_use(log, friction)
        for ax in (velocity, lateral, steering, friction):
            ax.margins(x=0)
            if obstacle is not None:
                ax.axvline(obstacle, color="#888888", linewidth=0.9, linestyle=":")
        lines = [f"red: beyond the planned friction {excess}"] if excess else []
        if departure is not None:
            _mark_departure(figure, departure[0])
            lines.append(f"red line: {departure[1]}")
        _alarm(figure, lines)
        friction.set_xlabel("time [s]")
        caption(figure, "" if obstacle is None else "dotted: at the obstacle", note)
    return figure


def fig8(
    log: pd.DataFrame, *, laps: list[float] | None = None,
    departure: tuple[float, str] | None = None, note: str = "",
) -> Figure:  # fmt: skip
    """Fig. 8: errors of position and heading, velocity, throttle and brake, over the distance.

    An additional panel, which the paper lacks, shows the error of the velocity, over `BANDS`.

    Parameters
    ----------
    log : DataFrame
        The columns of `miho.vehicle.driving.simulation.Drive`.
    laps : list of float, optional
        Distances [m] of the starts of laps, marked in all panels.
    departure : (float, str), optional
        Distance [m] where the car left the road, marked in all panels, and its label.
    note : str
        Text below the figure.

    Returns
    -------
    Figure
        Five panels.
    """
    with new_figure(7.2) as figure:
        panels = figure.subplots(5, 1, sharex=True)
        position, heading, velocity, error, pedals = panels
        plot_error(log, log["e_y"], "position\nerror [m]", position)
        plot_error(log, np.degrees(log["e_psi"]), "heading\nerror [deg]", heading)
        plot_velocity(log, velocity, over="distance")
        plot_velocity_error(log, error)
        plot_pedals(log, pedals)
        for ax in panels:
            ax.margins(x=0)
            for start in laps or []:
                ax.axvline(start / 1000, color="#bbbbbb", linewidth=0.7, linestyle=":", zorder=0)
        if departure is not None:
            _mark_departure(figure, departure[0] / 1000)
            _alarm(figure, [f"red line: {departure[1]}"])
        pedals.set_xlabel("distance [km]")
        caption(figure, "dotted: start of a lap" if laps else "", note)
    return figure


def plot_velocity(log: pd.DataFrame, ax: Axes, *, over: str) -> Axes:
    """Driven and desired velocity [m/s] over the time [s] or the distance [km].

    The axis on the right is in km/h.
    """
    at = log["time"] if over == "time" else log["distance"] / 1000
    ax.plot(at, log["v_des"], color=AMBER, linewidth=3.2, label="desired")
    ax.plot(at, log["vx"], color=BLUE, linewidth=1.1, label="driven")
    low, high = ax.get_ylim()
    spare = max(LEAST_RANGE - (high - low), 0.0) / 2
    ax.set(ylabel="velocity\n[m/s]", ylim=(low - spare, high + spare))
    in_kmh(ax)
    legend_above(ax)
    return ax


def plot_lateral(log: pd.DataFrame, ax: Axes) -> Axes:
    """Lateral acceleration [m/s^2], driven and planned, between the planned limits, over time.

    Parts that exceed the planned friction are red.
    """
    t, beyond = log["time"], log["planned_use"] > 1
    ax.plot(t, log["ay_plan"], color=AMBER, linewidth=3.2, label="planned")
    ax.plot(t, log["ay"], color=BLUE, linewidth=1.1, label="driven")
    ax.plot(t, log["ay_limit"], color="black", linewidth=0.8, linestyle=DASHED, label="limit")
    ax.plot(t, -log["ay_limit"], color="black", linewidth=0.8, linestyle=DASHED)
    _red(ax, t, log["ay"], beyond)
    ax.set_ylabel("lateral accel.\n[m/s²]")
    legend_above(ax)
    return ax


def plot_steering(log: pd.DataFrame, ax: Axes) -> Axes:
    """Angle of the road wheels [deg], commanded and driven, over time."""
    t = log["time"]
    ax.plot(t, np.degrees(log["u_steering"]), color=AMBER, linewidth=3.2, label="command")
    ax.plot(t, np.degrees(log["steering"]), color=BLUE, linewidth=1.1, label="driven")
    ax.set_ylabel("steering of the\nroad wheels [deg]")
    legend_above(ax)
    return ax


def plot_use(log: pd.DataFrame, ax: Axes) -> Axes:
    """Use of the planned friction [-] over time; red above 1."""
    t, use = log["time"], log["planned_use"]
    ax.plot(t, use, color=BLUE, linewidth=1.1, label="driven")
    ax.axhline(1.0, color="black", linewidth=0.8, linestyle=DASHED, label="limit")
    _red(ax, t, use, use > 1)
    ax.set(ylabel="use of planned\nfriction [-]", ylim=(0, max(1.15, 1.05 * float(use.max()))))
    legend_above(ax)
    return ax


def plot_error(log: pd.DataFrame, values: pd.Series[float], label: str, ax: Axes) -> Axes:
    """Values over the distance [km], with their largest magnitude as a label."""
    ax.plot(log["distance"] / 1000, values, color=BLUE, linewidth=0.9)
    ax.axhline(0.0, color="black", linewidth=0.6)
    largest = float(values.abs().max())
    ax.set_ylim(-1.45 * largest, 1.45 * largest)
    unit = label.split("[")[1].rstrip("]")
    ax.set_title(f"largest {largest:.2f} {unit}", loc="right", pad=2, fontsize=8)
    ax.set_ylabel(label)
    return ax


def plot_velocity_error(log: pd.DataFrame, ax: Axes) -> Axes:
    """Driven minus desired velocity [m/s] over the distance [km], on the bands of `BANDS`."""
    for low, high, color, name in BANDS:
        inside = (log["vx"] > low) & (log["vx"] <= high)
        ax.fill_between(
            log["distance"] / 1000, 0, 1, where=inside, transform=ax.get_xaxis_transform(),
            color=color, linewidth=0, label=name, zorder=0.5,
        )  # fmt: skip
    plot_error(log, log["vx"] - log["v_des"], "velocity\nerror [m/s]", ax)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 0.97), ncols=2, borderpad=0.1)
    return ax


def plot_pedals(log: pd.DataFrame, ax: Axes) -> Axes:
    """Commanded throttle [%] and brake pressure [bar] over the distance [km]."""
    at = log["distance"] / 1000
    ax.plot(at, 100 * log["u_throttle"], color=GREEN, linewidth=0.9, label="throttle [%]")
    ax.plot(at, log["u_brake"] / 1e5, color=RED, linewidth=1.2, label="brake [bar]")
    ax.set(ylabel="throttle [%],\nbrake [bar]", ylim=(0, 105))
    legend_above(ax)
    return ax


def _red(ax: Axes, at: pd.Series[float], values: pd.Series[float], where: pd.Series[bool]) -> None:
    """Draw a part of a curve in red."""
    if where.any():
        ax.plot(at, values.where(where), color=ALARM, linewidth=2.2, label="beyond the plan")


def _mark_departure(figure: Figure, at: float) -> None:
    """Draw a red line in all panels."""
    for ax in figure.axes:
        ax.axvline(at, color=ALARM, linewidth=1.4)


def _alarm(figure: Figure, lines: list[str]) -> None:
    """Write red lines of text above the panels."""
    if lines:
        figure.suptitle("\n".join(lines), color=ALARM, fontsize=9, x=0.01, ha="left")


def in_kmh(ax: Axes) -> None:
    """Add an axis in km/h at the right of a panel in m/s."""
    right = ax.secondary_yaxis(
        "right", functions=(lambda v: np.multiply(v, KMH), lambda v: np.divide(v, KMH))
    )
    right.set_ylabel("[km/h]")


MEASURES = {
    "lap_time": ("lap time [s]", 1.0, 2),
    "e_y": ("largest offset |e_y| [m]", 1.0, 3),
    "e_psi": ("largest heading error |e_ψ| [deg]", 180 / math.pi, 2),
    "speed_error": ("speed error, RMS [m/s]", 1.0, 3),
    "part_throttle": ("speed error, 40-95 % throttle [m/s]", 1.0, 3),
    "margin": ("margin to the friction limit [%]", 100.0, 1),
}
"""For each column, its label, its factor from SI, and its number of decimals."""


def lap_table(laps: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Means over seeds with 95 % bootstrap intervals, a row per variant.

    `laps` has a row per variant and seed: variant, seed, and the columns of `MEASURES` in SI units,
    with lap_time NaN if the car did not finish. The result has the columns variant, seeds,
    finished, and for each measure, in its shown unit, the mean, `_low` and `_high`; unfinished laps
    only count in `seeds`.
    """
    rows = []
    for variant, group in laps.groupby("variant", observed=True, sort=False):
        finished = group[group["lap_time"].notna()]
        row: dict[str, object] = {"variant": variant, "seeds": len(group)}
        row["finished"] = len(finished)
        for column, (_, factor, _) in MEASURES.items():
            values = factor * finished[column].to_numpy(dtype=float)
            if values.size:
                mean = mean_error(values, rng)
                ends = mean.estimate, mean.low, mean.high
            else:
                ends = math.nan, math.nan, math.nan
            row |= dict(zip((column, f"{column}_low", f"{column}_high"), ends, strict=True))
        rows.append(row)
    return pd.DataFrame(rows)


def lap_text(table: pd.DataFrame) -> str:
    """The table as text: mean and interval, "-" if no lap was finished."""
    columns = pd.DataFrame({"knows": table["variant"].astype(str)})
    columns["finished"] = [f"{row.finished} of {row.seeds}" for row in table.itertuples()]
    for column, (name, _, digits) in MEASURES.items():
        columns[name] = [
            "-" if math.isnan(mean) else f"{mean:.{digits}f} ({low:.{digits}f}, {high:.{digits}f})"
            for mean, low, high in zip(
                table[column], table[f"{column}_low"], table[f"{column}_high"], strict=True
            )
        ]
    return columns.to_string(index=False)


def lap_figure(laps: pd.DataFrame, table: pd.DataFrame, *, note: str = "") -> Figure:
    """A panel per measure: seeds as light points, means with intervals, a line per variant."""
    with new_figure(1.2 + 0.36 * len(table)) as figure:
        panels = figure.subplots(1, len(MEASURES), sharey=True)
        for ax, column in zip(panels, MEASURES, strict=True):
            plot_measure(laps, table, column, ax)
        panels[0].set_yticks(range(len(table)), table["variant"].astype(str))
        panels[0].invert_yaxis()
        explanation = "points: seeds; bars: mean and 95 % bootstrap interval"
        unfinished = table[table["finished"] < table["seeds"]]
        fates = ", ".join(
            f"{row.variant}: {row.finished} of {row.seeds} laps finished"
            for row in unfinished.itertuples()
        )
        caption(figure, explanation, fates, note)
    return figure


def plot_measure(laps: pd.DataFrame, table: pd.DataFrame, column: str, ax: Axes) -> Axes:
    """One measure of finished laps over the variants, which are lines 0, 1, ... of the table."""
    name, factor, _ = MEASURES[column]
    for line, row in enumerate(table.to_dict("records")):
        seeds = laps[(laps["variant"] == row["variant"]) & laps["lap_time"].notna()]
        if seeds.empty:
            ax.text(0.5, line, "-", transform=ax.get_yaxis_transform(), ha="center", va="center")
            continue
        below = np.full(len(seeds), line + 0.22)
        ax.scatter(factor * seeds[column], below, s=6, color=BLUE, alpha=0.25)
        ends = row[f"{column}_low"], row[f"{column}_high"]
        ax.plot(ends, (line, line), color="black", linewidth=2.0, solid_capstyle="butt")
        ax.plot(row[column], line, "o", color="black", markersize=4)
    words, unit = name.split(" [")
    ax.set_xlabel(f"{textwrap.fill(words, 14)}\n[{unit}", fontsize=8)
    ax.xaxis.set_major_locator(MaxNLocator(2))
    ax.grid(axis="y", visible=False)
    return ax
