"""The irreducible error: the part of the output that no function of the model's inputs explains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.optim.seeds import stream
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.curve_fit import CurveFit

RESOLVED = 0.5
"""An estimate is useless if its interval extends below this fraction of it."""

TIED = 1e-9
"""Random offsets that decide between equally near points, as a fraction of the spread of an
input."""
FEWEST = 3
"""Smallest number of rows for an estimate."""
TAIL = (1 - 0.95) / 2
"""Probability on either side of an interval, which has 95 %."""
SORTED_ROWS, NEIGHBOUR_ROWS = 100_000, 20_000
"""Largest numbers of rows that `irreducible_square` uses: for one input, which is sorted, and for
several, because the search for nearest neighbours takes longer."""


class Irreducible(NamedTuple):
    """An estimate of the irreducible error and its interval, all in the unit of the output."""

    value: float
    low: float
    high: float

    @property
    def resolved(self) -> bool:
        """Whether the points are close enough to each other for a useful estimate."""
        return self.low >= RESOLVED * self.value and math.isfinite(self.high)


def irreducible_square(inputs: Sequence[Array], y: Array) -> float:
    """Upper limit of the mean square of the irreducible error, in the squared unit of y.

    It comes from `irreducible_interval` for one input (N,) and from `irreducible_limit` for
    several. Long data are thinned evenly. The limit is infinite for fewer than three rows.
    """
    if y.size < FEWEST:
        return math.inf
    sample = slice(None, None, -(-y.size // (SORTED_ROWS if len(inputs) == 1 else NEIGHBOUR_ROWS)))
    X, y = np.array(inputs)[:, sample], y[sample]
    return (_high(_scatter(X[0], y)) if len(X) == 1 else irreducible_limit(X, y)) ** 2


def square_of_parts(
    inputs: Sequence[Array], y: Array, weights: Array, parts: Array | None
) -> float:
    """Upper limit of the mean square of the weighted irreducible error of the parts of a joint fit.

    Infinite if weights differ within a part, whose neighbouring rows then scatter differently.
    """
    parts = np.zeros(y.size) if parts is None else parts
    total = 0.0
    for own in (parts == part for part in np.unique(parts)):
        if np.ptp(weights[own]) > 0:
            return math.inf
        columns = [x[own] for x in inputs]
        varying = [x for x in columns if np.ptp(x) > 0]  # a part may not read all columns
        square = irreducible_square(varying or columns[:1], weights[own] * y[own])
        total += float(own.mean()) * square
    return total


def irreducible_error(x: Array, y: Array) -> float:
    """Estimate the error that no smooth curve of one input can beat.

    The estimate [1]_ compares each point, ordered by x, with the line through its two neighbours.
    It needs no model. Measurement noise and effects of inputs other than x both count as error.
    Rows with equal x are compared with the mean of their neighbours.

    Parameters
    ----------
    x : ndarray of shape (N,)
        The input.
    y : ndarray of shape (N,)
        The output.

    Returns
    -------
    float
        Standard deviation of y around a smooth function of x, in the unit of y; NaN for fewer than
        three points.

    References
    ----------
    .. [1] Gasser, Sroka and Jennen-Steinmetz, Residual variance and residual pattern in nonlinear
       regression, Biometrika 73, 1986.

    Examples
    --------
    >>> import numpy as np
    >>> from miho.identification import irreducible_error
    >>> x = np.linspace(0.0, 1.0, 500)
    >>> noise = 0.1 * np.random.default_rng(0).standard_normal(500)
    >>> round(irreducible_error(x, np.sin(6 * x) + noise), 2)
    0.1
    """
    return irreducible_interval(x, y).value


def irreducible_interval(x: Array, y: Array) -> Irreducible:
    """The estimate of `irreducible_error` with an interval of 95 %.

    The errors are independent and normal, with a spread that may change along x. Fourth powers and
    products of the pseudo-residuals then estimate the variance of their mean square without bias. A
    chi-squared distribution with that variance gives the interval (Satterthwaite, Biometrics
    Bulletin 2, 1946). If the points are far apart, the curvature of the curve counts as error. At
    twice the distance its mean square is sixteen times as large, so the lower end subtracts the
    increase from every second point. The result is NaN for fewer than three points, and the
    interval reaches from 0 to infinity for fewer than five.
    """
    if x.size < FEWEST:
        return Irreducible(math.nan, math.nan, math.nan)
    scatter = _scatter(x, y)
    value, high = math.sqrt(scatter.square), _high(scatter)
    if x.size < 5 or scatter.square == 0:
        return Irreducible(value, 0.0, high)
    wider = [_pseudo_residuals(scatter.x[k::2], scatter.y[k::2])[0] for k in (0, 1)]
    bend = max(0.0, float(np.mean(np.concatenate(wider) ** 2)) - scatter.square)
    lowest = _over_chi_squared(scatter, TAIL) - bend
    return Irreducible(value, math.sqrt(max(0.0, lowest)), high)


def irreducible_limit(X: Array, y: Array) -> float:
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
    parts = squares / math.ldexp(1.0, math.frexp(squares.max())[1])  # whose squares are numbers
    freedom = 3 * float(parts.sum()) ** 2 / float((parts**2).sum())
    return math.sqrt(squares.mean() * freedom / scipy.special.chdtri(freedom, 1 - TAIL))


def irreducible_of(problem: CurveFit) -> Irreducible:
    """Estimate of the error that no curve in the single input can beat.

    NaN for several inputs, and for rows of different weights: their neighbours scatter differently.
    """
    if len(problem.inputs) != 1 or problem.weights is not None:
        return Irreducible(math.nan, math.nan, math.nan)
    return irreducible_interval(problem.inputs[0], problem.dataset[problem.dataset.output])


class _Scatter(NamedTuple):
    """Points in the order of x, the mean square of their pseudo-residuals, and its freedom.

    The degrees of freedom are NaN if there are fewer than five points or if the square is 0.
    """

    x: Array
    y: Array
    square: float
    freedom: float


def _scatter(x: Array, y: Array) -> _Scatter:
    """The scatter of at least three points (N,)."""
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    errors, weights = _pseudo_residuals(x, y)
    square = float(np.mean(errors**2))
    if x.size < 5 or square == 0:
        return _Scatter(x, y, square, math.nan)
    unit = math.ldexp(1.0, math.frexp(math.sqrt(square))[1])  # fourth powers overflow from 1e77 on
    freedom = 2 * (square / unit**2) ** 2 / _variance(errors / unit, weights)
    return _Scatter(x, y, square, freedom)


def _high(scatter: _Scatter) -> float:
    """Upper end of the interval of the irreducible error."""
    if scatter.x.size < 5:
        return math.inf
    if scatter.square == 0:
        return 0.0
    return math.sqrt(_over_chi_squared(scatter, 1 - TAIL))


def _over_chi_squared(scatter: _Scatter, tail: float) -> float:
    """The variance that a chi-squared distribution gives for this probability above it."""
    quantile = max(float(scipy.special.chdtri(scatter.freedom, tail)), np.finfo(float).tiny)
    return scatter.square * scatter.freedom / quantile


def _pseudo_residuals(x: Array, y: Array) -> tuple[Array, Array]:
    """Distances (N - 2,) of inner points to the line through their neighbours, and weights.

    Distances are scaled to the variance of the noise. The squares of the weights (3, N - 2) of the
    three points add up to 1.
    """
    width = x[2:] - x[:-2]
    a = np.divide(x[2:] - x[1:-1], width, out=np.full(width.shape, 0.5), where=width > 0)
    weights = np.array([a, np.full(a.shape, -1.0), 1 - a])
    weights /= np.sqrt(np.add.reduce(weights * weights))
    return weights[0] * y[:-2] + weights[1] * y[1:-1] + weights[2] * y[2:], weights


def _variance(errors: Array, weights: Array) -> float:
    """Variance of the mean square of errors (n,) that share points with two neighbours each.

    For normal errors e with correlation r, e^4 / 3 estimates s^4, half the variance of e^2, and
    e_i^2 e_j^2 / (1 + 2 r^2) estimates the product of two variances. The covariance of e_i^2 and
    e_j^2 is 2 r^2 times that product.
    """
    squares, total = errors**2, 2 * float(np.add.reduce(errors**4)) / 3
    for lag, shared in (
        (1, weights[1:, :-1] * weights[:-1, 1:]),
        (2, weights[2:, :-2] * weights[:1, 2:]),
    ):
        r = np.add.reduce(shared) ** 2
        shares = 2 * r / (1 + 2 * r)
        total += 2 * float(np.add.reduce(shares * squares[:-lag] * squares[lag:]))
    return total / errors.size**2
