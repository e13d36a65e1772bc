"""Loss functions, and the squared error (Eq. 5)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from miho.quantities import Array


class Loss(ABC):
    """A loss function rho, as the square of transformed residuals sign(r) sqrt(rho(r)).

    Every method for least squares can minimise the mean square of transformed residuals.
    """

    @abstractmethod
    def transform(self, residuals: Array) -> Array:
        """Residuals of any shape as sign(r) sqrt(rho(r)), in the same unit; may reuse the array."""

    @abstractmethod
    def influence(self, residuals: Array) -> tuple[Array, Array]:
        """The influence psi = rho'(r) / 2 and its derivative (Huber, Robust Statistics, 1981)."""


@dataclass(frozen=True)
class Square(Loss):
    """The squared error rho = r^2, the loss of the paper (Eq. 5), for noise without outliers."""

    def transform(self, residuals: Array) -> Array:
        """The residuals themselves."""
        return residuals

    def influence(self, residuals: Array) -> tuple[Array, Array]:
        """The influence psi = r and its derivative 1."""
        return residuals, np.ones_like(residuals)
