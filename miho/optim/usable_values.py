"""Values of a problem in a form that methods can use; non-finite values are rejected."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

import numpy as np

from miho.optim.meter import UnusableValueError
from miho.optim.problem import Problem, least_squares, mean_square
from miho.quantities import Array

NOT_FINITE = "loss is"
"""Beginning of the reason for rejecting a value that was computed, but is not finite."""


class UsableValues:
    """Losses, residuals and derivatives of a problem, as arrays of real numbers.

    An unusable loss becomes +inf, also if the problem raises anything but MemoryError. `reject`
    gets the reason and the count.
    """

    def __init__(self, problem: Problem, reject: Callable[..., None]) -> None:
        self._problem, self._reject = problem, reject

    def losses(self, rows: Array, fidelity: float = 1.0) -> Array:
        """Losses (n,) of rows (n, d)."""
        try:
            losses = np.asarray(self._problem.loss(read_only(rows), fidelity))
            if losses.shape == (len(rows),) and losses.dtype.kind in "fiu":
                return self._finite(losses.astype(float))
            reason = f"not one real number per row: {losses.dtype} of shape {losses.shape}"
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 -- whatever else a model raises is a rejected value
            reason = f"{type(error).__name__}: {error}"
        if len(rows) == 1:
            self._reject(reason, at=self._as_text(rows[0]))
            return np.array([math.inf])
        return np.concatenate([self.losses(row[None], fidelity) for row in rows])

    def residuals(self, theta: Array, *part: float) -> tuple[Array, Array]:
        """Residuals (m,) of one configuration (d,), which need not be finite, and its loss (1,).

        Raises UnusableValueError if the problem raises.
        """
        problem = least_squares(self._problem)
        try:
            residuals = _real(problem.residuals(read_only(theta), *part))
            return residuals, self._finite(mean_square(residuals)[None])
        except Exception as error:
            self._reject(f"{type(error).__name__}: {error}", at=self._as_text(theta))
            raise UnusableValueError(str(error)) from error

    def residual_rows(self, rows: Array, *part: float) -> tuple[Array, Array]:
        """Residuals (n, m) of rows (n, d), NaN if the problem raises, and losses (n,)."""
        problem = least_squares(self._problem)
        try:
            residuals = _real(problem.residual_rows(read_only(rows), *part))
            return residuals, self._finite(mean_square(residuals))
        except Exception:  # noqa: BLE001 -- whatever a model raises, or no residual_rows
            return self._one_by_one(rows, *part)

    def jacobian(self, theta: Array, *part: float) -> Array:
        """Derivatives of the residuals (m, d) at one configuration (d,).

        Raises UnusableValueError if the problem raises, or if a derivative is not finite.
        """
        problem = least_squares(self._problem)
        try:
            jacobian = _real(problem.jacobian(read_only(theta), *part))
            if np.isfinite(jacobian).all():
                return jacobian
            reason, at = "derivative is not finite", ""
        except Exception as error:  # noqa: BLE001 -- as for residuals
            reason, at = f"{type(error).__name__}: {error}", self._as_text(theta)
        self._reject(reason, at=at)
        raise UnusableValueError(reason)

    def _one_by_one(self, rows: Array, *part: float) -> tuple[Array, Array]:
        """The same as `residual_rows`, by a separate call for each row."""
        computed: dict[int, Array] = {}
        losses = np.full(len(rows), math.inf)
        for k, theta in enumerate(rows):
            try:
                residuals, losses[k : k + 1] = self.residuals(theta, *part)
                computed[k] = residuals.copy()
            except UnusableValueError:
                continue
        m = max((values.size for values in computed.values()), default=1)
        residuals = np.full((len(rows), m), math.nan)
        for k, values in computed.items():
            residuals[k] = values
        return residuals, losses

    def _as_text(self, theta: Array) -> str:
        """A configuration (d,) as text."""
        values = zip(self._problem.space.names, theta.tolist(), strict=True)
        return ", ".join(f"{name} = {value:.6g}" for name, value in values)

    def _finite(self, losses: Array) -> Array:
        """Losses with +inf in place of every value that is not finite."""
        finite = np.isfinite(losses)
        if np.logical_and.reduce(finite):  # a third of the time of finite.all()
            return losses
        for value, count in Counter(losses[~finite].tolist()).items():
            self._reject(f"{NOT_FINITE} {value}", count)
        return np.where(finite, losses, math.inf)


def read_only(array: Array) -> Array:
    """Read-only view for a problem; the method continues with the array itself."""
    view = array.view()
    view.flags.writeable = False
    return view


def _real(values: Array) -> Array:
    """The values as an array; raises TypeError unless they are real numbers."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"not real numbers: {array.dtype} of shape {array.shape}")
    return array
