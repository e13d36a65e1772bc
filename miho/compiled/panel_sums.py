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
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from miho.compiled.kernel import Formula
from miho.compiled.panels import ORDERS, SIDE_BY_SIDE, STARTS, Panels
from miho.quantities import Array

Sign = Callable[[Callable[..., Any]], Callable[..., Any]]

RHOS = np.array([2.2, 4.0])
FLAT = 1.01
"""An ellipse this thin stands for the panel itself, where a bound may not be defined."""
DEGREES = np.array(ORDERS) - 1.0
SIZES, PLACES = np.array(ORDERS), np.array(STARTS)
LAST = DEGREES[-1]
CHOSEN = np.append(np.searchsorted(DEGREES, np.arange(LAST + 1)), len(ORDERS))
"""The least order for a degree up to LAST, and none beyond."""

ROUNDING = 16 * np.finfo(float).eps
"""Relative error of weights and values."""
NODE_ROUNDING = 8 * np.finfo(float).eps
"""Error of a node, to half the panel's width and to the node itself."""
TINY = np.finfo(float).tiny
WITHIN = 2.4
"""Roots of mean squares over panels and over points differ by less than so many E: two, and a third
of one for rounding of the nodes."""
LOOKS = (0.015, 0.0005)
"""Looks at a candidate: E is this part of the root of the loss it has to beat."""
QUAD = 4
"""Numbers that the processor works on side by side."""
ROOM = 512


class PanelTerms(NamedTuple):
    """What the compiled sums read.

    For each group of panels and each rho, the thin ellipse first, `ellipses` (groups, 3, rhos x 4)
    holds the centre and both half axes; a rho's degree for v is (v + degrees[0]) degrees[1]. x, w
    and u are the points, then each panel's nodes from `nodes` on. A panel's `places` are its first
    and last point and the group that divides it. `rounding` (panels, orders + 1) is the largest
    v on the panel with which rounding of an order's nodes is below E / 3, -inf without this order.
    """

    ellipses: Array
    degrees: Array
    places: NDArray[np.int64]
    x: Array
    w: Array
    u: Array
    nodes: int
    rests: Array
    rounding: Array
    N: float
    rest: float
    size: float


class Scratch(NamedTuple):
    """Arrays to work in."""

    exponents: Array
    least: Array
    x: Array
    w: Array
    u: Array
    squares: Array
    groups: NDArray[np.int64]


def panel_terms(tree: Panels, N: int, size: float) -> PanelTerms:
    """The terms of a tree over N points whose values have the root mean square `size`."""
    rhos = np.append(FLAT, RHOS)
    axes = (
        np.broadcast_to(tree.centre, (rhos.size, tree.half.size)),
        ((rhos + 1 / rhos) / 2)[:, None] * np.maximum(tree.half, TINY),
        ((rhos - 1 / rhos) / 2)[:, None] * np.maximum(tree.half, TINY),
    )
    grouped = np.stack(axes).reshape(len(axes), rhos.size, -1, SIDE_BY_SIDE)
    ellipses = grouped.transpose(2, 0, 1, 3).reshape(-1, len(axes), rhos.size * SIDE_BY_SIDE)
    padding = np.zeros((3, QUAD))  # for quads that begin at the last points
    return PanelTerms(
        ellipses=np.ascontiguousarray(ellipses),
        degrees=np.stack([np.log(2 / (RHOS - 1)), 1 / np.log(RHOS)]),
        places=np.stack([tree.first, tree.last, tree.below], axis=1),
        **dict(zip("xwu", np.hstack([tree.points, *tree.nodes, padding]), strict=True)),
        nodes=tree.points.shape[1],
        rests=tree.rests,
        rounding=_rounding(tree),
        N=float(N),
        rest=tree.rest,
        size=size,
    )


