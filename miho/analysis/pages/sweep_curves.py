"""Compact error curves of a sweep: step functions on a common grid, stored where they change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.analysis.curves import Axis, positions, step
from miho.analysis.text import rounded
from miho.analysis.tidy import shown_unit
from miho.analysis.timing import Clock
from miho.quantities import Array

QUANTILES = (0.1, 0.5, 0.9)
DIGITS = 5
"""Significant digits of stored values."""


@dataclass(frozen=True)
class Detail:
    """Level of detail: grid positions of an axis, and single runs per method and problem."""

    positions: int
    seeds: int

    @classmethod
    def fitting(cls, pairs: int) -> Detail:
        """The detail that keeps a page with so many pairs of problem and method at 3 MB or less."""
        return cls(
            positions=int(np.clip(45_000 // max(pairs, 1), 40, 180)),
            seeds=int(np.clip(1500 // max(pairs, 1), 2, 30)),
        )


def _layer(name: str, mark: dict[str, Any], **encoding: Any) -> dict[str, Any]:
    """A layer of the chart; it draws the data set of its name, which the page's script fills."""
    channels = {"color": _channel("color", "nominal")} | encoding
    return {"name": name, "data": {"name": name}, "mark": mark, "encoding": channels}


def _channel(field: str, kind: str) -> dict[str, Any]:
    """A field that a layer uses unscaled, for example a width in pixels."""
    return {"field": field, "type": kind, "scale": None, "legend": None}


_STEP = {"interpolate": "step-after", "clip": True}
_X = {"field": "x", "type": "quantitative"}
_Y = {"field": "y", "type": "quantitative"}
_GROUP = {"detail": [{"field": "method", "type": "nominal"}, {"field": "seed", "type": "nominal"}]}
_LABELS = {
    "gridColor": "#ececec", "domainColor": "#8c8c8c", "tickColor": "#8c8c8c",
    "labelColor": "#3d3d3d", "titleColor": "#3d3d3d", "labelFontSize": 13,
    "titleFontSize": 13, "titleFontWeight": "normal",
    "labelOverlap": True, "titlePadding": 10,
    "labelExpr": "abs(datum.value) >= 1e6 || (datum.value != 0 && abs(datum.value) < 1e-3) "
    "? format(datum.value, '.3~e') : format(datum.value, ',.3~r')",
}  # fmt: skip
CHART: dict[str, Any] = {
    "config": {
        "font": "system-ui, sans-serif", "view": {"stroke": None}, "axis": _LABELS,
        "background": None,
    },
    "autosize": {"type": "fit", "contains": "padding"},
    "encoding": {"x": _X, "y": _Y},
    "layer": [
        _layer("bands", {"type": "area", "opacity": 0.13, **_STEP}, **_GROUP,
               y={"field": "low", "type": "quantitative"}, y2={"field": "high"}),
        _layer("curves", {"type": "line", "strokeJoin": "round", **_STEP}, **_GROUP,
               strokeDash=_channel("dash", "nominal"),
               strokeWidth=_channel("width", "quantitative"),
               strokeOpacity=_channel("opacity", "quantitative")),
        _layer("ends", {"type": "point", "filled": True, "opacity": 1, "size": 32, "clip": True}),
        _layer("cross", {"type": "rule", "strokeDash": [3, 3]}, y=None),
        _layer("values", {"type": "point", "filled": True, "opacity": 1, "size": 55,
                          "stroke": "#fff", "strokeWidth": 1.5, "clip": True}),
    ],
}  # fmt: skip
"""The chart of a problem in Vega-Lite. The script of the page adds data, scales, titles, sizes."""


def problem_curves(
    runs: pd.DataFrame, clock: Clock, curves: pd.DataFrame, best: float, detail: Detail
) -> dict[str, Any]:
    """The curves of one problem, ready for JSON; errors in the unit of `shown_unit`.

    `curves` are of the runs with finite errors. `clock` is of the axis "seconds". `best` is the
    best known error in the unit of `runs`, NaN if there is none. For each axis the result has the
    grid and the curves, methods in order of their final median error: "method", "runs", "median",
    "low" and "high" (quantiles 0.1 and 0.9), "end" (median cost of its runs) and "seeds", single
    runs evenly over their final errors. A curve is a text as from `steps`. A run without a value
    counts as infinitely bad, so quantiles begin when they are finite.
    """
    unit, factor = shown_unit(str(runs["unit"].iloc[0]))
    timed = runs[runs["id"].isin(clock.runs["id"])]
    axes = {
        "evaluations": _axis(runs, curves, "evaluations", factor, detail),
        "seconds": _axis(timed, curves, clock.axis, factor, detail),
    }
    best_known = rounded(best * factor, DIGITS) if math.isfinite(best) else None
    return {"unit": unit, "best": best_known, "axes": axes}


