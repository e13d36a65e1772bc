"""Particle swarm optimisation, global best, synchronous."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from miho.optim import AskTell, Space
from miho.optim.space import LARGEST_BATCH, SAMPLINGS
from miho.quantities import Array
from miho.validate import one_of, positive, settings_at_least, whole

BOUNDS = ("clip", "none")
FAR = 1e12
"""Distance from the box, in ranges, from which a particle never returns: its steps are as long."""


@dataclass
class PSOState:
    """Positions, velocities and the particles' best positions (n, d), in search coordinates."""

    space: Space
    rng: np.random.Generator
    positions: Array
    velocities: Array
    best: Array
    best_losses: Array
    iteration: int = 0


@dataclass(frozen=True)
class PSO(AskTell[PSOState]):
    """Particle swarm optimisation (Kennedy and Eberhart, 1995) with an inertia w that falls.

    A particle x with velocity v moves by v <- w v + c1 r1 (own best - x) + c2 r2 (swarm's best - x)
    and x <- x + v. Particles start at rest at the first common configurations. The run continues
    until the budget ends, or until a swarm without bounds has diverged.

    Parameters
    ----------
    particles : int
        Size of the swarm.
    c1, c2 : float
        Acceleration towards a particle's best position and the swarm's best position. The defaults
        are from the paper's reference [5].
    inertia_start, inertia_end : float
        The inertia w falls linearly from the first to the second over `iterations`, and then stays
        (Shi and Eberhart, 1999). The paper does not give w. The swarm of Kennedy and Eberhart
        (1995) has w = 1. A constant w = chi with c1 = c2 = chi phi / 2 is the swarm with
        constriction coefficient chi = 2 / abs(2 - phi - sqrt(phi^2 - 4 phi)) (Clerc and Kennedy,
        2002), whose particles converge for phi > 4.
    iterations : int
        Iterations over which the inertia falls.
    velocity_limit : float or None
        Largest velocity per iteration, as a share of each parameter's range in search coordinates;
        None for no limit.
    bounds : {"clip", "none"}
        "clip": a particle that meets a bound stops there. "none": particles may leave the box.
    sampling : {"normal", "uniform_plus_noise", "uniform"}
        Distribution of the first positions, see `miho.optim.Space.sample`.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    particles: int = 100
    c1: float = 2.0
    c2: float = 2.0
    inertia_start: float = 0.9
    inertia_end: float = 0.4
    iterations: int = 1000
    velocity_limit: float | None = 0.5
    bounds: str = "clip"
    sampling: str = "normal"

    def __post_init__(self) -> None:
        whole("particles", self.particles, 1, LARGEST_BATCH)
        whole("iterations", self.iterations, 1)
        settings_at_least(self, ("c1", "c2", "inertia_start", "inertia_end"), 0)
        if self.velocity_limit is not None:
            positive("velocity_limit", self.velocity_limit)
        one_of("bounds", self.bounds, BOUNDS)
        one_of("sampling", self.sampling, SAMPLINGS)

    def init(self, space: Space, rng: np.random.Generator) -> PSOState:
        """Particles at the common initial configurations, at rest."""
        positions = self._bounded(space.initial(self.particles, self.sampling), space)
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
        with np.errstate(over="ignore"):  # a swarm without bounds on a log scale may overflow
            return state.space.decode(state.positions)

    def tell(self, state: PSOState, thetas: Array, losses: Array) -> None:
        """Update the best positions, then move every particle."""
        better = losses < state.best_losses
        state.best[better] = state.positions[better]
        state.best_losses[better] = losses[better]
        leader = state.best[np.argmin(state.best_losses)]

        x, rng = state.positions, state.rng
        with np.errstate(over="ignore", invalid="ignore"):  # a swarm without bounds may diverge
            v = self._inertia(state.iteration) * state.velocities
            v += self.c1 * rng.random(x.shape) * (state.best - x)
            v += self.c2 * rng.random(x.shape) * (leader - x)
            if self.velocity_limit is not None:
                low, high = state.space.bounds
                limit = self.velocity_limit * (high - low)
                v = np.minimum(np.maximum(v, -limit), limit)
            moved = x + v
        state.positions = self._bounded(moved, state.space)
        state.velocities = np.where(moved == state.positions, v, 0.0)
        state.iteration += 1

    def done(self, state: PSOState) -> bool:
        """Return whether a swarm without bounds has diverged: no particle is near the box."""
        if self.bounds != "none":
            return False
        low, high = state.space.bounds
        near = np.abs(state.positions - low) <= FAR * (high - low)  # False for NaN
        return not near.all(axis=1).any()

    def _bounded(self, positions: Array, space: Space) -> Array:
        """Positions (n, d) in search coordinates, in the box unless there are no bounds."""
        if self.bounds == "none":
            return positions
        low, high = space.bounds
        return np.minimum(np.maximum(positions, low), high)

    def _inertia(self, iteration: int) -> float:
        fraction = min(1.0, iteration / self.iterations)
        return self.inertia_start + (self.inertia_end - self.inertia_start) * fraction