def _rounding(tree: Panels) -> Array:
    """`PanelTerms.rounding`: how far rounding of the nodes allows each order on each panel.

    A polynomial of degree n with values in [-1, 1] on [-1, 1] has a slope of at most n /
    sqrt(1 - t^2) and of at most n^2 (Bernstein, Markov). Rounding of the nodes changes the root of
    the mean square by at most the root mean square of that slope, with the rule's weights, times
    the error of a node.
    """
    half = np.maximum(tree.half, TINY)
    error = NODE_ROUNDING * (1 + np.abs(tree.centre) / half)
    largest = np.full((half.size, len(ORDERS) + 1), -np.inf)
    for o, degree in enumerate(DEGREES):
        has = tree.orders > o
        x, w, _ = tree.nodes[has, :, STARTS[o] : STARTS[o + 1]].transpose(1, 0, 2)
        t = np.clip((x - tree.centre[has, None]) / half[has, None], -1, 1)
        slopes = np.minimum(degree / np.sqrt(np.maximum(1 - t**2, TINY)), degree**2)
        slope = np.sqrt(((w * slopes) ** 2).sum(axis=1) / (w**2).sum(axis=1))
        largest[has, o] = -np.log(3 * (error[has] * slope + ROUNDING))
    return largest


def scratch_for(terms: PanelTerms) -> Scratch:
    """Arrays for these terms."""
    sizes = terms.ellipses.shape[2], SIDE_BY_SIDE, *[ROOM] * 4
    groups = np.empty(len(terms.ellipses) + 1, np.int64)
    exponents, least, x, w, u, squares = (np.zeros(size) for size in sizes)
    return Scratch(exponents, least, x, w, u, squares, groups)


def panel_sums(value: Formula, bound: Formula, sign: Sign) -> tuple[Any, Any]:
    """Two functions of a model, to be compiled: its mean square over panels, and `beaten`.

    `sign` puts the model's signature into their names.
    """
    needed, squared = _needed(bound, sign), _squared(value, sign)

    @register_jitable(error_model="numpy")
    @sign
    def over_panels(
        parameters: Any, goal: float, enough: float, scratch: Scratch, terms: PanelTerms
    ) -> tuple[float, int]:
        """The mean square, or a part of it that is `enough`, and the model values it took.

        Its root is within WITHIN exp(goal) of that over all points, rounding of values apart.
        """
        # Go down the tree, group by group: `last` groups are listed, the next is number `group`.
        excess = math.log(bound((0.0, 0.0, 0.0), parameters)[0]) - goal
        total, most = terms.rest, enough * terms.N
        count = filled = group = 0
        last, scratch.groups[0] = 1, 0
        while group < last and total < most:
            g = scratch.groups[group]
            group += 1
            needed(parameters, excess, terms.ellipses[g], terms.degrees, scratch)
            # For each panel of the group find the terms that stand for it: the nodes of the least
            # order that is accurate enough; else its quarters, in a group of their own; else, of a
            # leaf, all points.
            for i in range(SIDE_BY_SIDE):
                k = SIDE_BY_SIDE * g + i
                o = CHOSEN[int(scratch.least[i])]
                if scratch.exponents[i] <= terms.rounding[k, o]:
                    start = terms.nodes + k * PLACES[-1] + PLACES[o]
                    end = start + SIZES[o]
                    total += terms.rests[k, o]
                elif terms.places[k, 2] >= 0:
                    scratch.groups[last] = terms.places[k, 2]
                    last += 1
                    continue
                else:
                    start, end = terms.places[k, 0], terms.places[k, 1]
                # Collect the terms of several panels, so that the model is evaluated on many.
                while start < end:
                    size = min(end - start, ROOM - QUAD - filled)
                    _copy_terms(terms, start, size, scratch, filled)
                    start, filled, count = start + size, filled + size, count + size
                    if filled == ROOM - QUAD:
                        total += squared(parameters, scratch, filled)
                        filled = 0
            total += squared(parameters, scratch, filled)
            filled = 0
        return total / terms.N, count

    return over_panels, _beaten(over_panels, sign)


