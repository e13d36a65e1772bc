"""Common parts of figures of results: sizes, captions, files, and labels at the ends of curves."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.optimize import isotonic_regression

from miho.analysis.styles import MethodStyle
from miho.analysis.timing import Clock
from miho.figures.style import WIDTH, house_style
from miho.quantities import Array
from miho.study import write_bytes

NARROW = 140 / 25.4
"""Width [inches] of a figure that is readable on a phone."""
TIME_LABEL_WIDTH = 44  # characters of 9 pt text below a panel of half WIDTH
LONGEST = 34
"""Longest line of a label [characters]."""
AXIS_LABELS = {
    "seconds": "time [s]",
    "cpu_seconds": "CPU seconds",
    "evaluations": "evaluations of the full loss",
}


@contextmanager
def new_figure(height: float, width: float = WIDTH) -> Iterator[Figure]:
    """A figure of this size [inches] in the house style; its layout is final after the context."""
    with house_style():
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        figure.draw_without_rendering()


def save(figure: Figure, path_without_suffix: str | Path) -> list[Path]:
    """Write a figure as PNG (200 dpi) and PDF, creating the folder.

    Parameters
    ----------
    figure : Figure
        The figure.
    path_without_suffix : path
        Path of the files without suffix.

    Returns
    -------
    list of Path
        Both files.
    """
    stem = Path(path_without_suffix)
    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = [stem.with_name(f"{stem.name}.{suffix}") for suffix in ("png", "pdf")]
    with house_style():
        for path in paths:
            metadata = {"CreationDate": None} if path.suffix == ".pdf" else None
            buffer = io.BytesIO()
            figure.savefig(buffer, format=path.suffix[1:], dpi=200, metadata=metadata)
            write_bytes(path, buffer.getvalue())
    return paths


def time_label(clock: Clock) -> str:
    """The label of an axis over time; a clock other than wall time includes the reason."""
    if clock.axis == "seconds":
        return AXIS_LABELS["seconds"]
    reason = textwrap.fill(f"({clock.disturbed})", TIME_LABEL_WIDTH)
    return f"{AXIS_LABELS[clock.axis]}\n{reason}"


def caption(figure: Figure, *parts: str) -> None:
    """Small print below the panels: the nonempty parts, in as many lines as needed."""
    text = "; ".join(part for part in parts if part).replace(" = ", "\u00a0=\u00a0")
    if text:
        figure.supxlabel(text, fontsize=8, color="#444444", x=0.01, ha="left", wrap=True)


def legend_above(ax: Axes) -> None:
    """Place the legend in a row above the panel, so that it covers no curve."""
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=4, borderpad=0.1)


def legend_below(ax: Axes, handles: Sequence[Artist] | None = None, columns: int = 1) -> None:
    """Place the legend below the label of the horizontal axis."""
    ax.legend(
        handles=handles or ax.get_legend_handles_labels()[0], ncols=columns, loc="upper left",
        bbox_to_anchor=(-0.05, -0.2), borderaxespad=0, borderpad=0, handlelength=1.4,
    )  # fmt: skip


def png(figure: Figure) -> bytes:
    """The figure as a picture for a page."""
    buffer = io.BytesIO()
    with house_style():
        figure.savefig(buffer, format="png", dpi=120)
    return buffer.getvalue()


@dataclass(frozen=True)
class EndLabel:
    """A label of a curve; `value` is its end in data units, or NaN."""

    value: float
    text: str
    style: MethodStyle


def draw_end_labels(ax: Axes, labels: Sequence[EndLabel], size: float = 8.0) -> None:
    """Write the labels at the right edge, each joined to its curve by a line in its style.

    Call it last: limits and scale of the axis must be final. `size` is the font size in points.
    Long labels are wrapped if there is room, so that the panel stays wide.
    """
    figure = ax.get_figure(root=True)
    if figure is None or not labels:
        return
    figure.draw_without_rendering()
    height = ax.get_window_extent().height / figure.dpi * 72
    values = [label.value for label in labels]
    ends = np.array([1.0 if np.isnan(value) else _fraction(ax, value) for value in values])
    texts = [textwrap.fill(label.text, LONGEST) for label in labels]
    gap = 1.45 * size / height * (1 + max(text.count("\n") for text in texts))
    if gap * (len(labels) - 1) > 1:
        texts, gap = [label.text for label in labels], 1.45 * size / height
    spots = spread_apart(ends, gap)
    for label, text, end, spot in zip(labels, texts, ends, spots, strict=True):
        if not np.isnan(label.value):
            xs, ys = [1.0, 1.04, 1.11], [end, spot, spot]
            line = Line2D(xs, ys, transform=ax.transAxes, clip_on=False)
            line.set(color=label.style.color, linestyle=label.style.dashes)
            line.set_linewidth(label.style.width)
            ax.add_artist(line)
        ax.text(
            1.13,
            spot,
            text,
            transform=ax.transAxes,
            color=label.style.color,
            fontsize=size,
            verticalalignment="center" if "\n" in text else "center_baseline",
            parse_math=False,  # a setting may look like a formula
        )


def spread_apart(targets: Array, gap: float) -> Array:
    """Positions (n,) at least `gap` apart in the order of `targets`, as near to them as possible.

    This is least squares under the constraint, an isotonic regression of target_i - i gap. If the
    positions cannot fit between 0 and 1, the gap shrinks until they do.
    """
    count = len(targets)
    if count > 1:
        gap = min(gap, 1 / (count - 1))
    order = np.argsort(targets, kind="stable")
    shifts = gap * np.arange(count)
    fitted = isotonic_regression(targets[order] - shifts).x
    placed = np.empty(count)
    placed[order] = np.clip(fitted, 0.0, max(0.0, 1.0 - shifts[-1])) + shifts
    return placed


def _fraction(ax: Axes, value: float) -> float:
    """Height of a data value in the panel, 0 at the bottom to 1 at the top."""
    pixel = ax.transData.transform((ax.get_xlim()[0], value))
    return float(np.clip(ax.transAxes.inverted().transform(pixel)[1], 0, 1))
