"""Dependence between rows: errors of neighbouring rows are correlated, or rows form events."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from miho.data.dataset import Dataset
from miho.identification.autocorrelation import (
    Autoregression,
    autoregression,
    degrees_of_freedom,
    serial_correlation,
)
from miho.identification.curve_fit import CurveFit
from miho.models.layout import OUTPUT, PART
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.identification.uncertainty import Linearised

EVENT = "event"
"""A column of this name numbers events, for example brakings, whose rows are not independent."""
FEWEST_EVENTS = 3


@dataclass(frozen=True, eq=False)
class Dependence:
    """The dependence of errors on the errors of neighbouring rows, in the order of the data.

    Parameters
    ----------
    correlation : float
        Correlation of consecutive errors, corrected for the correlation that a fit causes.
    model : Autoregression
        The model of the errors, which gives the covariance.
    sides : ndarray of shape (2 p, r, r)
        `Linearised.sums` for models one standard error away from `model` on either side.
    errors : ndarray of shape (N,)
        The errors, after the influence function of a robust loss.
    independent : Linearised
        The uncertainty for independent rows.
    """

    correlation: float
    model: Autoregression
    sides: Array
    errors: Array
    independent: Linearised

    def freedom(self, projected: Array) -> Array:
        """Degrees of freedom (n,) of quantities whose gradients times `half` are these (n, r)."""
        variances = np.einsum("ij,sjk,ik->si", projected, self.sides, projected)
        return degrees_of_freedom(variances, self.independent.freedom)


def dependent(at: Linearised, errors: Array, basis: Array, series: Sequence[slice]) -> Linearised:
    """The uncertainty for errors (N,) that depend on neighbouring rows, if they are correlated.

    The orthonormal `basis` (N, r) spans the derivatives. Rows are neighbours within a `series`.
    """
    alike = serial_correlation(errors, basis, series)
    if not alike.significant or not basis.shape[1]:
        return at
    model, sides = autoregression(errors, basis, series)
    few_rows = errors.size / at.freedom

    def sums_of(model: Autoregression, squares: Array | None = None) -> Array:
        # At least the covariance of independent rows, even if the errors oscillate.
        rows = np.full(errors.size, at.noise**2) if squares is None else errors**2 * few_rows
        least = (basis.T * rows) @ basis
        sums = model.variance_of_sums(basis, squares, series)
        excess, axes = np.linalg.eigh(sums - least)
        return np.asarray(least + axes * np.maximum(excess, 0.0) @ axes.T)

    # White's estimate of the innovations, with the factor for few rows; the first rows have none.
    squares = np.full(errors.size, model.variance)
    for own in series:
        squares[own][model.partial.size :] = model.innovations(errors[own]) ** 2 * few_rows
    dependence = Dependence(
        correlation=alike.correlation,
        model=model,
        sides=np.array([sums_of(side) for side in sides]),
        errors=errors,
        independent=at,
    )
    freedom = dependence.freedom(at.half[np.isfinite(at.standard_errors)])
    return replace(
        at,
        sums=sums_of(model),
        uneven_sums=sums_of(model, squares),
        freedom=int(freedom.min(initial=at.freedom)),
        dependence=dependence,
    )


def widening(at: Linearised, axes: Array) -> Array:
    """How much correlated errors widen the intervals along `axes` (n, d), as factors (n,)."""
    return np.asarray(at.reach(axes) / at.independent.reach(axes))


def serial_correlation_beside_priors(problem: CurveFit, theta: Array) -> float:
    """The significant correlation of neighbouring errors that priors exclude from the model; or 0.

    The result is 0 without priors, or if the data number events.
    """
    if problem.prior is None or events_of(problem.dataset) is not None:
        return 0.0
    basis = np.linalg.qr(problem.error_slopes(theta))[0]
    errors = problem.errors(theta)
    # Remove the part of the errors that the parameters would fit without the priors.
    alike = serial_correlation(errors - basis @ (basis.T @ errors), basis, series_of(problem))
    return alike.correlation if alike.significant else 0.0


def series_of(problem: CurveFit) -> list[slice]:
    """The series of consecutive rows: one for each part or output."""
    inputs = problem.model.inputs
    columns = [problem.dataset[name] for name in (PART, OUTPUT) if name in inputs]
    moved = np.zeros(len(problem.dataset) - 1, dtype=bool)
    for column in columns:
        moved |= np.diff(column) != 0
    ends = (np.flatnonzero(moved) + 1).tolist()
    return [slice(a, b) for a, b in itertools.pairwise([0, *ends, len(problem.dataset)])]


def events_of(dataset: Dataset) -> NDArray[np.intp] | None:
    """The event of each row (N,), from 0, if the data number enough events; else None."""
    if EVENT not in dataset.columns:
        return None
    events, index = np.unique(dataset[EVENT], return_inverse=True)
    return np.asarray(index) if events.size >= FEWEST_EVENTS else None
