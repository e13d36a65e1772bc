"""A sum of squares over many points of one input, as sums over a few points of each panel.

For every polynomial q of a degree below p, the points of a panel and the p nodes of a Gauss rule
for them (Golub and Welsch 1969, for a discrete measure) give the same sum of squares

    sum_i (q(x_i) - y_i)^2 = sum_k (w_k q(t_k) - u_k)^2 + rest,

because the values of orthonormal polynomials at the nodes, times w_k, are an orthogonal matrix: u
is y's projection on the polynomials and rest the squared length of what is left. No term is
negative, so nothing cancels. The polynomials come from the Lanczos process. Four neighbouring
panels become one by the same construction from their nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
from numba import njit
from scipy.linalg.lapack import dstev

from miho.quantities import Array, Integers

ORDERS = (4, 8, 12, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96)
"""Numbers of nodes a panel can be replaced by, all whole quads."""
STARTS = (0, *accumulate(ORDERS))
"""Where the nodes of each order start within a panel, and their end."""
SIDE_BY_SIDE = 4
"""Panels of a group: as many as the processor looks at in one go."""
LEAF = 64
"""A panel of more points is divided."""
HIGH, FEW = 32, 10_000
"""Orders above HIGH are for at most FEW points: they take long to compute."""
LEAVES = 1024
"""A leaf has at most one in so many of all points, or LEAF if that is more."""
SMALLEST = 1e-12
"""A vector this much shorter than its parts is rounding."""


@dataclass(frozen=True, eq=False)
class Panels:
    """A tree of panels in groups of four: a group divides a panel into quarters of its width.

    points (3, m) are the distinct inputs in ascending order, their weights w and their values u, as
    in the sum above; `rest` is what these leave out. Panel k = 4 g + i is number i of group g: it
    covers `centre[k]` +- `half[k]` and the points from `first[k]` to `last[k]`, maybe none, and
    group `below[k]` divides it, none if that is -1. It has `orders[k]` rules, and those of order o
    are in `nodes[k]` (3, ...) from STARTS[o], leaving out `rests[k, o]` of its points. Group 0
    divides all there is; a group comes before those that divide its panels.
    """

    points: Array
    rest: float
    centre: Array
    half: Array
    first: Integers
    last: Integers
    below: Integers
    orders: Integers
    nodes: Array
    rests: Array

    @property
    def unexplained(self) -> float:
        """The sum of squares that a polynomial of degree 7 on every leaf leaves."""
        leaves = (self.below < 0) & (self.orders > 1)
        return self.rest + float(self.rests[leaves, 1].sum())


def panels(x: Array, y: Array) -> Panels:
    """The panels of points x (N,) with values y (N,), divided until few points are left in each."""
    points, rest = _distinct(x, y)
    first, last, below = _divide(points[0], max(LEAF, points.shape[1] // LEAVES))
    count = first.size
    centre, half = np.zeros(count), np.zeros(count)
    orders = np.zeros(count, np.int64)
    nodes, rests = np.zeros((count, 3, STARTS[-1])), np.zeros((count, len(ORDERS)))
    highest = ORDERS[-1] if x.size <= FEW else HIGH
    exact: dict[int, tuple[Array, float]] = {}
    for k in reversed(np.flatnonzero(last > first).tolist()):
        low, high = points[0, first[k]], points[0, last[k] - 1]
        centre[k], half[k] = (low + high) / 2, (high - low) / 2
        if below[k] < 0:
            terms, omitted = points[:, first[k] : last[k]], 0.0
        else:
            quarters = SIDE_BY_SIDE * below[k] + np.arange(SIDE_BY_SIDE)
            parts = [exact.pop(q) for q in quarters.tolist() if q in exact]
            terms, omitted = np.hstack([part for part, _ in parts]), sum(rest for _, rest in parts)
        orders[k] = _rules(terms, centre[k], half[k], highest, nodes[k], rests[k])
        rests[k] += omitted
        # What stands for the panel in the one above: its rule of the highest order, or its terms.
        o = int(orders[k]) - 1
        if o >= 0 and ORDERS[o] == highest:
            exact[k] = nodes[k, :, STARTS[o] : STARTS[o + 1]], float(rests[k, o])
        else:
            exact[k] = terms, omitted
    return Panels(points, rest, centre, half, first, last, below, orders, nodes, rests)


def _distinct(x: Array, y: Array) -> tuple[Array, float]:
    """The points (3, m), one for each input, and the sum of squares that this leaves out."""
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    starts = np.flatnonzero(np.r_[True, x[1:] != x[:-1]])
    counts = np.diff(np.r_[starts, x.size])
    means = np.add.reduceat(y, starts) / counts
    within = y - np.repeat(means, counts)
    roots = np.sqrt(counts)
    return np.stack([x[starts], roots, roots * means]), float(within @ within)


def _divide(x: Array, leaf: int) -> tuple[Integers, Integers, Integers]:
    """First and last point of each panel and the group that divides it, from the whole down."""
    spans, below = _quarters(x, 0, x.size), []
    for i, j in spans:  # which grows
        below.append(len(spans) // SIDE_BY_SIDE if j - i > leaf else -1)
        if j - i > leaf:
            spans += _quarters(x, i, j)
    first, last = np.array(spans).T
    return first, last, np.array(below)


def _quarters(x: Array, i: int, j: int) -> list[tuple[int, int]]:
    """First and last point of each quarter of the width of the points from i to j."""
    inner = x[i] + (x[j - 1] - x[i]) * np.arange(1, SIDE_BY_SIDE) / SIDE_BY_SIDE
    cuts = i + np.searchsorted(x[i:j], inner, "right")
    return list(pairwise([i, *cuts.tolist(), j]))


def _rules(
    terms: Array, centre: float, half: float, highest: int, nodes: Array, rests: Array
) -> int:
    """Write the rules of terms (3, m) into `nodes` and `rests`; how many there are."""
    x, w, y = (terms[0] - centre) / (half or 1.0), terms[1], terms[2].copy()
    most = max((p for p in ORDERS if p < x.size and p <= highest), default=0)
    diagonal, beside, coefficients, squares, count = _lanczos(x, w, y, most)
    size = math.sqrt(w @ w)
    orders = [p for p in ORDERS if p <= count]
    for o, p in enumerate(orders):
        start = STARTS[o]
        places, vectors, _ = dstev(diagonal[:p], beside[: p - 1])
        nodes[0, start : start + p] = centre + half * np.minimum(np.maximum(places, -1), 1)
        nodes[1, start : start + p] = size * vectors[0]
        nodes[2, start : start + p] = coefficients[:p] @ vectors
        rests[o] = squares[p - 1]
    return len(orders)


@njit(cache=True, error_model="numpy")
def _lanczos(x: Array, w: Array, y: Array, most: int) -> tuple[Array, Array, Array, Array, int]:
    """The recurrence of up to `most` orthonormal polynomials at x (m,) with squared weights w^2.

    Gives its diagonal and subdiagonal, the coefficients of y (m,) in these polynomials, the sum of
    squares of y that remains after each, and how many polynomials there are before rounding takes
    over. Overwrites y by what remains of it. Each polynomial is orthogonalised once more against
    all before it, so that they are orthogonal however the points lie.
    """
    basis = np.empty((most, x.size))
    diagonal, beside = np.zeros(most), np.zeros(most)
    coefficients, squares = np.zeros(most), np.zeros(most)
    vector, length = w.copy(), math.sqrt(np.dot(w, w))
    for j in range(most):
        basis[j] = vector / length
        coefficients[j] = np.dot(basis[j], y)
        y -= coefficients[j] * basis[j]
        squares[j] = np.dot(y, y)
        vector = x * basis[j]
        diagonal[j] = np.dot(basis[j], vector)
        vector -= diagonal[j] * basis[j]
        if j > 0:
            vector -= beside[j - 1] * basis[j - 1]
        vector -= np.dot(np.dot(basis[: j + 1], vector), basis[: j + 1])
        length = math.sqrt(np.dot(vector, vector))
        beside[j] = length
        if length < SMALLEST:
            return diagonal, beside, coefficients, squares, j + 1
    return diagonal, beside, coefficients, squares, most
