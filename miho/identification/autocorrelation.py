"""Errors that depend on the errors of previous rows: a test, a model, and variances of sums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.quantities import Array

RESEMBLING = 0.1
"""Errors of neighbouring rows are dependent if their correlation exceeds this ..."""
SCORE = 2.33
"""... and exceeds this number of standard deviations for independent errors, which has a chance of
1 %."""
HIGHEST_ORDER = 20
ROWS_PER_COEFFICIENT = 8
"""Smallest number of degrees of freedom for each coefficient of an autoregressive model."""
NEAREST = 3.0
"""Largest atanh of a partial autocorrelation, which is then 0.995: beyond, errors drift without
bound."""
STEP, REFINING_STEP = 1e-4, 5e-3
"""Steps of differences of the likelihood, in atanh of a partial autocorrelation. Of smooth errors
the likelihood is rounded by 1e-4, so that slopes by the first step are wrong by about 1."""
REFINEMENTS = 2
"""Newton steps after a descent, which rounding ends early: standard errors then differ by 1e-4
between kernels of BLAS in place of 3e-3."""
INSIGNIFICANT = 0.01
"""Newton steps may lower twice the logarithm of the likelihood by this."""
WIDE_STEP = 0.05
"""Step of second differences of the likelihood; rounding errors dominate for smaller ones."""
ROUNDING = 1e-14
"""Rounding of sums of products of columns of length 1, as a fraction of the sum of the magnitudes
of their weights."""
ALL = (slice(None),)
"""A single series of all rows. Within a series, rows are consecutive."""
NEWTON_STEPS = 8
"""Number of steps that inverts the trigamma function to all digits."""
SPANNED = 1e-8
"""Columns are spanned by others if at most this fraction of them is left without the others."""
LEAST_INFORMATION = 1.0
"""Lower limit of the information: atanh of a partial autocorrelation has a prior deviation of 1."""
UNBELIEVABLE = 30.0
"""A model with more than this multiple of the mean square of the errors is not used. On simulated
drives models that fit have 1.4 to 2.1 times the mean square, models with a root next to 1 over 130
times."""


class SerialCorrelation(NamedTuple):
    """Autocorrelation at lag 1, corrected for the effect of a fit.

    `score` is the correlation in standard deviations for independent errors.
    """

    correlation: float
    score: float

    @property
    def significant(self) -> bool:
        """Whether errors of neighbouring rows count as dependent."""
        return self.correlation > RESEMBLING and self.score > SCORE


def serial_correlation(
    errors: Array, basis: Array, series: Sequence[slice] = ALL
) -> SerialCorrelation:
    """Correlation of neighbouring errors (N,) of a fit, in the order of the rows of each series.

    The orthonormal `basis` (N, d) spans the derivatives of the fit, to which the errors are
    orthogonal. Mean and variance of the statistic for independent errors are exact if the errors
    are normal (Durbin and Watson, Biometrika 37, 1950). The result is 0 if there are too few rows
    for a model of the dependence.
    """
    rows, d = basis.shape
    freedom, total = rows - d, float(errors @ errors)
    if freedom < ROWS_PER_COEFFICIENT or total == 0:
        return SerialCorrelation(0.0, 0.0)
    shifted = np.zeros_like(basis)  # A basis; e.T A e is the sum of products of neighbours
    products, pairs = 0.0, 0
    for own in series:
        shifted[own][1:] += basis[own][:-1] / 2
        shifted[own][:-1] += basis[own][1:] / 2
        products += float(errors[own][1:] @ errors[own][:-1])
        pairs += errors[own].size - 1
    inner = basis.T @ shifted
    mean = -float(np.trace(inner)) / freedom
    squares = pairs / 2 - 2 * np.sum(shifted**2) + np.sum(inner**2)
    variance = 2 * (squares - freedom * mean**2) / freedom / (freedom + 2)
    excess = products / total - mean
    return SerialCorrelation(excess, float(excess / np.sqrt(variance)) if variance > 0 else 0.0)


@dataclass(frozen=True, eq=False)
class Autoregression:
    """A stationary autoregressive model e_t = sum_k phi_k e_(t-k) + u_t of errors.

    `partial` (p,) holds the partial autocorrelations, within +-1, and `variance` is the variance of
    the innovations u, in the squared unit of the errors.
    """

    partial: Array
    variance: float

    @cached_property
    def coefficients(self) -> Array:
        """The coefficients phi (p,)."""
        return np.asarray(_coefficients(self.partial[None])[0])

    @cached_property
    def autocovariances(self) -> Array:
        """Covariance of e_t with e_t, ..., e_(t-p+1), (p,): the Durbin-Levinson recursion."""
        left = self.variance / np.prod(1 - self.partial**2)
        values = [left]
        for k in range(1, self.partial.size):
            before = _coefficients(self.partial[None, : k - 1])[0]
            values.append(self.partial[k - 1] * left + before @ np.array(values[:0:-1]))
            left *= 1 - self.partial[k - 1] ** 2
        return np.array(values[: self.partial.size])

    def innovations(self, errors: Array) -> Array:
        """Innovations u (N - p,) of all rows but the first p; empty for at most p rows."""
        p = self.partial.size
        if errors.size <= p:
            return errors[:0]
        lags = np.lib.stride_tricks.sliding_window_view(errors, p + 1)
        return np.asarray(lags @ np.append(-self.coefficients[::-1], 1.0))

    def variance_of_sums(
        self, columns: Array, squares: Array | None = None, series: Sequence[slice] = ALL
    ) -> Array:
        """Covariance (d, d) of the sums of errors times `columns` (N, d), columns.T Gamma columns.

        A weighted sum of errors of a series equals a sum of innovations, whose weights are the
        columns filtered backwards, plus a sum of the p errors before the first row. Squared
        innovations `squares` (N,) replace the variance if it changes between rows.
        """
        if len(series) > 1:
            parts = ((columns[own], None if squares is None else squares[own]) for own in series)
            return np.asarray(np.sum([self.variance_of_sums(*part) for part in parts], axis=0))
        p, phi = self.partial.size, self.coefficients
        # The filter is a banded triangular system (importing scipy.signal takes 0.3 s).
        bands = np.repeat(np.append(1.0, -phi)[:, None], len(columns), axis=1)
        weights = scipy.linalg.solve_banded((p, 0), bands, columns[::-1])[::-1]
        each = self.variance if squares is None else squares[:, None]
        before = np.array([phi[m:] @ weights[: p - m] for m in range(p)])
        presample = before.T @ scipy.linalg.toeplitz(self.autocovariances) @ before
        return np.asarray(weights.T @ (each * weights) + presample)


def autoregression(
    errors: Array, basis: Array, series: Sequence[slice] = ALL, most: int | None = None
) -> tuple[Autoregression, list[Autoregression]]:
    """Fit an autoregressive model to the errors (N,) of a fit.

    One model describes all series, which are independent of each other. The order is at least 1 and
    otherwise less than the number of rows of any series. It minimises the corrected information
    criterion (Hurvich and Tsai, Biometrika 76, 1989) over Burg's recursion, or, with the upper
    limit `most`, the criterion of Schwarz (Annals of Statistics 6, 1978).

    Errors of a fit are less correlated than errors of the data, because the fit followed the data.
    The model therefore maximises the restricted likelihood, which allows for the fitted `basis`
    (N, d) (Cheang and Reinsel, JASA 95, 2000).

    For very smooth errors, for example of a filtered log, the restricted likelihood can prefer a
    root next to 1, with a variance that the errors do not have. Burg's model is taken then. One of
    the two descents starts at such a root, because the likelihood may have several maxima.

    Returns the model, and 2 p models one standard error away along p independent directions of the
    coefficients: first all on one side, then all on the other.
    """
    rows, d = basis.shape
    highest = min(
        most or HIGHEST_ORDER, int(10 * np.log10(rows)), (rows - d) // ROWS_PER_COEFFICIENT
    )
    highest = min(highest, max(1, min(errors[own].size for own in series) - 1))
    start = np.arctanh(_burg([errors[own] for own in series], highest, most is not None))
    likelihood = _RestrictedLikelihood(errors, basis, start.size, series)
    end = likelihood.maximum(start)
    if likelihood.model(end).autocovariances[0] > UNBELIEVABLE * np.mean(errors**2):
        end = start
    information, directions = np.linalg.eigh(likelihood.curvature(end) / 2)
    sides = directions / np.sqrt(np.maximum(information, LEAST_INFORMATION))
    return likelihood.model(end), [likelihood.model(end + s) for s in (*sides.T, *-sides.T)]


def degrees_of_freedom(sides: Array, freedom: float) -> Array:
    """Degrees of freedom (n,), at least 1, of variances of sums of dependent errors.

    `sides` (2 p, n) holds the variances for the models of `autoregression` one standard error away,
    and `freedom` is the degrees of freedom of the errors. The logarithm of a mean square with the
    resulting degrees of freedom is as uncertain as the logarithm of the variance (Smyth,
    Statistical Applications in Genetics and Molecular Biology 3, 2004). The uncertainty comes from
    the number of rows and, to first order, from the model.
    """
    known = (sides > 0).all(axis=0)
    high, low = np.split(np.log(sides, out=np.zeros_like(sides), where=known), 2)
    rows = scipy.special.polygamma(1, freedom / 2)
    uncertainty = rows + np.sum(((high - low) / 2) ** 2, axis=0)
    half = 0.5 + 1 / uncertainty  # solve trigamma(half) = uncertainty by Newton on 1 / trigamma
    for _ in range(NEWTON_STEPS):
        trigamma = scipy.special.polygamma(1, half)
        half += trigamma * (1 - trigamma / uncertainty) / scipy.special.polygamma(2, half)
    return np.asarray(np.maximum(2 * half, 1.0))


def chance_of_trend(
    errors: Array, basis: Array, columns: Array, order: int, series: Sequence[slice] = ALL
) -> float:
    """P value of the test that autoregressive errors (N,) follow `columns` (N, k).

    The errors are orthogonal to `basis` (N, d), whose span is removed from the columns first. An F
    test uses the sums of errors times the remaining columns, with the covariance from an
    autoregressive model that is fitted together with the columns. A trend along the columns then
    does not count as dependence of neighbours. The order of this model is at most `order`, the
    order without the columns, because a higher order would fit the gap that the columns leave. The
    result is 1 for too few rows.
    """
    rest = columns - basis @ (basis.T @ columns)
    left, sizes, _ = np.linalg.svd(rest, full_matrices=False)
    trend = left[:, sizes > SPANNED * np.linalg.norm(columns)]
    both = np.hstack([basis, trend])
    freedom = errors.size - both.shape[1]
    if not trend.shape[1] or freedom < ROWS_PER_COEFFICIENT:
        return 1.0
    model, sides = autoregression(errors - both @ (both.T @ errors), both, series, order)
    sums = trend.T @ errors
    direction = np.linalg.solve(model.variance_of_sums(trend, None, series), sums)
    variances = [direction @ s.variance_of_sums(trend, None, series) @ direction for s in sides]
    known = float(degrees_of_freedom(np.array(variances)[:, None], freedom)[0])
    return float(scipy.special.fdtrc(sums.size, known, sums @ direction / sums.size))


class _RestrictedLikelihood:
    """-2 log of the restricted likelihood of autoregressive models of one order, up to a constant.

    The exact quadratic form of an autoregressive model is also a quadratic form in (1, -phi), with
    sums of products of shifted columns as coefficients (Box and Jenkins 1970, A7.4). The cost of an
    evaluation is therefore independent of the number of rows. Each model has its best variance of
    the innovations.
    """

    def __init__(
        self, errors: Array, basis: Array, order: int, series: Sequence[slice] = ALL
    ) -> None:
        columns = np.column_stack([basis, errors / np.linalg.norm(errors)])
        self._size = float(errors @ errors)
        self._freedom = basis.shape[0] - basis.shape[1]
        self._series, k = len(series), columns.shape[1]
        products = sum(_shifted_products(columns[own], order) for own in series)
        self._products = np.asarray(products).reshape(-1, k * k)

    def _values(self, z: Array) -> tuple[Array, Array]:
        """Values (n,) and variances of the innovations (n,) at z (n, p), atanh of `partial`."""
        partial = np.tanh(z)
        a = np.column_stack([np.ones(len(z)), -_coefficients(partial)])
        form = (a[:, :, None] * a[:, None, :]).reshape(len(z), -1) @ self._products
        k = round(float(np.sqrt(form.shape[1])))
        form = form.reshape(-1, k, k)
        floor = ROUNDING * np.sum(np.abs(a), axis=1) ** 2
        form = (form + form.swapaxes(1, 2)) / 2 + floor[:, None, None] * np.eye(k)
        diagonal = 2 * np.log(np.diagonal(np.linalg.cholesky(form), axis1=1, axis2=2))
        determinant = -np.log1p(-(partial**2)) @ np.arange(1.0, z.shape[1] + 1) * self._series
        value = self._freedom * diagonal[:, -1] + diagonal[:, :-1].sum(axis=1) + determinant
        return value, np.exp(diagonal[:, -1]) / self._freedom * self._size

    def maximum(self, start: Array) -> Array:
        """The z (p,) of the highest likelihood, by descents from `start` and from a root near 1."""
        near = np.append(np.copysign(NEAREST, start[:1]), start[1:])
        limits = [(-NEAREST, NEAREST)] * start.size
        ends = [
            scipy.optimize.minimize(
                self.with_slope, z, jac=True, method="L-BFGS-B", bounds=limits
            ).x
            for z in (start, near)
        ]
        end = ends[int(np.argmin(self._values(np.array(ends))[0]))]
        information, directions = np.linalg.eigh(self.curvature(end))
        inverse = directions / np.maximum(information, LEAST_INFORMATION) @ directions.T
        for _ in range(REFINEMENTS):
            value, slope = self.with_slope(end, REFINING_STEP)
            refined = np.clip(end - inverse @ slope, -NEAREST, NEAREST)
            if self._values(refined[None])[0][0] > value + INSIGNIFICANT:
                break
            end = refined
        return np.asarray(end)

    def with_slope(self, z: Array, step: float = STEP) -> tuple[float, Array]:
        """Value and derivatives (p,) at z (p,), by central differences."""
        along = step * np.eye(z.size)
        values = self._values(np.vstack([z, z + along, z - along]))[0]
        high, low = values[1:].reshape(2, -1)
        return float(values[0]), (high - low) / (2 * step)

    def curvature(self, z: Array) -> Array:
        """Second derivatives (p, p) at z (p,)."""
        step = WIDE_STEP * np.eye(z.size)
        corners = [
            z + (i * step[:, None] + j * step[None, :]).reshape(-1, z.size)
            for i, j in ((1, 1), (-1, -1), (1, -1), (-1, 1))
        ]
        same, opposite, cross, other = self._values(np.vstack(corners))[0].reshape(4, -1)
        second = (same + opposite - cross - other) / (4 * WIDE_STEP**2)
        return np.asarray(second.reshape(z.size, z.size))

    def model(self, z: Array) -> Autoregression:
        """The model at z (p,), limited to stationary models."""
        z = np.clip(z, -NEAREST, NEAREST)
        return Autoregression(np.tanh(z), float(self._values(z[None])[1][0]))


def _coefficients(partial: Array) -> Array:
    """Coefficients (n, p) of partial autocorrelations (n, p): the Durbin-Levinson recursion."""
    phi = partial[:, :0]
    for k in range(partial.shape[1]):
        last = partial[:, k : k + 1]
        phi = np.hstack([phi - last * phi[:, ::-1], last])
    return phi


def _burg(series: Sequence[Array], highest: int, schwarz: bool = False) -> Array:
    """Partial autocorrelations (p,) by Burg's recursion, with the best order up to `highest`."""
    pairs = [(errors[1:], errors[:-1]) for errors in series]
    rows = sum(errors.size for errors in series)
    partial, spread = [], [sum(float(errors @ errors) for errors in series) / rows]
    nearest = float(np.tanh(NEAREST))
    for _ in range(highest):
        total = sum(float(f @ f + b @ b) for f, b in pairs)
        k = 2 * sum(float(f @ b) for f, b in pairs) / total
        k = min(max(k, -nearest), nearest)
        partial.append(k)
        spread.append(spread[-1] * (1 - k**2))
        pairs = [((f - k * b)[1:], (b - k * f)[:-1]) for f, b in pairs]
    order = np.arange(highest + 1)
    penalty = np.log(rows) if schwarz else 2 * rows / (rows - order - 2)
    criterion = rows * np.log(spread) + (order + 1) * penalty
    return np.array(partial[: 1 + int(np.argmin(criterion[1:]))])


def _shifted_products(columns: Array, order: int) -> Array:
    """Sums of columns[i + t] times columns[j + t] over t < N - i - j, (p + 1, p + 1, k, k)."""
    rows, k = columns.shape
    D = np.empty((order + 1, order + 1, k, k))
    for j in range(order + 1):
        D[0, j] = columns[: rows - j].T @ columns[j:]
        D[j, 0] = D[0, j].T
    for i in range(order):
        for j in range(order):
            ends = np.outer(columns[i], columns[j])
            ends += np.outer(columns[rows - 1 - j], columns[rows - 1 - i])
            D[i + 1, j + 1] = D[i, j] - ends
    return D
