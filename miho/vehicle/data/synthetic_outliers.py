"""A synthetic tire test with a bad logger: heavy-tailed noise and dropped rows."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from miho.data.dataset import Dataset
from miho.quantities import Array
from miho.validate import at_least, positive, whole
from miho.vehicle.models.tire import Pacejka

TRUTH = MappingProxyType({"B": 18.0, "C": 1.5, "D": 4500.0, "Sx": 0.004, "Sy": 150.0})
"""The tire under test (Eq. 4 in ISO-W)."""


def tire_outlier_test(
    n: int = 1000, seed: int = 0, scale: float = 150.0, freedom: float = 2.5, dropped: float = 0.05
) -> Dataset:
    """Samples of the lateral force at slip angles uniform within 0.22 rad, with outliers.

    Heavy-tailed noise and dropped rows both distort least squares.

    Parameters
    ----------
    n : int
        Number of samples.
    seed : int
        Seed of the samples and the noise.
    scale, freedom : float
        The noise has Student's t distribution with `freedom` degrees of freedom, times `scale` [N]:
        nearly normal in the middle, with rare rows many times `scale` away.
    dropped : float
        Share of random rows that read exactly 0 N.

    Returns
    -------
    Dataset
        Columns alpha [rad] and the output Fy [N], ISO-W.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """
    whole("seed", seed, 0)
    whole("n", n, 1)
    at_least("scale", scale, 0)
    positive("freedom", freedom)
    if not 0 <= dropped < 1:
        raise ValueError(f"dropped is {dropped}; expected a share from 0 to below 1")
    rng = np.random.default_rng([seed, *b"outliers"])
    alpha: Array = rng.uniform(-0.22, 0.22, n)
    Fy = Pacejka().predict(np.array([list(TRUTH.values())]), alpha)[0]
    Fy += scale * rng.standard_t(freedom, n)
    Fy[rng.random(n) < dropped] = 0.0
    return Dataset("outliers", {"alpha": alpha, "Fy": Fy}, {"alpha": "rad", "Fy": "N"}, "Fy")