def _beaten(over_panels: Any, sign: Sign) -> Any:
    """The test whether a candidate is beaten, on the mean square over panels."""

    @register_jitable(error_model="numpy", forceinline=True)
    @sign
    def beaten(
        parameters: Any, limit: float, scratch: Scratch, terms: PanelTerms
    ) -> tuple[bool, int]:
        """Whether the loss is known not to be below `limit`, and the model values that it took.

        The margin is far above what rounding does to the loss over panels or over points.
        """
        # A coarse look is cheap and beats most candidates; a finer one follows where it is close.
        root, count = math.sqrt(limit), 0
        if not 0 < limit < np.inf:
            return False, count
        for look in LOOKS:
            enough = (root * (1 + 1e-8 + WITHIN * look) + 4 * ROUNDING * terms.size) ** 2
            square, more = over_panels(parameters, math.log(look * root), enough, scratch, terms)
            count += more
            if square >= enough:
                return True, count
            if square < limit:
                break
        return False, count

    return beaten


@register_jitable(forceinline=True)
def _copy_terms(terms: PanelTerms, start: int, size: int, scratch: Scratch, filled: int) -> None:
    """Copy `size` terms from `start` on to the scratch arrays from `filled` on, four at a time.

    Indices are unsigned: signed ones would be tested for being negative at each access.
    """
    i, k = np.uint64(start), np.uint64(filled)
    for j in range(np.uint64(0), np.uint64(size), np.uint64(QUAD)):
        _copy_quad(terms.x, i + j, scratch.x, k + j)
        _copy_quad(terms.w, i + j, scratch.w, k + j)
        _copy_quad(terms.u, i + j, scratch.u, k + j)


@register_jitable(forceinline=True)
def _copy_quad(source: Array, i: Any, target: Array, k: Any) -> None:
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    a, b, c, d = source[i], source[i + one], source[i + two], source[i + three]
    target[k], target[k + one], target[k + two], target[k + three] = a, b, c, d


def _needed(bound: Formula, sign: Sign) -> Any:
    """What degree keeps to E on the panels of a group, LAST + 1 for none, and log(bound / E), v."""

    @register_jitable(error_model="numpy", forceinline=True)
    @sign
    def needed(
        parameters: Any, excess: float, ellipses: Array, degrees: Array, scratch: Scratch
    ) -> None:
        centres, widths, heights = ellipses[0], ellipses[1], ellipses[2]
        exponents, least = scratch.exponents, scratch.least
        for i in range(centres.size):
            exponents[i] = bound((centres[i], widths[i], heights[i]), parameters)[1] + excess
        for i in range(SIDE_BY_SIDE):
            least[i] = LAST
        for r in range(degrees.shape[1]):
            for i in range(SIDE_BY_SIDE):
                degree = (exponents[SIDE_BY_SIDE * (r + 1) + i] + degrees[0, r]) * degrees[1, r]
                if degree < least[i]:  # and not if it is no number
                    least[i] = degree
        for i in range(SIDE_BY_SIDE):
            least[i] = max(least[i], -1.0) + 1  # the next whole number when it is cut

    return needed


def _squared(value: Formula, sign: Sign) -> Any:
    """The sum of squares of the terms in the scratch arrays."""

    @register_jitable(error_model="numpy", forceinline=True)
    @sign
    def squared(parameters: Any, scratch: Scratch, filled: int) -> float:
        x, w, u, squares = scratch.x, scratch.w, scratch.u, scratch.squares
        for i in range(filled, filled + QUAD):
            x[i], w[i], u[i] = x[0], 0.0, 0.0
        size = (filled + QUAD - 1) // QUAD * QUAD
        for i in range(size):
            f = value((x[i],), parameters)
            r = w[i] * f - u[i]
            squares[i] = r * r
        a = b = c = d = 0.0
        for i in range(0, size, QUAD):
            a += squares[i]
            b += squares[i + 1]
            c += squares[i + 2]
            d += squares[i + 3]
        return (a + b) + (c + d)

    return squared
