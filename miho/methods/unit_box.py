"""The box of a search scaled to the unit cube, for solvers that need variables of similar size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.optim import Space
from miho.quantities import Array


@dataclass(frozen=True)
class UnitBox:
    """x in [0, 1]^d for theta in the space's box, linear in the search coordinates."""

    space: Space

    def theta(self, x: Array) -> Array:
        """Parameters in their units (..., d), inside the box despite rounding."""
        low, high = self.space.bounds
        return self.space.clip(self.space.decode(low + (high - low) * x))

    def x(self, theta: Array) -> Array:
        """Position in the unit cube, (..., d)."""
        low, high = self.space.bounds
        return np.clip((self.space.encode(theta) - low) / (high - low), 0.0, 1.0)

    def slope(self, theta: Array) -> Array:
        """d theta / d x, (d,), at parameters theta (d,)."""
        low, high = self.space.bounds
        log = np.array([parameter.scale == "log" for parameter in self.space.parameters])
        return np.where(log, theta, 1.0) * (high - low)
