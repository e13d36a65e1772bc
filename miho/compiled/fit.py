"""Fast forms of a curve fit, used only if they agree with NumPy.

They may disagree because a function treats symbols and arrays differently, or because the stated
derivatives of a formula are wrong.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from miho.compiled.kernel import Climb, Formulas, Rows
from miho.compiled.taped import TapedLoss
from miho.core import Tape
from miho.quantities import Array

AGREED: WeakKeyDictionary[Tape, set[int]] = WeakKeyDictionary()
"""Row counts on which tapes of derivatives agreed with NumPy. A process compares each formula once,
so that many fits of one model share one comparison."""
COMPARED = 1000
"""Rows on which the machine is compared with NumPy."""
CLOSE = 1e-9
"""Largest difference, relative to the largest value: elementary functions differ by a few
roundings, which may be in large terms that cancel."""
MOVED, ROUNDINGS = 4 * float(np.finfo(float).eps), 100.0
"""If terms cancel more, the conditioning determines the rounding: values may differ by ROUNDINGS
times their change when a parameter changes by the share MOVED, its last bits."""


@dataclass(frozen=True, eq=False)
class FitKernel:
    """Fast forms of the mean square of a model minus data, see `kernel_for`.

    They are compared with NumPy at their first use, off the clock. If they differ, a warning is
    issued, and all of them are None.
    """

    taped: TapedLoss
    model: Formulas
    thetas: Array
    name: str

    def losses(self, thetas: Array, rows: int | None) -> Array | None:
        """Losses (n,) of parameter rows (n, d), over the first rows of the order."""
        return self.taped.losses(thetas, rows) if self._agrees else None

    def residuals(self, thetas: Array) -> Array | None:
        """Model minus data, (n, N), of parameter rows (n, d)."""
        return self.taped.residuals(thetas) if self._agrees else None

    def jacobian(self, theta: Array) -> Array | None:
        """Derivatives of the residuals, (N, d)."""
        return self.taped.jacobian(theta) if self._agrees else None

    @property
    def climb(self) -> Climb | None:
        """Mutation steps on the loss."""
        return self.taped.climb if self._agrees else None

    @property
    def rows(self) -> Rows | None:
        """Residuals and derivatives of some rows, in the order of the loss."""
        return self.taped.rows if self._agrees else None

    @cached_property
    def _agrees(self) -> bool:
        agreed = AGREED.setdefault(self.taped.slopes, set())
        rows = min(self.taped.y.size, COMPARED)
        if rows in agreed:
            return True
        reason = disagreement(self.taped, self.model, rows, self.thetas)
        if reason:
            warnings.warn(
                f"{self.name}: {reason}; NumPy is used, which is slower: write the function "
                "element by element with NumPy's functions of numbers, or derive from Model",
                UserWarning,
                stacklevel=4,
            )
            return False
        agreed.add(rows)
        return True


def disagreement(loss: TapedLoss, model: Formulas, rows: int, thetas: Array) -> str:
    """First difference between the machine and NumPy as text, "" if they agree.

    Residuals and derivatives of the first rows are compared at configurations (n, d), for finite
    values of NumPy.
    """
    X, y = (part[..., :rows] for part in loss.ordered)

    def by_machine(theta: Array) -> Array:
        return np.vstack([loss.residuals(theta[None], rows), loss.jacobian(theta, rows).T])

    def by_numpy(theta: Array) -> Array:
        return np.vstack([model.predict(theta[None], *X) - y, model.jacobian(theta, *X).T])

    with np.errstate(invalid="ignore", over="ignore"):  # of values that are not compared
        for theta in thetas:
            expected, values = by_numpy(theta), by_machine(theta)
            close = np.abs(values - expected) <= _tolerance(by_numpy, theta)
            wrong = np.isfinite(expected) & ~close
            if wrong.any():
                at = tuple(np.argwhere(wrong)[0])
                kind = f"derivative {at[0]}" if at[0] else "residual"
                return (
                    f"{kind} is {values[at]:.9g} on the machine, but {expected[at]:.9g} in NumPy, "
                    f"at {theta}"
                )
    return ""


def _tolerance(values: Callable[[Array], Array], theta: Array) -> Array:
    """Largest change of values by rounding, (..., 1): one number for each column of rows."""
    unmoved = values(theta)
    tolerance = CLOSE * _largest(unmoved)
    for k in np.flatnonzero(theta):
        moved = theta.copy()
        moved[k] *= 1 + MOVED
        tolerance = np.maximum(tolerance, ROUNDINGS * _largest(values(moved) - unmoved))
        # The derivative of a * (1 - exp(-t / b)) may cancel as far as it changes no residual.
        no_effect = CLOSE * _largest(unmoved[0]) / abs(theta[k])
        tolerance[k + 1] = np.maximum(tolerance[k + 1], no_effect)
    return tolerance


def _largest(values: Array) -> Array:
    """Largest finite value of each column of rows, (..., 1)."""
    finite = np.where(np.isfinite(values), values, 0.0)
    return np.asarray(np.abs(finite).max(axis=-1, keepdims=True))
