"""The loss of a model of one input from a few nodes instead of all points, to a stated accuracy.

A function that is analytic with |f| <= M in the ellipse with its foci at the ends of a panel, whose
half axes are together rho times half the panel, is within E = 2 M rho^(1-p) / (rho - 1) of a
polynomial of degree p - 1 (Trefethen, Approximation Theory and Approximation Practice, Theorem
8.2). A panel of `Panels` gives the sum of squares of that polynomial exactly, so by the triangle
inequality the root of the mean square over panels that keep to E is within 2 E of that over all
points. A candidate goes down the tree of panels until its model keeps to E there, with as few nodes
as do; a leaf where it does not is summed point by point.

E is a fixed small part of the scatter that no smooth curve explains. A loss below that scatter is
summed point by point, as are all losses of data without scatter: the accuracy holds in every case.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from miho.identification import fused, panels
from miho.identification.fused import as_tuple, sum_of_squares
from miho.models.expression import Expression, Formula
from miho.models.signature import Signed, signed, signed_formulas
from miho.optim import climb
from miho.optim.climb import Climb, climb_on, compiled_climb

Array = NDArray[np.float64]
Sign = Callable[[Callable[..., Any]], Callable[..., Any]]

RHOS = np.array([1.4, 2.2, 3.6, 7.0])
WIDTHS, HEIGHTS = (RHOS + 1 / RHOS) / 2, (RHOS - 1 / RHOS) / 2
ELLIPSES = np.stack(
    [WIDTHS, HEIGHTS, np.log(2 / (RHOS - 1)), 1 / np.log(RHOS), -np.log(WIDTHS - 1)]
)
"""Half axes by rho, what the degree needed follows from, and what bounds a derivative.

With f, a derivative on the panel is at most M over the width of the ellipse beyond the panel.
"""
DEGREES = np.array(panels.ORDERS) - 1.0
PLACES = np.array(panels.STARTS)

TRUNCATION = 0.15
"""Share of the tolerance that E is of the scatter: 0.6 of it, four times E over the root of L."""
ROUNDING = 16 * np.finfo(float).eps
"""Relative error of weights and values, and of the nodes to the largest input of a panel."""
SCATTER = 0.5
"""Part of the leaves' scatter that a loss is expected to have at least."""
LOOK = 0.02
"""First look at a candidate: E is this part of the root of the loss it has to beat."""
SCRATCH = 64
COMPILED_WITH = (climb.__file__, fused.__file__, panels.__file__, __file__)


@dataclass(frozen=True, eq=False)
class CompressedLoss:
    """Mean square of model minus data within the relative `tolerance` of that over all points.

    x (N,) is the only input of the model, which has a `bound`; y (N,) the output.
    """

    model: Expression
    x: Array
    y: Array
    tolerance: float = 1e-9

    @cached_property
    def _compiled(self) -> _Compiled:
        model = self.model
        if model.bound is None:
            raise ValueError(
                f"{type(model).__name__} has no bound; only a model that has one can be compressed"
            )
        d = len(model.parameters)
        return _compile(signed_formulas((model.value, model.bound), (1, d), *COMPILED_WITH), d)

    @cached_property
    def _data(self) -> tuple[Any, ...]:
        found = panels.panels(self.x, self.y)
        N = self.y.size
        size = math.sqrt(float(np.mean(self.y**2)))
        scatter = SCATTER * math.sqrt(found.unexplained / N)
        accurate = 2 * ROUNDING * (scatter + 2 * size) <= 0.2 * self.tolerance * scatter
        goal = TRUNCATION * self.tolerance * scatter if accurate else 0.0
        magnitude = np.abs(found.centre) + found.half
        tiny = np.finfo(float).tiny
        rounded = np.log(3 * ROUNDING * np.maximum(magnitude, tiny))
        return _data(found, rounded - np.log(np.maximum(found.half, tiny)), N, size, scatter, goal)

    @cached_property
    def climb(self) -> Climb:
        """Compiled mutation steps on this loss."""
        return climb_on(self._compiled.climb, self._data)

    def losses(self, thetas: Array) -> Array:
        """Losses (n,) of parameter rows (n, d)."""
        return self.counted(thetas, np.full(len(thetas), np.inf))[0]

    def counted(self, thetas: Array, limits: Array) -> tuple[Array, NDArray[np.int64]]:
        """Losses (n,) of rows (n, d), given up once known not to be below limits (n,).

        Besides, how often each evaluated the model (n,).
        """
        losses, counts = np.empty(len(thetas)), np.empty(len(thetas), np.int64)
        thetas = np.ascontiguousarray(thetas, dtype=float)
        self._compiled.losses(thetas, limits, self._data, losses, counts)
        return losses, counts


@dataclass(frozen=True)
class _Compiled:
    losses: Callable[[Array, Array, tuple[Any, ...], Array, NDArray[np.int64]], None]
    climb: Callable[..., tuple[int, int, int, int]]


