"""Quasi-Newton steps of many configurations at once, from differences of losses.

All arrays lead with the configurations, (n, ...). Coordinates are shares of the widths of the
bounds, so that derivatives of a loss have its unit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

DAMPING = 0.1
"""Powell's damping: an update keeps at least this share of the previous curvature."""
FLAT = 1e-8
"""Smallest curvature of a convex model, relative to its largest, in coordinates of unit
curvature."""


def newton_steps(B: Array, g: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Minimise g s + s B s / 2 within low <= s <= high; steps (n, d) and their gains (n,).

    Active-set method [1]_: a coordinate that leaves the box is fixed at its bound, and freed if the
    model would gain from it. Works in coordinates in which the diagonal of B is one, so that
    parameters of unequal ranges lose no digits.

    References
    ----------
    .. [1] J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed., Springer (2006),
       Algorithm 16.3, for a box.
    """
    n, d = g.shape
    scale = np.sqrt(np.maximum(np.abs(diagonal(B)), np.finfo(float).tiny))
    B, g, low, high = B / _outer(scale, scale), g / scale, low * scale, high * scale
    steps, free = np.zeros((n, d)), np.ones((n, d), bool)
    todo, eye = np.arange(n), np.eye(d)
    for _ in range(3 * d):
        # Minimise over the free coordinates of all that are not solved yet, the others fixed.
        F = free[todo]
        s, b, slope = steps[todo], B[todo], g[todo]
        lo, hi = low[todo], high[todo]
        fixed = np.where(F, 0.0, s)
        rhs = np.where(F, -slope - _times(b, fixed), s)
        s = _solve(np.where(F[:, :, None] & F[:, None, :], b, eye), rhs)
        # Fix coordinates that leave the box; if none does, free the steepest inward one.
        outside = F & ((s < lo) | (s > hi))
        s = np.minimum(np.maximum(s, lo), hi)
        F &= ~outside
        push = slope + _times(b, s)
        wrong_sign = ~F & (((s <= lo) & (push < 0)) | ((s >= hi) & (push > 0)))
        hit: NDArray[np.bool_] = np.asarray(outside.any(axis=1), bool)
        wrong_sign &= ~hit[:, None]
        freed = np.flatnonzero(wrong_sign.any(axis=1))
        if freed.size:
            F[freed, np.argmax(np.where(wrong_sign, np.abs(push), -1.0), axis=1)[freed]] = True
        steps[todo], free[todo] = s, F
        unsolved = hit.copy()
        unsolved[freed] = True
        todo = todo[unsolved]
        if not todo.size:
            break
    gains = -np.einsum("ni,ni->n", steps, g + 0.5 * _times(B, steps))
    return steps / scale, np.asarray(gains)


def bfgs(B: Array, s: Array, y: Array) -> Array:
    """BFGS update of B (n, d, d) after steps s (n, d) that changed the gradients by y (n, d).

    With Powell's damping, which keeps B positive definite if the curvature of the loss is negative
    (Nocedal and Wright, 2006, Procedure 18.2, with a share of 0.1 in place of 0.2).
    """
    Bs = _times(B, s)
    sBs, sy = np.einsum("ni,ni->n", s, Bs), np.einsum("ni,ni->n", s, y)
    with np.errstate(all="ignore"):
        share = np.where(sy >= DAMPING * sBs, 1.0, (1 - DAMPING) * sBs / (sBs - sy))[:, None]
        r = share * y + (1 - share) * Bs
        sr = np.einsum("ni,ni->n", s, r)
        updated = B - _outer(Bs, Bs) / sBs[:, None, None] + _outer(r, r) / sr[:, None, None]
    usable = (sBs > 0) & (sr > 0) & np.isfinite(updated).all(axis=(1, 2))
    return np.where(usable[:, None, None], updated, B)


def curve_along(B: Array, s: Array, curvature: Array) -> Array:
    """B changed so that s B s is the `curvature` (n,) measured along steps s (n, d)."""
    Bs = _times(B, s)
    sBs = np.einsum("ni,ni->n", s, Bs)
    with np.errstate(all="ignore"):
        updated = B + ((curvature - sBs) / sBs**2)[:, None, None] * _outer(Bs, Bs)
    usable = (sBs > 0) & np.isfinite(updated).all(axis=(1, 2))
    return np.where(usable[:, None, None], updated, B)


def convex(H: Array, g: Array) -> Array:
    """Hessians H (n, d, d) with positive curvatures, so that Newton steps descend.

    Eigenvalues are replaced by their absolute values, in coordinates in which the diagonal is one,
    so that they do not depend on the ranges of the parameters. Small ones are raised to FLAT of the
    largest; without curvature the slopes g (n, d) determine it. So steps stay finite.
    """
    curvature = np.abs(diagonal(H))
    largest = np.maximum(curvature, np.abs(g)).max(axis=1, keepdims=True)
    largest[largest == 0] = 1.0
    scale = np.sqrt(np.maximum(curvature, FLAT * largest))
    values, vectors = np.linalg.eigh(H / _outer(scale, scale))
    values = np.abs(values)
    values = np.maximum(values, FLAT * np.maximum(values.max(axis=1, keepdims=True), 1.0))
    H = np.einsum("nik,nk,njk->nij", vectors, values, vectors)
    return np.asarray(H * _outer(scale, scale))


class Parabola(NamedTuple):
    """Slopes and curvatures (n, d) along each coordinate."""

    slope: Array
    curvature: Array


def parabolas(loss: Array, a: Array, at_a: Array, b: Array, at_b: Array) -> Parabola:
    """Parabolas through losses (n,), and at_a and at_b (n, d) at offsets a, b (n, d).

    One for each coordinate. If one of the losses is not finite, the line through the other; if both
    are not, zero.
    """
    with np.errstate(all="ignore"):
        to_a, to_b = (at_a - loss[:, None]) / a, (at_b - loss[:, None]) / b
        curvature = 2 * (to_a - to_b) / (a - b)
        slope = to_a - curvature * a / 2
    finite = np.isfinite(curvature) & np.isfinite(slope)
    line = np.where(np.isfinite(to_a), to_a, np.where(np.isfinite(to_b), to_b, 0.0))
    return Parabola(np.where(finite, slope, line), np.where(finite, curvature, 0.0))


def mixed(loss: Array, a: Array, at_a: Array, at_both: Array, curvature: Array) -> Array:
    """Hessians (n, d, d) from the curvatures (n, d) and the losses at offsets a (n, d).

    `at_a` (n, d) are the losses at each offset alone, `at_both` (n, d (d - 1) / 2) at two of them
    together, in the order of the upper triangle. Entries that are not finite become zero.
    """
    n, d = a.shape
    i, j = np.triu_indices(d, 1)
    H = np.zeros((n, d, d))
    with np.errstate(all="ignore"):
        twist = (at_both - at_a[:, i] - at_a[:, j] + loss[:, None]) / (a[:, i] * a[:, j])
    H[:, i, j] = H[:, j, i] = np.where(np.isfinite(twist), twist, 0.0)
    H[:, np.arange(d), np.arange(d)] = curvature
    return H


def diagonal(B: Array) -> Array:
    """Diagonals of matrices, (n, d)."""
    return np.asarray(np.einsum("nkk->nk", B))


def _times(B: Array, s: Array) -> Array:
    return np.asarray((B @ s[:, :, None])[:, :, 0])


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]


def _solve(A: Array, b: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(A, b[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        return _times(np.asarray(np.linalg.pinv(A, hermitian=True), float), b)
