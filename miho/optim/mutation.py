"""Annealed Gaussian mutation (Eq. 2)."""

from __future__ import annotations

import numpy as np

from miho.compiled import Block, Climb, Steps
from miho.optim.oracle import Oracle
from miho.optim.space import Space
from miho.quantities import Array

ANNEALINGS = ("linear", "exponential")
CLIPS = ("box", "lower", "none")


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
    """p + sigma * epsilon for every row of P (n, d), kept within `limits` of `clip`.

    In search coordinates; epsilon is standard normal, sigma is (d,).
    """
    low, high = limits(space, clip)
    mutated = rng.standard_normal(P.shape)
    mutated *= sigma
    mutated += P
    np.maximum(mutated, low, out=mutated)
    np.minimum(mutated, high, out=mutated)
    return mutated


def limits(space: Space, clip: str) -> tuple[Array, Array]:
    """The lowest and highest search coordinates (d,) that `clip` leaves: of a box, or infinite."""
    low, high = space.bounds
    if clip == "none":
        low = np.full(low.shape, -np.inf)
    return low, high if clip == "box" else np.full(high.shape, np.inf)


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


def compiled_steps(
    climb: Climb,
    rows: tuple[Array, Array, Array],
    sigma: Array,
    bounds: tuple[Array, Array],
    rng: np.random.Generator,
    ends: tuple[float, float],
    *,
    early_stopping: bool = True,
) -> Block:
    """Steps of mutation whose noise `rng` draws as `mutate` would, one step after the other.

    Parameters
    ----------
    climb : Climb
        Compiled steps of the problem.
    rows : tuple of ndarray
        Mutants of the first step (n, d), their parents (n, d) and losses of these (n,), which are
        changed in place.
    sigma : ndarray of shape (steps - 1, d)
        Standard deviations of each step after the first (Eq. 2).
    bounds : tuple of ndarray
        Lower and upper ends (d,) within which mutants are kept.
    rng : numpy.random.Generator
        Is left as if each step that was made had drawn its own noise.
    ends : tuple of float
        The best loss so far, and the target at which the steps end.
    early_stopping : bool
        Whether a mutant that cannot be better than its parent is given up (`Steps`).

    Returns
    -------
    Block
        The evaluations and the improvements.
    """
    mutants, P, L = rows
    generator, shape = rng.bit_generator.state, (len(sigma), *P.shape)
    noise = rng.standard_normal(shape)
    block = climb(Steps(mutants, P, L, noise, sigma, bounds, early_stopping), *ends)
    more = round(block.evaluations) // len(P) - 1
    if more < len(sigma):  # the target was reached: draw again only what these steps used
        rng.bit_generator.state = generator
        rng.standard_normal((more, *shape[1:]))
    return block
