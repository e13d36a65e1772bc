"""The inverse of J'J on what rows determine, and the directions that they do not see."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

SINGULAR = 1e-10
"""A direction whose singular value is at most this fraction of the largest does not change the
predictions."""
INVOLVED = 1e-6
"""A component of a null direction above this fraction makes a parameter unidentifiable."""


class InverseRoot(NamedTuple):
    """`half` (d, r) times its transpose is the pseudo-inverse of J'J, and `basis` (N, r), which is
    orthonormal, spans the derivatives: half @ basis.T turns errors into changes of parameters.

    `null` (k, d) are the directions in which parameters can move while every row is predicted the
    same, and `moved` (k, d) marks the parameters that each moves.
    """

    half: Array
    basis: Array
    null: Array
    moved: NDArray[np.bool_]


def inverse_root(J: Array, free: NDArray[np.intp]) -> InverseRoot:
    """That of derivatives J (N, d), by singular values, with each column scaled to unit length.

    Parameters that are not at the positions `free` are held: their rows and columns are 0.
    """
    scale = np.linalg.norm(J[:, free], axis=0)
    scale[scale == 0] = 1.0
    U, s, Vt = np.linalg.svd(J[:, free] / scale, full_matrices=len(J) < free.size)
    s = np.append(s, np.zeros(len(Vt) - s.size))
    determined = s > SINGULAR * s.max(initial=0.0)
    half = np.zeros((J.shape[1], int(determined.sum())))
    half[free] = Vt[determined].T / s[determined] / scale[:, None]
    null = np.zeros((int((~determined).sum()), J.shape[1]))
    null[:, free] = Vt[~determined] / scale
    moved = np.zeros(null.shape, dtype=bool)
    moved[:, free] = np.abs(Vt[~determined]) > INVOLVED
    return InverseRoot(half, U[:, determined[: U.shape[1]]], null, moved)