def _data(
    found: panels.Panels, spread: Array, N: int, size: float, scatter: float, goal: float
) -> tuple[Any, ...]:
    """What the compiled loss reads; `terms` (3, ...) are the points, then each panel's nodes."""
    geometry = np.stack([found.centre, found.half, spread], axis=1)
    places = np.stack([found.first, found.last, found.after, found.orders], axis=1)
    terms = np.hstack([found.points, *found.nodes])
    log_goal = math.log(goal) if goal else -math.inf
    numbers = np.array([N, found.rest, size, log_goal, N * scatter**2])
    return geometry, places, terms, found.points.shape[1], found.rests, numbers, ELLIPSES


def _order(bound: Formula, named: Sign) -> Any:
    """Which rule keeps to E on a panel."""

    @register_jitable(error_model="numpy")
    @named
    def order(
        parameters: Any,
        amplitude: float,
        goal: float,
        panel: tuple[float, float, float],
        orders: int,
        ellipses: Array,
        degrees: Array,
    ) -> int:
        """The place of the lowest order that keeps to E on a panel, or `orders`."""
        centre, half, spread = panel
        for r in range(degrees.size):
            v = bound((centre, half * ellipses[0, r], half * ellipses[1, r]), parameters)[1]
            excess = amplitude + v - goal
            degree = (excess + ellipses[2, r]) * ellipses[3, r]
            degrees[r] = degree if excess + ellipses[4, r] + spread <= 0 else np.inf
        needed = np.inf
        for r in range(degrees.size):
            needed = degrees[r] if degrees[r] < needed else needed
        found = 0
        while found < orders and not needed <= DEGREES[found]:
            found += 1
        return found

    return order


def _walk(value: Formula, order: Callable[..., int], named: Sign) -> Any:
    """The sum over panels that keep to E, and over the points of leaves that do not."""

    @register_jitable(error_model="numpy")
    @named
    def walk(
        parameters: Any, amplitude: float, goal: float, enough: float, scratch: Any, data: Any
    ) -> tuple[float, int]:
        """The mean square, or a part of it that is `enough`, and the model values it took."""
        geometry, places, terms, points, rests, numbers, ellipses = data
        residuals, degrees = scratch
        N, total = numbers[0], numbers[1]
        count = pending = k = 0
        while k < places.shape[0]:
            panel, orders = (geometry[k, 0], geometry[k, 1], geometry[k, 2]), places[k, 3]
            chosen = order(parameters, amplitude, goal, panel, orders, ellipses, degrees)
            if chosen < orders:
                first = points + k * PLACES[-1]
                start, end = first + PLACES[chosen], first + PLACES[chosen + 1]
                total += rests[k, chosen]
                k = places[k, 2]
            elif places[k, 2] > k + 1:
                k += 1
                continue
            else:
                start, end = places[k, 0], places[k, 1]
                k += 1
            count += end - start
            while start < end:
                some = min(end - start, SCRATCH - pending)
                for i in range(some):
                    f = value((terms[0, start + i],), parameters)
                    residuals[pending + i] = terms[1, start + i] * f - terms[2, start + i]
                start += some
                pending += some
                if pending == SCRATCH:
                    total += sum_of_squares(residuals)
                    pending = 0
                    if total / N >= enough:
                        return total / N, count
        return (total + sum_of_squares(residuals[:pending])) / N, count

    return walk


@cache
def _compile(formulas: Signed, d: int) -> _Compiled:
    named = signed(formulas.signature)
    value, bound = map(register_jitable, formulas.copies())
    walk = _walk(value, _order(bound, named), named)

    @register_jitable(error_model="numpy")
    @named
    def counted(theta: Array, limit: float, data: Any) -> tuple[float, int]:
        """The loss, or a number not below `limit` once it is known not to be, and model values."""
        numbers, ellipses = data[5], data[6]
        size, goal, lowest = numbers[2], numbers[3], numbers[4] / numbers[0]
        parameters = as_tuple(theta, d)
        amplitude = math.log(bound((0.0, 0.0, 0.0), parameters)[0])
        scratch = np.empty(SCRATCH), np.empty(ellipses.shape[1])
        count = 0
        if 0 < limit < np.inf:
            root = math.sqrt(limit)
            beaten = (root * (1 + 1e-8 + 2.1 * LOOK) + 4 * ROUNDING * size) ** 2
            wanted = math.log(LOOK * root)
            found, count = walk(parameters, amplitude, wanted, beaten, scratch, data)
            if found >= beaten:
                return found, count
        if goal > -np.inf:
            found, more = walk(parameters, amplitude, goal, limit, scratch, data)
            count += more
            if found >= min(limit, lowest):
                return found, count
        found, more = walk(parameters, amplitude, -np.inf, limit, scratch, data)
        return found, count + more

    @register_jitable(error_model="numpy")
    @named
    def loss(theta: Array, limit: float, data: Any) -> float:
        found: float = counted(theta, limit, data)[0]
        return found

    @njit(cache=True, nogil=True, error_model="numpy")
    @named
    def losses(
        thetas: Array, limits: Array, data: Any, found: Array, counts: NDArray[np.int64]
    ) -> None:
        for i in range(len(thetas)):
            found[i], counts[i] = counted(thetas[i], limits[i], data)

    return _Compiled(losses, compiled_climb(loss, formulas.signature))
