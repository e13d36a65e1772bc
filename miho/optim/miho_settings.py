"""Settings that Alg. 1 leaves open, and the draws and mutations that follow from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.optim.mutation import ANNEALINGS, CLIPS, annealed_sigma, limits, mutate
from miho.optim.schedule import ROUNDINGS, Rung, hyperband_table
from miho.optim.space import LARGEST_BATCH, SAMPLINGS, Space
from miho.quantities import Array
from miho.validate import one_of, whole

PROPOSALS = ("mutation", "fresh")


@dataclass(frozen=True)
class MIHOSettings:
    """Settings of `MIHO` and `AsynchronousMIHO`; see `MIHO`."""

    R: int = 10_000
    eta: int = 5
    rounding: str = "ceil"
    sampling: str = "normal"
    annealing: str = "linear"
    clip: str = "box"
    proposal: str = "mutation"

    def __post_init__(self) -> None:
        whole("R", self.R, 1)
        whole("eta", self.eta, 2)
        one_of("rounding", self.rounding, ROUNDINGS)
        one_of("sampling", self.sampling, SAMPLINGS)
        one_of("annealing", self.annealing, ANNEALINGS)
        one_of("clip", self.clip, CLIPS)
        one_of("proposal", self.proposal, PROPOSALS)
        first = self.table()[0].n
        if first > LARGEST_BATCH:
            raise ValueError(
                f"R is {self.R} and eta is {self.eta}: the first bracket has {first:,} "
                f"configurations; expected at most {LARGEST_BATCH:,}"
            )

    def table(self) -> tuple[Rung, ...]:
        """All rungs of all brackets, in the order of Alg. 1."""
        return hyperband_table(self.R, self.eta, self.rounding)

    def initial(self, space: Space, n: int) -> Array:
        """First common initial configurations (n, d), in search coordinates."""
        return self._clipped(space.initial(n, self.sampling), space)

    def fresh(self, space: Space, n: int, rng: np.random.Generator) -> Array:
        """Draw configurations (n, d), in search coordinates."""
        return self._clipped(space.sample(n, rng, self.sampling), space)

    def sigma(self, space: Space, mutations: int) -> Array:
        """Sigma of each mutation on a rung, (mutations, d)."""
        return annealed_sigma(space, mutations, self.annealing)

    def proposals(self, P: Array, sigma: Array, space: Space, rng: np.random.Generator) -> Array:
        """Next competitors of configurations P (n, d), in search coordinates."""
        if self.proposal == "mutation":
            return mutate(P, sigma, space, rng, self.clip)
        return self.fresh(space, len(P), rng)

    def _clipped(self, P: Array, space: Space) -> Array:
        """P (n, d) within the limits of `clip`, in search coordinates."""
        low, high = limits(space, self.clip)
        return np.asarray(np.minimum(np.maximum(P, low), high))
