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
    """Sigma of each of the `mutations` steps of one evaluation, (mutations, d), by Eq. 2.

    In search coordinates. "linear" decreases from sigma_max towards sigma_min, which the step after
    the last would reach. "exponential" halves sigma every quarter of the steps and ignores
    sigma_min, as the authors' public code does.
    """
    sigma_max, sigma_min = space.sigma
    fraction = np.arange(mutations)[:, None] / max(1, mutations)
    if annealing == "linear":
        return np.asarray(sigma_max + (sigma_min - sigma_max) * fraction)
    return np.asarray(sigma_max * 0.5 ** (4 * fraction))


def mutate(P: Array, sigma: Array, space: Space, rng: np.random.Generator, clip: str) -> Array:
    """Mutate every row p of P (n, d) to p + sigma * epsilon (Eq. 2), within the limits of `clip`.

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
    """Lower and upper limits of search coordinates (d,) under `clip`, some of them infinite."""
    low, high = space.bounds
    if clip == "none":
        low = np.full(low.shape, -np.inf)
    return low, high if clip == "box" else np.full(high.shape, np.inf)


def climb_of(oracle: Oracle) -> Climb | None:
    """Compiled mutation steps of the problem; None without them, or with a log scale.

    They work in units, which equal search coordinates without log scales. Also None after an
    interrupted batch, which has to be completed first.
    """
    if oracle.traits.kernel is None or oracle.meter.unfinished:
        return None
    if any(parameter.scale == "log" for parameter in oracle.space.parameters):
        return None
    return oracle.traits.kernel.climb


def compiled_steps(
    climb: Climb, steps: Steps, rng: np.random.Generator, best: float, target: float
) -> Block:
    """Make mutation steps with the noise that `mutate` would draw from `rng`, step by step.

    `steps` comes without noise; its mutants, parents and losses change in place. `rng` is left in
    the state that separate draws of each step would leave. The steps end at the `target` loss.
    """
    n, generator = len(steps.P), rng.bit_generator.state
    noise = rng.standard_normal((len(steps.sigma), *steps.P.shape))
    block = climb(steps._replace(noise=noise), best, target)
    more = round(block.evaluations) // n - 1
    if more < len(noise):  # the target was reached: draw only the noise of these steps again
        rng.bit_generator.state = generator
        rng.standard_normal((more, *steps.P.shape))
    return block
