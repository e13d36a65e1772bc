"""Losses as a wrapped library sees them: in no unit, and a number for every point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.quantities import Array

UNUSABLE = 1e100
"""The loss of a point that has none: its square and its slope over a step of 1e-8 are finite."""


@dataclass
class LossScale:
    """Scales all losses of a run alike, so that the first one that is finite and not 0 is `level`.

    Libraries have tolerances and temperatures that are absolute, in the unit of the loss; with this
    they do the same whatever that unit is. The first loss is mostly that of the first common
    configuration: within a problem and a seed all methods have the same measure.
    """

    level: float
    factor: float | None = None

    def __call__(self, losses: Array) -> Array:
        """Losses (n,), `UNUSABLE` where they are +inf or too large."""
        if self.factor is None:
            sizes = np.abs(losses[np.isfinite(losses) & (losses != 0)])
            if sizes.size:
                self.factor = self.level / max(float(sizes[0]), 1 / UNUSABLE)
        with np.errstate(over="ignore"):
            return np.minimum(losses * (self.factor or 1.0), UNUSABLE)
