"""Quasi-random points of the unit cube."""

from __future__ import annotations

import numpy as np

from miho.quantities import Array


class Sobol:
    """A Sobol sequence in d dimensions, scrambled (Owen, 1998) by `rng`.

    Published methods take the sequence as it is; their repetitions would all be one run.
    """

    def __init__(self, d: int, rng: np.random.Generator) -> None:
        from scipy.stats import qmc  # takes as long to import as all other methods together

        self._engine = qmc.Sobol(d, rng=rng)

    def points(self, n: int) -> Array:
        """The next n points, (n, d)."""
        # SciPy warns of a first batch that is no power of two.
        return np.concatenate((self._engine.random(min(n, 1)), self._engine.random(max(n - 1, 0))))
