"""Quasi-random points of the unit cube."""

from __future__ import annotations

import numpy as np

from miho.quantities import Array


class Sobol:
    """A Sobol sequence in d dimensions, scrambled (Owen, 1998) by `rng`.

    Published methods use the unscrambled sequence, with which all repetitions would be the same
    run.
    """

    def __init__(self, d: int, rng: np.random.Generator) -> None:
        from scipy.stats import qmc  # slow to import

        self._engine = qmc.Sobol(d, rng=rng)

    def points(self, n: int) -> Array:
        """The next n points, (n, d)."""
        # SciPy warns if the size of the first batch is not a power of two.
        return np.concatenate((self._engine.random(min(n, 1)), self._engine.random(max(n - 1, 0))))
