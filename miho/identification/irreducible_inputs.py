"""The irreducible error for several inputs."""

from __future__ import annotations

import math

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.optim.seeds import stream
from miho.quantities import Array

TIED = 1e-9
"""Random offsets that decide between equally near points, as a fraction of the spread of an
input."""


def irreducible_limit(X: Array, y: Array, level: float = 0.95) -> float:
    """Upper limit of the irreducible error for several inputs X (p, N), in the unit of y.

    For independent errors, the mean of half the squared difference of two points is the variance
    of the noise plus a contribution from the change of the function between the points. The limit
    is too large if points are far apart, and distances grow with the number of inputs. Pairs are
    mutual nearest neighbours, with each input in units of its spread, so no two pairs share a
    point. Chance decides between neighbours at the same distance, for example on a grid. The limit
    is infinite for fewer than five pairs.
    """
    spread = X.std(axis=1, keepdims=True)
    Z = ((X - X.mean(axis=1, keepdims=True)) / np.where(spread > 0, spread, 1.0)).T
    Z += TIED * stream("neighbours").standard_normal(Z.shape)
    nearest = np.asarray(scipy.spatial.cKDTree(Z).query(Z, k=2)[1])[:, 1]
    own = np.arange(y.size)
    pairs = own[(nearest[nearest] == own) & (own < nearest)]
    squares = (y[pairs] - y[nearest[pairs]]) ** 2 / 2
    if pairs.size < 5:
        return math.inf
    if not squares.any():
        return 0.0
    # For normal errors e, e^4 / 3 estimates the square of the variance, as in `_variance`.
    freedom = 3 * float(squares.sum()) ** 2 / float((squares**2).sum())
    return math.sqrt(squares.mean() * freedom / scipy.special.chdtri(freedom, (1 + level) / 2))
