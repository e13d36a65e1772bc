"""A sum of squares over many points of one input, as sums over a few points of each panel.

For every polynomial q of a degree below p, the points of a panel and the p nodes of a Gauss rule
for them (Golub and Welsch 1969, for a discrete measure) give the same sum of squares

    sum_i (q(x_i) - y_i)^2 = sum_k (w_k q(t_k) - u_k)^2 + rest,

because the values of orthonormal polynomials at the nodes, times w_k, are an orthogonal matrix: u
is y's projection on the polynomials and rest the squared length of what is left. No term is
negative, so nothing cancels. The polynomials come from the Lanczos process. Two neighbouring panels
become one by the same construction from their nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg.lapack import dstev

Array = NDArray[np.float64]

ORDERS = (4, 8, 12, 16, 20, 24, 28, 32)
"""Numbers of nodes a panel can be replaced by."""
STARTS = (0, 4, 12, 24, 40, 60, 84, 112, 144)
"""Where the nodes of each order start within a panel, and their end."""
LEAF = 64
"""A panel of more points is divided."""
LEAVES = 1024
SMALLEST = 1e-12
"""A vector this much shorter than its parts is rounding."""


@dataclass(frozen=True, eq=False)
class Panels:
    """A binary tree of panels in the order in which a walk meets them: parent, left, right.

    points (3, m) are the distinct inputs in ascending order, their weights w and their values u, as
    in the sum above; `rest` is what these leave out. Panel k covers `centre[k]` +- `half[k]` and
    the points from `first[k]` to `last[k]`; it has `orders[k]` rules, and those of order o are in
    `nodes[k]` (3, ...) from STARTS[o], leaving out `rests[k, o]` of its points. The walk goes on
    at `after[k]` if it is done with the panel; at k + 1, if that is less, to see its halves.
    """

    points: Array
    rest: float
    centre: Array
    half: Array
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    after: NDArray[np.int64]
    orders: NDArray[np.int64]
    nodes: Array
    rests: Array

    @property
    def unexplained(self) -> float:
        """The sum of squares that a polynomial of degree 7 on every leaf leaves."""
        leaves = (self.after == np.arange(self.after.size) + 1) & (self.orders > 1)
        return self.rest + float(self.rests[leaves, 1].sum())


def panels(x: Array, y: Array) -> Panels:
    """The panels of points x (N,) with values y (N,), halved until few points are left in each."""
    points, rest = _distinct(x, y)
    leaf = max(LEAF, points.shape[1] // LEAVES)
    spans, after = _divide(points[0], leaf)
    count = len(spans)
    centre, half = np.empty(count), np.empty(count)
    orders = np.zeros(count, np.int64)
    nodes, rests = np.zeros((count, 3, STARTS[-1])), np.zeros((count, len(ORDERS)))
    exact: dict[int, tuple[Array, float]] = {}
    for k in reversed(range(count)):
        i, j = spans[k]
        low, high = points[0, i], points[0, j - 1]
        centre[k], half[k] = (low + high) / 2, (high - low) / 2
        if after[k] == k + 1:
            given, before = points[:, i:j], 0.0
        else:
            halves = [exact.pop(k + 1), exact.pop(int(after[k + 1]))]
            given = np.hstack([part for part, _ in halves])
            before = sum(left for _, left in halves)
        orders[k] = _rules(given, centre[k], half[k], nodes[k], rests[k])
        rests[k] += before
        if orders[k] == len(ORDERS):
            exact[k] = nodes[k, :, STARTS[-2] :], float(rests[k, -1])
        else:
            exact[k] = given, before
    first, last = np.array(spans).T
    return Panels(points, rest, centre, half, first, last, np.array(after), orders, nodes, rests)


def _distinct(x: Array, y: Array) -> tuple[Array, float]:
    """Points with the same input as one, and the sum of squares within them."""
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    starts = np.flatnonzero(np.r_[True, x[1:] != x[:-1]])
    counts = np.diff(np.r_[starts, x.size])
    means = np.add.reduceat(y, starts) / counts
    within = y - np.repeat(means, counts)
    roots = np.sqrt(counts)
    return np.stack([x[starts], roots, roots * means]), float(within @ within)


def _divide(x: Array, leaf: int) -> tuple[list[tuple[int, int]], list[int]]:
    """First and last point of each panel, and the panel after it and its halves.

    A panel ends at its outer points and is halved in the middle, so that no half is empty.
    """
    spans: list[tuple[int, int]] = []
    after: list[int] = []
    open_panels = [(0, x.size)]
    parents: list[tuple[int, int]] = []
    while open_panels:
        i, j = open_panels.pop()
        while parents and parents[-1][1] <= i:
            after[parents.pop()[0]] = len(spans)
        spans.append((i, j))
        after.append(len(spans))
        if j - i > leaf:
            parents.append((len(spans) - 1, j))
            cut = i + int(np.searchsorted(x[i:j], x[i] + (x[j - 1] - x[i]) / 2, "right"))
            cut = min(max(cut, i + 1), j - 1)
            open_panels += [(cut, j), (i, cut)]
    for parent, _ in parents:
        after[parent] = len(spans)
    return spans, after


def _rules(given: Array, centre: float, half: float, nodes: Array, rests: Array) -> int:
    """Write the rules of points `given` (3, m) into `nodes` and `rests`; how many there are."""
    x, w, y = (given[0] - centre) / (half or 1.0), given[1], given[2].copy()
    most = max((p for p in ORDERS if p < x.size), default=0)
    diagonal, beside, coefficients, lefts, made = _lanczos(x, w, y, most)
    size = math.sqrt(w @ w)
    orders = [p for p in ORDERS if p <= made]
    for o, p in enumerate(orders):
        start = STARTS[o]
        places, vectors, _ = dstev(diagonal[:p], beside[: p - 1])
        nodes[0, start : start + p] = centre + half * np.minimum(np.maximum(places, -1), 1)
        nodes[1, start : start + p] = size * vectors[0]
        nodes[2, start : start + p] = coefficients[:p] @ vectors
        rests[o] = lefts[p - 1]
    return len(orders)


@njit(cache=True, error_model="numpy")
def _lanczos(x: Array, w: Array, left: Array, most: int) -> tuple[Array, Array, Array, Array, int]:
    """Recurrence of the orthonormal polynomials at x (m,) with squared weights w^2, up to `most`.

    Its diagonal and what is beside it, the coefficients of `left` (m,), which is overwritten, and
    the sum of squares left after each; and how many there are before rounding takes over. Each is
    made orthogonal once more to all before it, so that they are so however the points lie.
    """
    basis = np.empty((most, x.size))
    diagonal, beside = np.zeros(most), np.zeros(most)
    coefficients, lefts = np.zeros(most), np.zeros(most)
    vector, length = w.copy(), math.sqrt(np.dot(w, w))
    for j in range(most):
        basis[j] = vector / length
        coefficients[j] = np.dot(basis[j], left)
        left -= coefficients[j] * basis[j]
        lefts[j] = np.dot(left, left)
        vector = x * basis[j]
        diagonal[j] = np.dot(basis[j], vector)
        vector -= diagonal[j] * basis[j]
        if j > 0:
            vector -= beside[j - 1] * basis[j - 1]
        vector -= np.dot(np.dot(basis[: j + 1], vector), basis[: j + 1])
        length = math.sqrt(np.dot(vector, vector))
        beside[j] = length
        if length < SMALLEST:
            return diagonal, beside, coefficients, lefts, j + 1
    return diagonal, beside, coefficients, lefts, most
