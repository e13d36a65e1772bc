"""The oracle as wrapped libraries want it: over the unit box, with a number for every point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baselines.unit_box import UnitBox
from miho.optim import Oracle

Array = NDArray[np.float64]

UNUSABLE = 1e100
"""The loss of a point that has none: its square and its slope over a step of 1e-8 are finite."""


class UnitOracle:
    """Losses (n,) of points (n, d) in [0, 1]^d, which scale linearly to search coordinates.

    `start` (n, d) are the first common initial configurations. The first batch must be they, and is
    evaluated exactly there, whatever a library's own scaling has rounded away.
    """

    def __init__(self, oracle: Oracle, n: int) -> None:
        space = oracle.space
        self._oracle = oracle
        self._box = UnitBox(space)
        self._first: Array | None = space.decode(space.initial(n))
        self.start = self._box.x(self._first)

    def __call__(self, x: Array, fidelity: float = 1.0) -> Array:
        """Losses, `UNUSABLE` where the oracle has +inf."""
        thetas = self._box.theta(x)
        if self._first is not None:
            thetas, self._first = self._first, None
        return np.minimum(self._oracle(thetas, fidelity), UNUSABLE)

    def common(self, n: int) -> Array:
        """The first common initial configurations, (n, d), up to rounding."""
        space = self._oracle.space
        return self._box.x(space.decode(space.initial(n)))

    def fresh(self, n: int, rng: np.random.Generator) -> Array:
        """New draws from the initial distribution, (n, d)."""
        space = self._oracle.space
        return self._box.x(space.decode(space.sample(n, rng)))
