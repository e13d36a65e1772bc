"""Annealed Gaussian mutation (Eq. 2)."""

from __future__ import annotations

import numpy as np

from miho.compiled import Climb
from miho.optim.oracle import Oracle
from miho.optim.space import Space
from miho.quantities import Array

ANNEALINGS = ("linear", "exponential")
CLIPS = ("box", "lower")


def annealed_sigma(space: Space, mutations: int, annealing: str = "linear") -> Array:
    """Sigma of each of the `mutations` steps of one evaluation, (mutations, d).

    In search coordinates. `linear` goes from sigma_max towards sigma_min, which the step after
    the last would have; `exponential` halves sigma every quarter of the steps and ignores
    sigma_min, as the authors' public code does.
    """
    sigma_max, sigma_min = space.sigma
    fraction = np.arange(mutations)[:, None] / max(1, mutations)
    if annealing == "linear":
        return np.asarray(sigma_max + (sigma_min - sigma_max) * fraction)
    return np.asarray(sigma_max * 0.5 ** (4 * fraction))


def mutate(P: Array, sigma: Array, space: Space, rng: np.random.Generator, clip: str) -> Array:
    """p + sigma * epsilon for every row of P (n, d), kept in the box or above its lower bounds.

    In search coordinates; epsilon is standard normal, sigma is (d,).
    """
    low, high = space.bounds
    mutated = rng.standard_normal(P.shape)
    mutated *= sigma
    mutated += P
    np.maximum(mutated, low, out=mutated)
    if clip == "box":
        np.minimum(mutated, high, out=mutated)
    return mutated


def climb_of(oracle: Oracle) -> Climb | None:
    """Compiled steps of mutation, for a problem that has them and a space without log scales.

    They move in units, which are the search coordinates there. None while a batch is cut off in the
    middle: it has to be evaluated to its end.
    """
    if oracle.kernel is None or oracle.meter.unfinished:
        return None
    if any(parameter.scale == "log" for parameter in oracle.space.parameters):
        return None
    return oracle.kernel.climb
