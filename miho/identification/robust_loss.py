"""Robust losses, which limit the influence of outliers: Huber and Cauchy."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from miho.identification.residuals import Loss
from miho.quantities import Array
from miho.validate import positive

REMEMBERED = 1 << 20
"""Numbers of errors that a thread remembers, for derivatives at the same configurations."""


@dataclass(frozen=True)
class Huber(Loss):
    """The Huber loss: rho = r^2 up to `scale`, and 2 scale |r| - scale^2 beyond.

    The influence of an outlier is constant.

    Parameters
    ----------
    scale : float
        Largest residual with the squared loss, in the unit of the output. A scale of 1.345 standard
        deviations of normal noise keeps 95 % of the efficiency of least squares.

    Examples
    --------
    >>> import numpy as np
    >>> from miho.identification import Huber
    >>> Huber(1.0).transform(np.array([0.5, 13.0]))
    array([0.5, 5. ])
    """

    scale: float

    def __post_init__(self) -> None:
        positive("scale", self.scale)

    def transform(self, residuals: Array) -> Array:
        """sign(r) sqrt(rho)."""
        size = np.abs(residuals)
        outer = np.sqrt(np.maximum(2 * self.scale * size - self.scale**2, 0.0))
        return np.where(size <= self.scale, residuals, np.sign(residuals) * outer)

    def influence(self, residuals: Array) -> tuple[Array, Array]:
        """The influence psi = r, limited to +-scale, and its derivative."""
        inside = np.abs(residuals) <= self.scale
        return np.clip(residuals, -self.scale, self.scale), inside.astype(float)


@dataclass(frozen=True)
class Cauchy(Loss):
    """The Cauchy loss: rho = scale^2 ln(1 + (r / scale)^2).

    The influence of an outlier vanishes with its distance, but a problem may have more local
    minima than with other losses.

    Parameters
    ----------
    scale : float
        Residual with the largest influence, in the unit of the output. A scale of 2.385 standard
        deviations of normal noise keeps 95 % of the efficiency of least squares.
    """

    scale: float

    def __post_init__(self) -> None:
        positive("scale", self.scale)

    def transform(self, residuals: Array) -> Array:
        """sign(r) sqrt(rho)."""
        z = residuals / self.scale
        square = z * z
        outer = np.sign(z) * self.scale * np.sqrt(np.log1p(square))
        return np.where(square > 0, outer, residuals)  # a residual of 0 has the derivative 1

    def influence(self, residuals: Array) -> tuple[Array, Array]:
        """The influence psi = r / (1 + (r / scale)^2) and its derivative."""
        z = (residuals / self.scale) ** 2
        return residuals / (1 + z), (1 - z) / (1 + z) ** 2


def slope(loss: Loss, residuals: Array) -> Array:
    """Derivative of the transformed residual with respect to the residual, 1 at zero."""
    transformed = loss.transform(residuals)
    psi = loss.influence(residuals)[0]
    return np.divide(psi, transformed, out=np.ones_like(psi), where=transformed != 0)


class LatestErrors(threading.local):
    """The latest errors of a thread by configuration (d,), from which derivatives follow."""

    def __init__(self) -> None:
        self._errors: dict[tuple[bytes, int], Array] = {}

    def keep(self, thetas: Array, errors: Array) -> None:
        """Remember errors (n, m) at configurations (n, d), in place of the oldest ones."""
        for theta, row in zip(thetas, errors, strict=True):
            if not np.isfinite(row).all():  # no derivatives, or still at a worker
                continue
            while len(self._errors) >= max(1, REMEMBERED // row.size):
                del self._errors[next(iter(self._errors))]
            self._errors[theta.tobytes(), row.size] = row.copy()

    def at(self, theta: Array, rows: int) -> Array | None:
        """The errors (rows,) at a configuration (d,), None if they are not known."""
        return self._errors.get((theta.tobytes(), rows))