def _axis(
    runs: pd.DataFrame, curves: pd.DataFrame, axis: Axis, factor: float, detail: Detail
) -> dict[str, Any]:
    at = positions(curves, axis)
    errors = curves["error"].to_numpy(dtype=float) * factor
    grid = _grid(at, detail.positions)
    rows = curves.groupby("id", sort=False).indices
    ids, spent = runs["id"].to_numpy(), runs[axis].to_numpy(dtype=float)
    rows_of = runs.groupby("optimizer", sort=False).indices
    entries = []
    for method in final_order(runs):
        table = np.full((len(rows_of[method]), len(grid)), np.inf)
        for row, run in zip(table, ids[rows_of[method]], strict=True):
            if run in rows:
                errors_of_run = step(at[rows[run]], errors[rows[run]], grid)
                row[:] = np.where(np.isnan(errors_of_run), np.inf, errors_of_run)
        low, median, high = quantiles(table, QUANTILES)
        several = {"low": steps(low), "high": steps(high)} if len(table) > 1 else {}
        entries.append(
            {
                "method": method,
                "runs": len(table),
                "median": steps(median),
                **several,
                "end": rounded(float(np.median(spent[rows_of[method]])), DIGITS),
                "seeds": [steps(table[number]) for number in _spread(table[:, -1], detail.seeds)],
            }
        )
    return {"grid": grid.tolist(), "curves": entries}


def final_order(runs: pd.DataFrame) -> list[str]:
    """The methods of one problem, the smallest median of final errors first.

    Differences in the tenth digit are ties, in the order of the names.
    """
    final = runs["error"].fillna(np.inf).groupby(runs["optimizer"]).median()
    final = final.sort_index().map(lambda error: rounded(error, 9))
    return [str(name) for name in final.sort_values(kind="stable").index]


def overall_order(runs: pd.DataFrame) -> list[str]:
    """The methods by the mean of their places over the problems on which they were run."""
    places: dict[str, list[int]] = {}
    for _, group in runs.groupby("problem", sort=False):
        for place, method in enumerate(final_order(group)):
            places.setdefault(method, []).append(place)
    return sorted(places, key=lambda method: (sum(places[method]) / len(places[method]), method))


def quantiles(table: Array, levels: Sequence[float]) -> Array:
    """Quantiles (levels, g) over the rows of (n, g), linear between neighbours, which may be inf.

    `numpy.quantile` returns NaN for a neighbour at inf even if its weight is zero.
    """
    ordered = np.sort(table, axis=0)
    curves = []
    for level in levels:
        place = level * (len(table) - 1)
        below, weight = math.floor(place), place - math.floor(place)
        value = ordered[below]
        if weight > 0:
            above = ordered[below + 1]
            rise = np.subtract(above, value, out=np.full_like(value, np.inf), where=above < np.inf)
            value = value + weight * rise
        curves.append(value)
    return np.array(curves)


def steps(values: Array) -> str:
    """A curve (g,) on the grid: a number per position, empty if it is unchanged.

    It begins at its first finite value; earlier positions are empty as well.
    """
    texts, last = [], ""
    for value in values:
        text = f"{value:.{DIGITS}g}" if math.isfinite(value) else ""
        texts.append(text if text != last else "")
        last = text
    return ",".join(texts)


def _grid(at: Array, count: int) -> Array:
    """Positions for both scales: two thirds even in the logarithm, one third even."""
    at = at[at > 0]
    if not at.size:
        return np.array([1.0])
    first, last = float(at.min()), float(at.max())
    even = np.linspace(first, last, count // 3)
    grid = np.concatenate([np.geomspace(first, last, count - count // 3), even])
    grid = np.array([rounded(value, DIGITS) for value in grid])
    return np.unique(np.append(grid[(grid > first) & (grid < last)], [first, last]))


def _spread(final: Array, count: int) -> NDArray[np.intp]:
    """At most `count` rows, evenly over the order of their final errors."""
    order: NDArray[np.intp] = np.argsort(final, kind="stable")
    places = np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)
    return order.take(places)
