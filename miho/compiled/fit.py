"""Fast forms of a curve fit, each used only where it gives what NumPy gives.

Why the machine might not: a function may do something else with symbols than with arrays. Why
compiled code might not: an expression that is not element by element gives another value for a
block than for the whole column; a function may have another form for compiled code; and numba's
cache on disk may hold code that was edited since.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from miho.compiled.addresses import write_residuals, write_slopes
from miho.compiled.kernel import Climb, Formulas, Rows, taped_loss
from miho.compiled.signature import signature_of
from miho.compiled.taped import TapedLoss
from miho.core import Tape
from miho.quantities import Array

if TYPE_CHECKING:
    from miho.compiled.compressed import CompressedLoss
    from miho.compiled.fused import FusedLoss

Values = Callable[[Array], Array]
"""(theta (d,)) -> losses, residuals or derivatives (..., rows) at one configuration."""

Agreed = set[tuple[str, int]]
"""Kinds of values, and rows on which they agreed with NumPy's."""
OF_TAPES: WeakKeyDictionary[Tape, Agreed] = WeakKeyDictionary()
OF_SIGNATURES: dict[str, Agreed] = {}
"""A process compares each formula once, so that many fits of a model pay for one comparison. The
keys are the tape of the derivatives, or the signature of the compiled functions."""
COMPARED = 1000
"""Rows on which compiled values are compared with NumPy's."""
CLOSE = 1e-9
"""Values may differ by this share of the largest: elementary functions differ by a few roundings,
and may be in large terms that cancel."""
MOVED, ROUNDINGS = 4 * float(np.finfo(float).eps), 100.0
"""Where terms cancel more than that, the conditioning says how far rounding goes: values may differ
by ROUNDINGS times what they change when a parameter changes by the share MOVED, its last bits."""


@dataclass(frozen=True, eq=False)
class FitKernel:
    """Fast forms of the mean square of a model minus data, see `kernel_for`.

    Each is compared with NumPy's at its first use, off the clock like its compilation; where it
    differs there is a warning, and None in its place.
    """

    model: Formulas
    X: Array
    y: Array
    order: NDArray[np.intp]
    thetas: Array
    name: str
    threads: int = 1
    compressed: bool = False
    climbs: bool = True

    @cached_property
    def taped(self) -> TapedLoss | None:
        """All but mutation steps by the machine, None where numba compiles the formulas."""
        return taped_loss(self.model, self.X, self.y, self.order, threads=self.threads)

    @cached_property
    def few_nodes(self) -> CompressedLoss | None:
        """The compressed loss, if it is switched on and the model allows it."""
        if not self.compressed or len(self.X) != 1 or self.model.bound is None:
            return None
        from miho.compiled.compressed import CompressedLoss

        return CompressedLoss(self.model, self.X[0], self.y, threads=self.threads)

    def losses(self, thetas: Array, rows: int) -> Array | None:
        """Losses (n,) of parameter rows (n, d), over the first rows of the order."""
        if self.few_nodes is not None and rows == self.y.size:
            return self.few_nodes.losses(thetas)
        return (self.taped or self._fused).losses(thetas, rows) if self._agrees("losses") else None

    def residuals(self, thetas: Array) -> Array | None:
        """Model minus data, (n, N), of parameter rows (n, d)."""
        if not self._agrees("residuals"):
            return None
        if self.taped is not None:
            return self.taped.residuals(thetas)
        return np.stack([self._fused.residuals(theta) for theta in thetas])

    def jacobian(self, theta: Array) -> Array | None:
        """Derivatives of the residuals, (N, d)."""
        return (self.taped or self._fused).jacobian(theta) if self._agrees("jacobian") else None

    @property
    def climb(self) -> Climb | None:
        """Mutation steps on the loss."""
        taped = self.taped
        return taped.climb if taped is not None and self._agrees("losses") else None

    @property
    def rows(self) -> Rows | None:
        """Residuals and derivatives of some rows, in the order of the loss."""
        return (self.taped or self._fused).rows if self._agrees("rows") else None

    @cached_property
    def _fused(self) -> FusedLoss:
        return self._fused_on(self.X, self.y, self.order)

    def _fused_on(self, X: Array, y: Array, order: NDArray[np.intp]) -> FusedLoss:
        from miho.compiled.fused import FusedLoss

        return FusedLoss(self.model, X, y, order, self.threads)

    def _agrees(self, kind: str) -> bool:
        if self.taped is not None:
            kind = "rows"  # all others come from the same tapes
        key = kind, min(self.y.size, COMPARED)
        if key in self._agreed:
            return True
        if kind not in self._disagreements:
            rows = self.order[:COMPARED]
            first = self.X[:, rows], self.y[rows], np.arange(rows.size)
            part = taped_loss(self.model, *first) or self._fused_on(*first)
            self._disagreements[kind] = reason = disagreement(part, self.model, kind, self.thetas)
            if reason:
                warnings.warn(
                    f"{self.name}: {kind}: {reason}; NumPy's are used, which are "
                    "slower: write it element by element with NumPy's functions of numbers, or "
                    "derive from Model",
                    UserWarning,
                    stacklevel=4,
                )
            else:
                self._agreed.add(key)
        return not self._disagreements[kind]

    @cached_property
    def _agreed(self) -> Agreed:
        if self.taped is not None:
            return OF_TAPES.setdefault(self.taped.slopes, set())
        signature = signature_of(self.model.value, self.model.derivatives)
        return OF_SIGNATURES.setdefault(signature, set())

    @cached_property
    def _disagreements(self) -> dict[str, str]:
        """Where compiled values of each kind compared so far are not NumPy's, "" where they are."""
        return {}


