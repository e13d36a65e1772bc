"""Losses for a wrapped library: without a unit, and finite for every point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.quantities import Array

UNUSABLE = 1e100
"""The loss of a point without a finite loss; its square and its slope over a step of 1e-8 are
finite."""


@dataclass
class LossScale:
    """Scale all losses of a run so that the first finite nonzero loss is `level`.

    Libraries have absolute tolerances and temperatures in the unit of the loss. With this scale
    their behaviour does not depend on that unit. The first loss is usually the loss of the first
    common configuration, so all methods have the same scale for a problem and a seed.
    """

    level: float
    factor: float | None = None

    def __call__(self, losses: Array) -> Array:
        """Losses (n,); `UNUSABLE` where they are +inf or too large."""
        if self.factor is None:
            sizes = np.abs(losses[np.isfinite(losses) & (losses != 0)])
            if sizes.size:
                self.factor = self.level / max(float(sizes[0]), 1 / UNUSABLE)
        with np.errstate(over="ignore"):
            return np.minimum(losses * (self.factor or 1.0), UNUSABLE)
