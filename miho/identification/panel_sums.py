"""Sums of squares over panels, as accurate as is asked of them.

A function that is analytic with |f| <= M in the ellipse with its foci at the ends of a panel, whose
half axes are together rho times half the panel, is within E = 2 M rho^(1-p) / (rho - 1) of a
polynomial of degree p - 1 (Trefethen, Approximation Theory and Approximation Practice, Theorem
8.2). A panel of `Panels` gives the sum of squares of that polynomial exactly, so by the triangle
inequality the root of the mean square over panels that keep to E is within 2 E of that over all
points. A candidate goes down the tree of panels until its model keeps to E there, with as few nodes
as do; a leaf where it does not is summed point by point.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from miho.identification.panels import ORDERS, SIDE_BY_SIDE, STARTS, Panels
from miho.models.expression import Formula

Array = NDArray[np.float64]
Sign = Callable[[Callable[..., Any]], Callable[..., Any]]

RHOS = np.array([2.8, 4.5])
WIDTHS, HEIGHTS = (RHOS + 1 / RHOS) / 2, (RHOS - 1 / RHOS) / 2
DEGREES = np.array(ORDERS) - 1.0
SIZES, PLACES = np.array(ORDERS), np.array(STARTS)

ROUNDING = 16 * np.finfo(float).eps
"""Relative error of weights and values, and of the nodes to the largest input of a panel."""
LOOKS = (0.02, 0.001)
"""Looks at a candidate: E is this part of the root of the loss it has to beat."""
SCRATCH = 64


def panel_data(found: Panels, N: int, size: float) -> tuple[Any, ...]:
    """What the compiled sums read, for N points of the root mean square `size`.

    `ellipses` (groups, 4, rhos x 4) holds, for each rho and panel, the centre and both half axes of
    the ellipse and the largest exponent with which rounding of the nodes is below E: a derivative
    of f on the panel is at most M over the width of the ellipse beyond the panel. `terms` (3, ...)
    are the points, then each panel's nodes.
    """
    tiny = np.finfo(float).tiny
    half = np.maximum(found.half, tiny)
    rounded = np.log(3 * ROUNDING * np.maximum(np.abs(found.centre) + found.half, tiny) / half)
    each = (
        np.broadcast_to(found.centre, (RHOS.size, found.half.size)),
        WIDTHS[:, None] * found.half,
        HEIGHTS[:, None] * found.half,
        np.log(WIDTHS - 1)[:, None] - rounded,
    )
    grouped = np.stack(each).reshape(len(each), RHOS.size, -1, SIDE_BY_SIDE)
    ellipses = grouped.transpose(2, 0, 1, 3).reshape(-1, len(each), RHOS.size * SIDE_BY_SIDE)
    degrees = np.stack([np.log(2 / (RHOS - 1)), 1 / np.log(RHOS)])
    places = np.stack([found.first, found.last, found.below, found.orders], axis=1)
    terms = np.hstack([found.points, *found.nodes])
    numbers = np.array([N, found.rest, size])
    return (
        np.ascontiguousarray(ellipses), degrees, places, terms, found.points.shape[1],
        found.rests, numbers,
    )  # fmt: skip


@register_jitable
def scratch_for(data: Any) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Arrays to work in: exponents, degrees, residuals and the groups still to be seen."""
    ellipses = data[0]
    n = ellipses.shape[2]
    room = np.empty(n + SIDE_BY_SIDE + SCRATCH)
    groups = np.empty(ellipses.shape[0] + 1, np.int64)
    return room[:n], room[n : n + SIDE_BY_SIDE], room[n + SIDE_BY_SIDE :], groups


