"""Particle swarm optimisation, global best, synchronous."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.optim import AskTell, Space
from miho.optim.space import LARGEST_BATCH
from miho.quantities import Array
from miho.validate import at_least, positive, whole


@dataclass
class PSOState:
    """Positions, velocities and the particles' own best positions (n, d), in search coordinates."""

    space: Space
    rng: np.random.Generator
    positions: Array
    velocities: Array
    best: Array
    best_losses: Array
    iteration: int = 0


@dataclass(frozen=True)
class PSO(AskTell[PSOState]):
    """v <- w v + c1 r1 (own best - x) + c2 r2 (swarm's best - x);  x <- x + v.

    c1 = c2 = 2 are the defaults of the paper's reference [5]; the inertia w, which the paper
    does not give, falls linearly over `iterations` and then stays (Shi and Eberhart, 1999:
    0.9 to 0.4). Velocities are limited to `velocity_limit` of the range per step, and a particle
    that meets a bound stops there. Particles start at rest at the first common configurations.
    Runs until the budget ends.

    A constant inertia chi with c1 = c2 = chi phi / 2 is the swarm with constriction coefficient
    chi = 2 / |2 - phi - sqrt(phi^2 - 4 phi)| (Clerc and Kennedy, 2002), whose particles converge
    for phi > 4.
    """

    particles: int = 100
    c1: float = 2.0
    c2: float = 2.0
    inertia_start: float = 0.9
    inertia_end: float = 0.4
    iterations: int = 1000
    velocity_limit: float = 0.5

    def __post_init__(self) -> None:
        whole("particles", self.particles, 1, LARGEST_BATCH)
        whole("iterations", self.iterations, 1)
        for field in ("c1", "c2", "inertia_start", "inertia_end"):
            at_least(field, getattr(self, field), 0)
        positive("velocity_limit", self.velocity_limit)

    def init(self, space: Space, rng: np.random.Generator) -> PSOState:
        """Particles at the common initial configurations, at rest."""
        positions = space.initial(self.particles)
        return PSOState(
            space=space,
            rng=rng,
            positions=positions,
            velocities=np.zeros_like(positions),
            best=positions.copy(),
            best_losses=np.full(self.particles, np.inf),
        )

    def ask(self, state: PSOState) -> Array:
        """The particles' positions."""
        return state.space.decode(state.positions)

    def tell(self, state: PSOState, thetas: Array, losses: Array) -> None:
        """Update the bests, then move every particle."""
        better = losses < state.best_losses
        state.best[better] = state.positions[better]
        state.best_losses[better] = losses[better]
        leader = state.best[np.argmin(state.best_losses)]

        x, rng = state.positions, state.rng
        low, high = state.space.bounds
        v = self._inertia(state.iteration) * state.velocities
        v += self.c1 * rng.random(x.shape) * (state.best - x)
        v += self.c2 * rng.random(x.shape) * (leader - x)
        limit = self.velocity_limit * (high - low)
        v = np.minimum(np.maximum(v, -limit), limit)
        unbounded = x + v
        state.positions = np.minimum(np.maximum(unbounded, low), high)
        state.velocities = np.where(unbounded == state.positions, v, 0.0)
        state.iteration += 1

    def done(self, state: PSOState) -> bool:
        """False: only the budget ends it."""
        return False

    def _inertia(self, iteration: int) -> float:
        fraction = min(1.0, iteration / self.iterations)
        return self.inertia_start + (self.inertia_end - self.inertia_start) * fraction
