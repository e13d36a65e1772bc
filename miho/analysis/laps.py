"""Laps on different knowledge of the car: a table with intervals over seeds, and its figure."""

from __future__ import annotations

import math
import textwrap

import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from miho.analysis.figures import WIDTH, caption, house_style
from miho.analysis.statistics import mean_error

MEASURES = {
    "lap_time": ("lap time [s]", 1.0, 2),
    "e_y": ("largest offset |e_y| [m]", 1.0, 3),
    "e_psi": ("largest heading error |e_ψ| [deg]", 180 / math.pi, 2),
    "speed_error": ("speed error, RMS [m/s]", 1.0, 3),
    "part_throttle": ("speed error, 40-95 % throttle [m/s]", 1.0, 3),
    "margin": ("margin to the friction limit [%]", 100.0, 1),
}
"""By column: what it is called, its factor from SI, and how many decimals tell enough."""


def lap_table(laps: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Means over seeds with 95 % bootstrap intervals, a row per variant.

    `laps` has a row per variant and seed: variant, seed, and the columns of `MEASURES` in SI units,
    lap_time NaN where the car did not finish. Columns of the table: variant, seeds, finished, and
    of each measure, in the unit that it is shown in, its mean, `_low` and `_high`; laps that were
    not finished count in `finished` alone.
    """
    rows = []
    for variant, group in laps.groupby("variant", observed=True, sort=False):
        done = group[group["lap_time"].notna()]
        row: dict[str, object] = {"variant": variant, "seeds": len(group), "finished": len(done)}
        for column, (_, factor, _) in MEASURES.items():
            values = factor * done[column].to_numpy(dtype=float)
            if values.size:
                found = mean_error(values, rng)
                ends = found.estimate, found.low, found.high
            else:
                ends = math.nan, math.nan, math.nan
            row |= dict(zip((column, f"{column}_low", f"{column}_high"), ends, strict=True))
        rows.append(row)
    return pd.DataFrame(rows)


def lap_text(table: pd.DataFrame) -> str:
    """The table as text: mean and interval, "-" where no lap was finished."""
    shown = pd.DataFrame({"knows": table["variant"].astype(str)})
    shown["finished"] = [f"{row.finished} of {row.seeds}" for row in table.itertuples()]
    for column, (name, _, digits) in MEASURES.items():
        shown[name] = [
            "-" if math.isnan(mean) else f"{mean:.{digits}f} ({low:.{digits}f}, {high:.{digits}f})"
            for mean, low, high in zip(
                table[column], table[f"{column}_low"], table[f"{column}_high"], strict=True
            )
        ]
    return shown.to_string(index=False)


def lap_figure(laps: pd.DataFrame, table: pd.DataFrame, *, note: str = "") -> Figure:
    """A panel per measure: seeds as light points, means with intervals, a line per variant."""
    with house_style():
        figure = Figure(figsize=(WIDTH, 1.2 + 0.36 * len(table)), layout="constrained")
        panels = figure.subplots(1, len(MEASURES), sharey=True)
        for ax, column in zip(panels, MEASURES, strict=True):
            plot_measure(laps, table, column, ax)
        panels[0].set_yticks(range(len(table)), table["variant"].astype(str))
        panels[0].invert_yaxis()
        told = "points: seeds; bars: mean and 95 % bootstrap interval"
        lost = table[table["finished"] < table["seeds"]]
        fates = ", ".join(
            f"{row.variant}: {row.finished} of {row.seeds} laps finished"
            for row in lost.itertuples()
        )
        caption(figure, told, fates, note)
        figure.draw_without_rendering()
    return figure


def plot_measure(laps: pd.DataFrame, table: pd.DataFrame, column: str, ax: Axes) -> Axes:
    """One measure of finished laps over the variants, which are lines 0, 1, ... of the table."""
    name, factor, _ = MEASURES[column]
    color = sns.color_palette("colorblind")[0]
    for line, row in enumerate(table.to_dict("records")):
        seeds = laps[(laps["variant"] == row["variant"]) & laps["lap_time"].notna()]
        if seeds.empty:
            ax.text(0.5, line, "-", transform=ax.get_yaxis_transform(), ha="center", va="center")
            continue
        below = np.full(len(seeds), line + 0.22)
        ax.scatter(factor * seeds[column], below, s=6, color=color, alpha=0.25)
        ends = row[f"{column}_low"], row[f"{column}_high"]
        ax.plot(ends, (line, line), color="black", linewidth=2.0, solid_capstyle="butt")
        ax.plot(row[column], line, "o", color="black", markersize=4)
    words, unit = name.split(" [")
    ax.set_xlabel(f"{textwrap.fill(words, 14)}\n[{unit}", fontsize=8)
    ax.xaxis.set_major_locator(MaxNLocator(2))
    ax.grid(axis="y", visible=False)
    return ax
