"""The irreducible error: the part of the output that no function of the model's inputs explains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.optim.seeds import stream
from miho.quantities import Array

TIED = 1e-9
"""Random offsets, as a fraction of an input's spread, that decide between equally near points."""
RESOLVED = 0.5
"""An estimate whose interval reaches below this fraction of it is of no use."""

FEWEST = 3
"""Rows from which it can be estimated at all."""
SORTED_ROWS, NEIGHBOUR_ROWS = 100_000, 20_000
"""Rows from which `irreducible_square` estimates at most: for one input, which is sorted, and for
several, where the search for nearest neighbours takes longer the more inputs there are."""


class Irreducible(NamedTuple):
    """An estimate of the irreducible error and its interval, all in the output's unit."""

    value: float
    low: float
    high: float

    @property
    def resolved(self) -> bool:
        """Whether the points lie close enough for the estimate to be of use."""
        return self.low >= RESOLVED * self.value and math.isfinite(self.high)


def irreducible_square(inputs: Sequence[Array], y: Array) -> float:
    """The most that the mean square of the irreducible error may be, in y's unit squared.

    By `irreducible_interval` for one input (N,) and `irreducible_limit` for several; of long data
    every so many rows are used. Infinite for fewer than three.
    """
    if y.size < FEWEST:
        return math.inf
    sample = slice(None, None, -(-y.size // (SORTED_ROWS if len(inputs) == 1 else NEIGHBOUR_ROWS)))
    X, y = np.array(inputs)[:, sample], y[sample]
    return (irreducible_interval(X[0], y).high if len(X) == 1 else irreducible_limit(X, y)) ** 2


def irreducible_error(x: Array, y: Array) -> float:
    """Standard deviation of y (N,) around any smooth function of one input x (N,), in y's unit.

    The difference-based estimate of Gasser, Sroka and Jennen-Steinmetz (Biometrika 73, 1986):
    each point, ordered by x, is compared with the line through its two neighbours. It needs no
    model, and counts measurement noise and the effect of inputs that are not in x alike. Rows of
    equal x are compared with the mean of their neighbours. NaN for fewer than three points.
    """
    return irreducible_interval(x, y).value


def irreducible_interval(x: Array, y: Array, level: float = 0.95) -> Irreducible:
    """The estimate of `irreducible_error`, and an interval that holds the truth.

    The mean of the squared pseudo-residuals has, for independent normal errors whose spread may
    change along x, a variance that their fourth powers and products estimate without bias; a
    chi-squared distribution of that variance gives the interval (Satterthwaite, Biometrics
    Bulletin 2, 1946). Where the points lie far apart the curve's own bend counts as error: twice
    the distance counts it sixteen times, so the lower end is below by what twice the distance
    adds. All NaN for fewer than three points, an interval from 0 to infinity for fewer than five.
    """
    if x.size < FEWEST:
        return Irreducible(math.nan, math.nan, math.nan)
    # The estimate: the mean square of the pseudo-residuals.
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    errors, weights = _pseudo_residuals(x, y)
    square = float(np.mean(errors**2))
    value = math.sqrt(square)
    if x.size < 5 or square == 0:
        return Irreducible(value, 0.0, math.inf if x.size < 5 else value)
    # Its interval, with a lower end that allows for the bend of the curve.
    freedom = 2 * square**2 / _variance(errors, weights)
    tail = (1 - level) / 2
    wider = [_pseudo_residuals(x[half::2], y[half::2])[0] for half in (0, 1)]
    bend = max(0.0, float(np.mean(np.concatenate(wider) ** 2)) - square)
    lowest = square * freedom / float(scipy.special.chdtri(freedom, tail)) - bend
    highest = (
        square * freedom / max(float(scipy.special.chdtri(freedom, 1 - tail)), np.finfo(float).tiny)
    )
    return Irreducible(value, math.sqrt(max(0.0, lowest)), math.sqrt(highest))


def irreducible_limit(X: Array, y: Array, level: float = 0.95) -> float:
    """The upper end of the interval of the irreducible error for several inputs X (p, N), y's unit.

    Half the squared difference of two points has the noise's variance for its mean, if errors are
    independent, plus that of the function's own change between them: it is too large where points
    lie far apart, and they lie farther apart the more inputs there are. The pairs are points that
    are each other's nearest neighbour, with each input in units of its spread, so that none shares
    a point with another; chance decides between neighbours at the same distance, as on a grid.
    math.inf for fewer than five pairs.
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


def _pseudo_residuals(x: Array, y: Array) -> tuple[Array, Array]:
    """Each inner point minus the line through its neighbours (N - 2,), scaled to have the variance
    of the noise; and the weights (3, N - 2) of the three points, whose squares add up to 1."""
    width = x[2:] - x[:-2]
    a = np.divide(x[2:] - x[1:-1], width, out=np.full(width.shape, 0.5), where=width > 0)
    weights = np.array([a, np.full(a.shape, -1.0), 1 - a])
    weights /= np.sqrt(np.add.reduce(weights * weights))
    return weights[0] * y[:-2] + weights[1] * y[1:-1] + weights[2] * y[2:], weights


def _variance(errors: Array, weights: Array) -> float:
    """Variance of the mean of the squared errors (n,), which share points with two neighbours.

    For normal errors e with correlation r, e^4 / 3 estimates s^4, the variance of e^2 by two, and
    e_i^2 e_j^2 / (1 + 2 r^2) the product of two variances; the covariance of e_i^2 and e_j^2 is
    2 r^2 times that.
    """
    total = 2 * float(np.sum(errors**4)) / 3
    for lag, shared in (
        (1, weights[1:, :-1] * weights[:-1, 1:]),
        (2, weights[2:, :-2] * weights[:1, 2:]),
    ):
        r = np.add.reduce(shared) ** 2
        total += 2 * float(np.sum(2 * r / (1 + 2 * r) * errors[:-lag] ** 2 * errors[lag:] ** 2))
    return total / errors.size**2