def disagreement(loss: TapedLoss | FusedLoss, model: Formulas, kind: str, thetas: Array) -> str:
    """Where fast values of a kind (see KINDS) are not NumPy's, or why there are none; else "".

    Compared at configurations (n, d), wherever NumPy's values are finite.
    """
    fast, by_numpy = KINDS[kind](loss, model)
    with np.errstate(invalid="ignore", over="ignore"):  # of values that are not compared
        for theta in thetas:
            expected = by_numpy(theta)
            try:
                values = fast(theta)
            except _numba_error() as error:
                return f"cannot be compiled: {_cause(error)}"
            close = np.abs(values - expected) <= _tolerance(by_numpy, theta)
            wrong = np.isfinite(expected) & ~close
            if wrong.any():
                at = tuple(np.argwhere(wrong)[0])
                return f"compiled {values[at]:.9g} where NumPy gives {expected[at]:.9g}, at {theta}"
    return ""


def _numba_error() -> type[Exception]:
    """What numba raises; asked for only where something was raised."""
    from numba.core.errors import NumbaError

    return cast(type[Exception], NumbaError)


def _cause(error: Any) -> str:
    from miho.compiled.arrays import cause

    return cause(error)


def _tolerance(values: Values, theta: Array) -> Array:
    """How far rounding may move values, (..., 1): one number for each column of rows."""
    unmoved = values(theta)
    tolerance = CLOSE * _largest(unmoved)
    for k in np.flatnonzero(theta):
        moved = theta.copy()
        moved[k] *= 1 + MOVED
        tolerance = np.maximum(tolerance, ROUNDINGS * _largest(values(moved) - unmoved))
    return tolerance


def _largest(values: Array) -> Array:
    """The largest finite one of each column of rows, (..., 1)."""
    finite = np.where(np.isfinite(values), values, 0.0)
    return np.asarray(np.abs(finite).max(axis=-1, keepdims=True))


def _mean_square(values: Array) -> Array:
    return np.asarray(np.mean(values**2, axis=-1))


def _losses(loss: TapedLoss | FusedLoss, model: Formulas) -> tuple[Values, Values]:
    """Losses, with the mean square of the model for scale: a much smaller loss may be rounding."""

    def by_numpy(theta: Array) -> Array:
        predicted = model.predict(theta[None], *loss.X)
        return np.append(_mean_square(predicted - loss.y), _mean_square(predicted))

    return lambda theta: np.append(loss.losses(theta[None]), by_numpy(theta)[1]), by_numpy


def _residuals(loss: TapedLoss | FusedLoss, model: Formulas) -> tuple[Values, Values]:
    """Residuals, fast and by NumPy."""
    return loss.residuals, lambda theta: model.predict(theta[None], *loss.X)[0] - loss.y


def _jacobian(loss: TapedLoss | FusedLoss, model: Formulas) -> tuple[Values, Values]:
    """Derivatives of the residuals, fast and by NumPy, (d, N)."""
    return lambda theta: loss.jacobian(theta).T, lambda theta: model.jacobian(theta, *loss.X).T


def _rows(loss: TapedLoss | FusedLoss, model: Formulas) -> tuple[Values, Values]:
    """Residuals and their derivatives row by row, fast and by NumPy, (d + 1, N)."""
    X, y = loss.X[:, loss.order], loss.y[loss.order]

    def fast(theta: Array) -> Array:
        values = np.empty((len(theta) + 1, y.size))
        rows = loss.rows
        write_residuals(rows.calls, theta, rows.X, rows.y, 0, y.size, values[0])
        write_slopes(rows.calls, theta, rows.X, 0, y.size, values[1:])
        return values

    def by_numpy(theta: Array) -> Array:
        return np.vstack([model.predict(theta[None], *X) - y, model.jacobian(theta, *X).T])

    return fast, by_numpy


KINDS: dict[str, Callable[[TapedLoss | FusedLoss, Formulas], tuple[Values, Values]]] = {
    "losses": _losses,
    "residuals": _residuals,
    "jacobian": _jacobian,
    "rows": _rows,
}
