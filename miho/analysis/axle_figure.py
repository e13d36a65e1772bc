"""Fig. 4, right: curves of an axle over driving data that they were not learned from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import seaborn as sns
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from miho.analysis.figures import Points, house_style

COLORS = sns.color_palette("colorblind")
MARGIN = 1.5
"""How far beyond the driving data curves are drawn, in their range of slip angles."""


@dataclass(frozen=True)
class AxleCurve:
    """A curve: slip angles [deg] and forces [kN], and its root mean square error [kN] on the data.

    seen: the slip angles [deg] between which it was learned; beyond them it is dashed.
    """

    points: Points
    error: float
    seen: tuple[float, float]


def fig4_right(data: Points, curves: Mapping[str, AxleCurve], *, note: str = "") -> Figure:
    """Fig. 4, right: driving data as light points, and curves by name.

    data: slip angles [deg] and lateral forces [kN] of the axle, both tires, (n,) each, which no
    curve was learned from.
    """
    with house_style():
        figure = Figure(figsize=(4.6, 3.6), layout="constrained")
        plot_axle(data, curves, figure.subplots())
        figure.supxlabel(note, fontsize=7, color="#444444", x=0.01, ha="left")
        figure.draw_without_rendering()
    return figure


def plot_axle(data: Points, curves: Mapping[str, AxleCurve], ax: Axes) -> Axes:
    """Driving data and curves of an axle, as in `fig4_right`."""
    alpha, force = data
    ax.scatter(alpha, force, s=3, color=COLORS[0], alpha=0.12, linewidths=0, rasterized=True)
    for (name, curve), color in zip(curves.items(), (COLORS[3], "black"), strict=False):
        at, known = curve.points
        inside = (at >= curve.seen[0]) & (at <= curve.seen[1])
        label = f"{name}, error {curve.error:.2f} kN"
        ax.plot(at, known, color=color, linewidth=0.9, linestyle=(0, (4, 2)))
        ax.plot(at[inside], known[inside], color=color, linewidth=1.8, label=label)
    reach = MARGIN * float(np.abs(alpha).max())
    most = 1.3 * float(np.abs(force).max())
    ax.set(xlim=(-reach, reach), ylim=(-most, most))
    ax.set(xlabel="slip angle [deg]", ylabel="lateral force, both tires [kN]")
    ax.legend(loc="upper right", handlelength=1.6)
    return ax
