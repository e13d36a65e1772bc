"""The oracle in the form that wrapped libraries need: over the unit box, with scaled losses."""

from __future__ import annotations

import numpy as np

from miho.methods.loss_scale import LossScale
from miho.methods.unit_box import UnitBox
from miho.optim import Oracle
from miho.quantities import Array


class UnitOracle:
    """Losses (n,) of points (n, d) in [0, 1]^d, which scale linearly to search coordinates.

    `start` (n, d) are the first common initial configurations. The first batch must be these points
    and is evaluated exactly there, whatever rounding a library's scaling causes. Losses are scaled
    by `LossScale` to a `level` that suits the library's tolerances.
    """

    def __init__(self, oracle: Oracle, n: int, level: float = 1.0) -> None:
        space = oracle.space
        self._oracle = oracle
        self._box = UnitBox(space)
        self._scale = LossScale(level)
        self._first: Array | None = space.decode(space.initial(n))
        self.start = self._box.x(self._first)

    def __call__(self, x: Array, fidelity: float = 1.0) -> Array:
        """Scaled losses; `UNUSABLE` where the oracle returns +inf."""
        thetas = self._box.theta(x)
        if self._first is not None:
            thetas, self._first = self._first, None
        return self._scale(self._oracle(thetas, fidelity))

    def common(self, n: int) -> Array:
        """The first common initial configurations, (n, d), up to rounding."""
        space = self._oracle.space
        return self._box.x(space.decode(space.initial(n)))

    def fresh(self, n: int, rng: np.random.Generator) -> Array:
        """New draws from the initial distribution, (n, d)."""
        space = self._oracle.space
        return self._box.x(space.decode(space.sample(n, rng)))
