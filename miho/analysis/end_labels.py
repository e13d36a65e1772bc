"""Labels at the right end of a panel, one per curve, spread so that none covers another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from miho.analysis.styles import MethodStyle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EndLabel:
    """`value` is where the curve ends, in data units; NaN labels a curve that has no end value."""

    value: float
    text: str
    style: MethodStyle


def draw_end_labels(ax: Axes, labels: Sequence[EndLabel], size: float = 8.0) -> None:
    """Write the labels beside the right edge, each joined to its curve by a line in its style.

    Call it last: limits and scale of the axis must be final. `size` is the font size in points.
    """
    figure = ax.get_figure(root=True)
    if figure is None or not labels:
        return
    figure.draw_without_rendering()
    height = ax.get_window_extent().height / figure.dpi * 72
    ends = np.array([1.0 if np.isnan(one.value) else _fraction(ax, one.value) for one in labels])
    spots = spread(ends, 1.45 * size / height)
    for label, end, spot in zip(labels, ends, spots, strict=True):
        if not np.isnan(label.value):
            xs, ys = [1.0, 1.04, 1.11], [end, spot, spot]
            line = Line2D(xs, ys, transform=ax.transAxes, clip_on=False)
            line.set(color=label.style.color, linestyle=label.style.dashes)
            line.set_linewidth(label.style.width)
            ax.add_artist(line)
        ax.text(
            1.13,
            spot,
            label.text,
            transform=ax.transAxes,
            color=label.style.color,
            fontsize=size,
            verticalalignment="center_baseline",
        )


def spread(wanted: Array, gap: float, low: float = 0.0, high: float = 1.0) -> Array:
    """Positions (n,) at least `gap` apart in the order of `wanted`, as near to it as possible.

    Least squares under the constraint, which is an isotonic regression of wanted_i - i gap. If
    they cannot fit between `low` and `high`, the gap shrinks until they do.
    """
    count = len(wanted)
    if count > 1:
        gap = min(gap, (high - low) / (count - 1))
    order = np.argsort(wanted, kind="stable")
    shifts = gap * np.arange(count)
    fitted = isotonic_regression(wanted[order] - shifts).x
    placed = np.empty(count)
    placed[order] = np.clip(fitted, low, max(low, high - shifts[-1])) + shifts
    return placed


def _fraction(ax: Axes, value: float) -> float:
    """Height of a data value in the panel, 0 at the bottom to 1 at the top."""
    pixel = ax.transData.transform((ax.get_xlim()[0], value))
    return float(np.clip(ax.transAxes.inverted().transform(pixel)[1], 0, 1))
