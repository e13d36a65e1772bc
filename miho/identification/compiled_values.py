"""Whether compiled code gives what NumPy gives of the same model.

It need not: an expression that is not element by element takes a block for the column, a function
may have another form for compiled code, and a cache on disk may serve what was edited since.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from miho.identification.fused import FusedLoss, cause
from miho.optim.problem import mean_square

Array = NDArray[np.float64]
Values = Callable[[Array], Array]
"""Of one configuration (d,)."""

CLOSE = 1e-9
"""Of the largest value: elementary functions that differ by a few roundings may be in large terms
that cancel."""
MOVED, ROUNDINGS = 4 * float(np.finfo(float).eps), 100.0
"""Where more cancels than that: values that a parameter moves by its last bits, by so much of the
parameter, may differ by so many times that."""


def difference(loss: FusedLoss, kind: str, thetas: Array) -> str:
    """Where compiled losses, residuals, derivatives or rows are not NumPy's; empty if they are.

    Compared at configurations (n, d), where NumPy's values are finite; what cannot be compiled is
    said likewise.
    """
    compiled, by_numpy = KINDS[kind](loss)
    for theta in thetas:
        expected = by_numpy(theta)
        try:
            given = compiled(theta)
        except NumbaError as error:
            return f"cannot be compiled: {cause(error)}"
        with np.errstate(invalid="ignore", over="ignore"):
            close = np.abs(given - expected) <= _tolerance(by_numpy, theta)
        wrong = np.isfinite(expected) & ~close
        if wrong.any():
            at = tuple(np.argwhere(wrong)[0])
            return f"compiled {given[at]:.9g} where NumPy gives {expected[at]:.9g}, at {theta}"
    return ""


def _tolerance(values: Values, theta: Array) -> Array:
    """How far rounding may move values, (..., 1): one number for each column of rows."""
    here = values(theta)
    tolerance = CLOSE * _largest(here)
    for k in np.flatnonzero(theta):
        moved = theta.copy()
        moved[k] *= 1 + MOVED
        tolerance = np.maximum(tolerance, ROUNDINGS * _largest(values(moved) - here))
    return tolerance


def _largest(values: Array) -> Array:
    """The largest finite one of each column of rows, (..., 1)."""
    finite = np.where(np.isfinite(values), values, 0.0)
    return np.asarray(np.abs(finite).max(axis=-1, keepdims=True))


def _losses(loss: FusedLoss) -> tuple[Values, Values]:
    """With the mean square of the model beside it: a loss may be the small rest of that."""
    model, X, y = loss.model, loss.X, loss.y

    def by_numpy(theta: Array) -> Array:
        predicted = model.predict(theta[None], *X)
        return np.append(mean_square(predicted - y), mean_square(predicted))

    return lambda theta: np.append(loss.losses(theta[None]), by_numpy(theta)[1]), by_numpy


def _residuals(loss: FusedLoss) -> tuple[Values, Values]:
    return loss.residuals, lambda theta: loss.model.predict(theta[None], *loss.X)[0] - loss.y


def _jacobian(loss: FusedLoss) -> tuple[Values, Values]:
    return lambda theta: loss.jacobian(theta).T, lambda theta: loss.model.jacobian(theta, *loss.X).T


def _rows(loss: FusedLoss) -> tuple[Values, Values]:
    model, order = loss.model, loss.order
    X, y = loss.X[:, order], loss.y[order]

    def compiled(theta: Array) -> Array:
        values = np.empty((len(theta) + 1, y.size))
        _all_rows(*loss.compiled_rows, theta.copy(), values[0], values[1:])
        return values

    def by_numpy(theta: Array) -> Array:
        return np.vstack([model.predict(theta[None], *X) - y, model.jacobian(theta, *X).T])

    return compiled, by_numpy


KINDS: dict[str, Callable[[FusedLoss], tuple[Values, Values]]] = {
    "losses": _losses,
    "residuals": _residuals,
    "jacobian": _jacobian,
    "rows": _rows,
}


@njit(cache=True, nogil=True)
def _all_rows(
    residuals: Any, slopes: Any, X: Array, y: Array, theta: Array, errors: Array, J: Array
) -> None:
    residuals(theta, X, y, 0, y.size, errors)
    slopes(theta, X, 0, y.size, J)
