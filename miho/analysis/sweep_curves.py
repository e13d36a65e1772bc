"""Error curves of a sweep made light: step functions on a common grid, kept where they change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from miho.analysis.curves import Axis, positions, step
from miho.analysis.tidy import shown_unit
from miho.analysis.timing import Clock

Array = NDArray[np.float64]

QUANTILES = (0.1, 0.5, 0.9)
DIGITS = 5
"""Significant digits of what is kept."""


@dataclass(frozen=True)
class Detail:
    """How much is kept: grid positions of an axis, and single runs of a method on a problem."""

    positions: int
    seeds: int

    @classmethod
    def fitting(cls, pairs: int) -> Detail:
        """What keeps a page of so many pairs of problem and method at 3 MB or less."""
        return cls(
            positions=int(np.clip(45_000 // max(pairs, 1), 40, 180)),
            seeds=int(np.clip(1500 // max(pairs, 1), 2, 30)),
        )


def problem_curves(
    runs: pd.DataFrame, clock: Clock, curves: pd.DataFrame, best: float, detail: Detail
) -> dict[str, Any]:
    """What is drawn of one problem, ready for JSON; errors in the unit of `shown_unit`.

    The axis "seconds" is that of the clock, and of those of `runs` that may be compared on it.
    `curves` hold finite errors only. `best` is the best known error in the unit of `runs`, NaN if
    there is none.

    For each axis the grid and the curves, methods in order of their final median error: "method",
    "runs", "median", "low" and "high" (quantiles 0.1 and 0.9), "end" (median of what its runs
    spent) and "seeds", single runs evenly over their final errors. A curve is a text as of
    `steps`; a run without a value counts as infinitely bad, and a quantile is told once it is
    finite.
    """
    unit, factor = shown_unit(str(runs["unit"].iloc[0]))
    timed = runs[runs["id"].isin(clock.runs["id"])]
    axes = {
        "evaluations": _axis(runs, curves, "evaluations", factor, detail),
        "seconds": _axis(timed, curves, clock.axis, factor, detail),
    }
    known = float(_text(best * factor)) if math.isfinite(best) else None
    return {"unit": unit, "best": known, "axes": axes}


def _axis(
    runs: pd.DataFrame, curves: pd.DataFrame, axis: Axis, factor: float, detail: Detail
) -> dict[str, Any]:
    at = positions(curves, axis)
    errors = curves["error"].to_numpy(dtype=float) * factor
    grid = _grid(at, detail.positions)
    rows = curves.groupby("id", sort=False).indices
    ids, spent = runs["id"].to_numpy(), runs[axis].to_numpy(dtype=float)
    mine = runs.groupby("optimizer", sort=False).indices
    drawn = []
    for method in final_order(runs):
        table = np.full((len(mine[method]), len(grid)), np.inf)
        for row, run in zip(table, ids[mine[method]], strict=True):
            if run in rows:
                found = step(at[rows[run]], errors[rows[run]], grid)
                row[:] = np.where(np.isnan(found), np.inf, found)
        low, median, high = quantiles(table, QUANTILES)
        several = {"low": steps(low), "high": steps(high)} if len(table) > 1 else {}
        drawn.append(
            {
                "method": method,
                "runs": len(table),
                "median": steps(median),
                **several,
                "end": float(_text(float(np.median(spent[mine[method]])))),
                "seeds": [steps(table[number]) for number in _spread(table[:, -1], detail.seeds)],
            }
        )
    return {"grid": grid.tolist(), "curves": drawn}


def final_order(runs: pd.DataFrame) -> list[str]:
    """The methods of one problem, the smallest median of final errors first.

    What differs in the tenth digit only is a tie, in the order of the names.
    """
    final = runs["error"].fillna(np.inf).groupby(runs["optimizer"]).median()
    final = final.sort_index().map(lambda error: float(f"{error:.9g}"))
    return [str(name) for name in final.sort_values(kind="stable").index]


def overall_order(runs: pd.DataFrame) -> list[str]:
    """The methods by the mean of their places over the problems they were run on."""
    places: dict[str, list[int]] = {}
    for _, mine in runs.groupby("problem", sort=False):
        for place, method in enumerate(final_order(mine)):
            places.setdefault(method, []).append(place)
    return sorted(places, key=lambda method: (sum(places[method]) / len(places[method]), method))


def quantiles(table: Array, levels: Sequence[float]) -> Array:
    """Quantiles (levels, g) over the rows of (n, g), linear between neighbours, which may be inf.

    `numpy.quantile` makes NaN of a neighbour at inf even where its weight is zero.
    """
    ordered = np.sort(table, axis=0)
    found = []
    for level in levels:
        place = level * (len(table) - 1)
        below, weight = math.floor(place), place - math.floor(place)
        value = ordered[below]
        if weight > 0:
            above = ordered[below + 1]
            rise = np.subtract(above, value, out=np.full_like(value, np.inf), where=above < np.inf)
            value = value + weight * rise
        found.append(value)
    return np.array(found)


def steps(values: Array) -> str:
    """A curve (g,) on the grid: a number per position, empty where it is as before.

    It begins at its first finite value; positions before that are empty as well.
    """
    told, last = [], ""
    for value in values:
        text = _text(value) if math.isfinite(value) else ""
        told.append(text if text != last else "")
        last = text
    return ",".join(told)


def _grid(at: Array, count: int) -> Array:
    """Positions for both scales: two thirds even in the logarithm, one third even."""
    at = at[at > 0]
    if not at.size:
        return np.array([1.0])
    first, last = float(at.min()), float(at.max())
    even = np.linspace(first, last, count // 3)
    grid = np.concatenate([np.geomspace(first, last, count - count // 3), even])
    grid = np.array([float(_text(value)) for value in grid])
    return np.unique(np.append(grid[(grid > first) & (grid < last)], [first, last]))


def _spread(final: Array, count: int) -> NDArray[np.intp]:
    """At most `count` rows, evenly over the order of their final errors."""
    order: NDArray[np.intp] = np.argsort(final, kind="stable")
    chosen = np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)
    return order.take(chosen)


def _text(value: float) -> str:
    return f"{value:.{DIGITS}g}"
