"""Losses that do not let outliers decide: Huber and Cauchy beside the squared error (Eq. 5)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from miho.quantities import Array
from miho.validate import positive


class Loss(ABC):
    """A loss as the mean square of transformed residuals, so that every method can minimise it.

    With rho the loss of one residual r, the transformed residual is sign(r) sqrt(rho(r)).
    """

    @abstractmethod
    def transform(self, residuals: Array) -> Array:
        """Transformed residuals, of any shape, in the residuals' unit; may reuse the argument."""

    @abstractmethod
    def influence(self, residuals: Array) -> tuple[Array, Array]:
        """psi = rho'(r) / 2 and its derivative (Huber, Robust Statistics, 1981)."""


@dataclass(frozen=True)
class Square(Loss):
    """rho = r^2, the paper's loss (Eq. 5): right for noise without outliers."""

    def transform(self, residuals: Array) -> Array:
        """The residuals themselves."""
        return residuals

    def influence(self, residuals: Array) -> tuple[Array, Array]:
        """psi = r."""
        return residuals, np.ones_like(residuals)


@dataclass(frozen=True)
class Huber(Loss):
    """rho = r^2 within `scale` and 2 scale |r| - scale^2 beyond: outliers pull with a fixed force.

    `scale` has the output's unit. 1.345 times the standard deviation of the noise keeps 95 % of
    the efficiency of least squares on normal noise.
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
        """psi = r, limited to +-scale."""
        inside = np.abs(residuals) <= self.scale
        return np.clip(residuals, -self.scale, self.scale), inside.astype(float)


@dataclass(frozen=True)
class Cauchy(Loss):
    """rho = scale^2 ln(1 + (r / scale)^2): far outliers hardly count, but minima may multiply.

    `scale` has the output's unit. 2.385 times the standard deviation of the noise keeps 95 % of
    the efficiency of least squares on normal noise.
    """

    scale: float

    def __post_init__(self) -> None:
        positive("scale", self.scale)

    def transform(self, residuals: Array) -> Array:
        """sign(r) sqrt(rho)."""
        z = residuals / self.scale
        return np.asarray(np.sign(z) * self.scale * np.sqrt(np.log1p(z * z)))

    def influence(self, residuals: Array) -> tuple[Array, Array]:
        """psi = r / (1 + (r / scale)^2)."""
        z = (residuals / self.scale) ** 2
        return residuals / (1 + z), (1 - z) / (1 + z) ** 2


def slope(loss: Loss, residuals: Array) -> Array:
    """Derivative of the transformed residual with respect to the residual, 1 at zero."""
    transformed = loss.transform(residuals)
    psi = loss.influence(residuals)[0]
    return np.divide(psi, transformed, out=np.ones_like(psi), where=transformed != 0)
