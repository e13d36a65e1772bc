"""How much of the output no function of the model's inputs can explain."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def irreducible_error(x: Array, y: Array) -> float:
    """Standard deviation of y (N,) around any smooth function of one input x (N,), in y's unit.

    The difference-based estimate of Gasser, Sroka and Jennen-Steinmetz (Biometrika 73, 1986):
    each point, ordered by x, is compared with the line through its two neighbours. It needs no
    model, and counts measurement noise and the effect of inputs that are not in x alike. Rows of
    equal x are compared with the mean of their neighbours. NaN for fewer than three points.
    """
    if x.size < 3:
        return math.nan
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    width = x[2:] - x[:-2]
    a = np.divide(x[2:] - x[1:-1], width, out=np.full(width.shape, 0.5), where=width > 0)
    pseudo_residuals = a * y[:-2] + (1 - a) * y[2:] - y[1:-1]
    return float(np.sqrt(np.mean(pseudo_residuals**2 / (a**2 + (1 - a) ** 2 + 1))))