def panel_sums(value: Formula, bound: Formula, named: Sign) -> tuple[Any, Any]:
    """Compiled functions of a model: its mean square over panels, and whether it is beaten."""
    needed, some = _needed(bound, named), _some(value, named)

    @register_jitable(error_model="numpy")
    @named
    def over_panels(
        parameters: Any, goal: float, enough: float, scratch: Any, data: Any
    ) -> tuple[float, int]:
        """The mean square, or a part of it that is `enough`, and the model values it took.

        Its root is within 2 exp(goal) of that over all points, rounding apart.
        """
        ellipses, degrees, places, terms, points, rests, numbers = data
        exponents, least, residuals, groups = scratch
        N, total = numbers[0], numbers[1]
        excess = math.log(bound((0.0, 0.0, 0.0), parameters)[0]) - goal
        count = group = 0
        last, groups[0] = 1, 0
        while group < last and total < enough * N:
            g = groups[group]
            group += 1
            needed(parameters, excess, ellipses[g], degrees, exponents, least)
            for i in range(SIDE_BY_SIDE):
                k = SIDE_BY_SIDE * g + i
                orders, chosen = places[k, 3], 0
                while chosen < orders and not least[i] <= DEGREES[chosen]:
                    chosen += 1
                if chosen < orders:
                    start = points + k * PLACES[-1] + PLACES[chosen]
                    total += rests[k, chosen]
                    total += some(parameters, terms, start, SIZES[chosen], residuals)
                    count += SIZES[chosen]
                elif places[k, 2] >= 0:
                    groups[last] = places[k, 2]
                    last += 1
                else:
                    for start in range(places[k, 0], places[k, 1], SCRATCH):
                        size = min(SCRATCH, places[k, 1] - start)
                        total += some(parameters, terms, start, size, residuals)
                        count += size
        return total / N, count

    @register_jitable(error_model="numpy")
    @named
    def beaten(parameters: Any, limit: float, scratch: Any, data: Any) -> tuple[bool, int]:
        """Whether the loss is known not to be below `limit`, and model values.

        The margin is far above what rounding does to the loss over panels or over points.
        """
        root, size, count = math.sqrt(limit), data[-1][2], 0
        if not 0 < limit < np.inf:
            return False, count
        for look in LOOKS:
            enough = (root * (1 + 1e-8 + 2.1 * look) + 4 * ROUNDING * size) ** 2
            found, more = over_panels(parameters, math.log(look * root), enough, scratch, data)
            count += more
            if found >= enough:
                return True, count
            if found < (root * (1 - 2.1 * look)) ** 2:
                break
        return False, count

    return over_panels, beaten


def _needed(bound: Formula, named: Sign) -> Any:
    """What degree keeps to E on the panels of a group."""

    @register_jitable(error_model="numpy")
    @named
    def needed(
        parameters: Any, excess: float, ellipses: Array, degrees: Array, exponents: Array,
        least: Array,
    ) -> None:  # fmt: skip
        centres, widths, heights, most = ellipses[0], ellipses[1], ellipses[2], ellipses[3]
        for i in range(centres.size):
            v = bound((centres[i], widths[i], heights[i]), parameters)[1] + excess
            exponents[i] = v if v <= most[i] else np.inf
        least[:] = np.inf
        for r in range(degrees.shape[1]):
            for i in range(SIDE_BY_SIDE):
                degree = (exponents[SIDE_BY_SIDE * r + i] + degrees[0, r]) * degrees[1, r]
                least[i] = min(least[i], degree)

    return needed


def _some(value: Formula, named: Sign) -> Any:
    """The sum of squares of some neighbouring terms."""

    @register_jitable(error_model="numpy")
    @named
    def some(parameters: Any, terms: Array, start: int, size: int, residuals: Array) -> float:
        for i in range(size):
            f = value((terms[0, start + i],), parameters)
            r = terms[1, start + i] * f - terms[2, start + i]
            residuals[i] = r * r
        lanes = size // 4 * 4
        for i in range(4, lanes, 4):
            for j in range(4):
                residuals[j] += residuals[i + j]
        total = 0.0
        for i in range(min(4, lanes)):
            total += residuals[i]
        for i in range(lanes, size):
            total += residuals[i]
        return total

    return some
