"""The pseudo-inverse of J'J, and the directions that rows do not determine."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

SINGULAR = 1e-10
"""A direction does not change the predictions if its singular value is at most this fraction of the
largest, which is the error of derivatives by differences."""
EXACT = 1e-14
"""The same fraction for models that are linear in all parameters, with exact derivatives: some 50
roundings of a double. Powers up to the fifth of calendar years are that close to dependent."""
SMALLEST = 1e-140
"""A column of derivatives counts as zero if its norm is smaller. A variance is the inverse square
of the norm and overflows below 1e-154; the singular values divide it by up to 1e-14 more."""
ROUNDING = 1e-12
"""A smaller component of a unit vector is rounding: the direction does not move the parameter."""
INVOLVED = 1e-6
"""A parameter is unidentifiable if its component of a null direction exceeds this fraction."""


class InverseRoot(NamedTuple):
    """A root of the pseudo-inverse of J'J.

    `half` (d, r) times its transpose is the pseudo-inverse. The orthonormal `basis` (N, r) spans
    the derivatives, so half @ basis.T maps errors to changes of parameters. Parameters can move
    along `null` (k, d) without changing any prediction, and `moved` (k, d) marks the parameters
    that each null direction moves.
    """

    half: Array
    basis: Array
    null: Array
    moved: NDArray[np.bool_]


def inverse_root(J: Array, free: NDArray[np.intp], singular: float = SINGULAR) -> InverseRoot:
    """The root for derivatives J (N, d), by singular values of columns scaled to unit length.

    Parameters outside the positions `free` are fixed: their entries are 0.
    """
    scale = np.linalg.norm(J[:, free], axis=0)
    scale[scale < SMALLEST] = np.inf
    U, s, Vt = np.linalg.svd(J[:, free] / scale, full_matrices=len(J) < free.size)
    scale[np.isinf(scale)] = 1.0
    s = np.append(s, np.zeros(len(Vt) - s.size))
    determined = s > singular * s.max(initial=0.0)
    half = np.zeros((J.shape[1], int(determined.sum())))
    half[free] = Vt[determined].T / s[determined] / scale[:, None]
    null = np.zeros((int((~determined).sum()), J.shape[1]))
    Vt[np.abs(Vt) < ROUNDING] = 0.0
    null[:, free] = Vt[~determined] / scale
    moved = np.zeros(null.shape, dtype=bool)
    moved[:, free] = np.abs(Vt[~determined]) > INVOLVED
    return InverseRoot(half, U[:, determined[: U.shape[1]]], null, moved)
