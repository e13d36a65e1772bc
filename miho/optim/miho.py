"""MIHO: Hyperband whose evaluations mutate their configurations (Alg. 1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from miho.compiled import Block, Climb, Steps
from miho.optim.optimizer import Resumable
from miho.optim.oracle import Oracle
from miho.optim.schedule import ROUNDINGS, Rung, hyperband_table
from miho.optim.space import LARGEST_BATCH, SAMPLINGS, Space
from miho.quantities import Array
from miho.validate import one_of, true_or_false, whole

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


PROPOSALS = ("mutation", "fresh")
NO_NOISE = np.empty(0)


@dataclass
class MIHOState:
    """State of Alg. 1: configurations P (n, d) in search coordinates with losses L (n,).

    `position` is the rung in `table`. `step` counts the mutations on this rung, -1 while fresh
    configurations are evaluated; `sigma` (mutations, d) anneals over them. `batch` (n, d) is being
    evaluated; its first `row` rows are done.
    """

    space: Space
    rng: np.random.Generator
    table: tuple[Rung, ...]
    position: int
    P: Array
    L: Array
    step: int
    sigma: Array
    batch: Array = field(repr=False)
    row: int = 0

    @property
    def rung(self) -> Rung:
        """The current rung."""
        return self.table[self.position]


@dataclass(frozen=True)
class MIHO(Resumable[MIHOState]):
    """MIHO as published (Alg. 1): Hyperband over configurations that mutate.

    The default settings follow the paper as printed. A fresh configuration costs one evaluation
    before its mutations; the loss of a survivor is known and costs nothing. All configurations of a
    rung mutate together: a batch has one mutation of each. The search ends after the last bracket.
    In practice prefer `MIHOGN` or `MIHOQN`, which need far fewer evaluations.

    Parameters
    ----------
    R : int, optional
        Largest number of mutations of one configuration on a rung (Alg. 1).
    eta : int, optional
        One configuration in `eta` continues on the next rung (Alg. 1, η).
    rounding : {"ceil", "floor"}, optional
        Rounding of s_max = log_eta(R) (Alg. 1, line 1); "floor" is Hyperband's.
    sampling : {"normal", "uniform_plus_noise", "uniform"}, optional
        Distribution of fresh configurations (line 4), see `Space.sample`.
    annealing : {"linear", "exponential"}, optional
        Decrease of sigma over the mutations of a rung (Eq. 2).
    clip : {"box", "lower", "none"}, optional
        Whether mutants are clipped to both bounds, to the lower bounds, or not at all.
    proposal : {"mutation", "fresh"}, optional
        Competitor of a configuration: its mutation, or a fresh draw, which shows the benefit of
        mutation.
    early_stopping : bool, optional
        Whether the compiled loss stops as soon as a mutant cannot be better than its parent. It
        changes no decision, but hides values in the rest of the loss, NaN included.

    Raises
    ------
    ValueError
        If a setting is not possible.

    Examples
    --------
    >>> import miho
    >>> class Bowl(miho.Problem):
    ...     name = "bowl"
    ...     space = miho.Space((miho.Parameter("a", "m", -5, 5), miho.Parameter("b", "m", -5, 5)))
    ...     def loss(self, thetas, fidelity=1.0):
    ...         return ((thetas - [1, 2]) ** 2).sum(axis=1)
    >>> record = miho.minimize(miho.MIHO(R=100, eta=3), Bowl())
    >>> record.loss < 0.01
    True
    """

    R: int = 10_000
    eta: int = 5
    rounding: str = "ceil"
    sampling: str = "normal"
    annealing: str = "linear"
    clip: str = "box"
    proposal: str = "mutation"
    early_stopping: bool = True

    def __post_init__(self) -> None:
        whole("R", self.R, 1)
        whole("eta", self.eta, 2)
        one_of("rounding", self.rounding, ROUNDINGS)
        one_of("sampling", self.sampling, SAMPLINGS)
        one_of("annealing", self.annealing, ANNEALINGS)
        one_of("clip", self.clip, CLIPS)
        one_of("proposal", self.proposal, PROPOSALS)
        true_or_false(self, ["early_stopping"])
        first = self.table()[0].n
        if first > LARGEST_BATCH:
            raise ValueError(
                f"R is {self.R} and eta is {self.eta}: the first bracket has {first:,} "
                f"configurations; expected at most {LARGEST_BATCH:,}"
            )

    def table(self) -> tuple[Rung, ...]:
        """All rungs of all brackets, in the order of Alg. 1."""
        return hyperband_table(self.R, self.eta, self.rounding)

    def start(self, oracle: Oracle, rng: np.random.Generator) -> MIHOState:
        """State before the first bracket, whose configurations are the common initial ones."""
        space, table = oracle.space, self.table()
        P = self._clipped(space.initial(table[0].n, self.sampling), space)
        return MIHOState(
            space=space,
            rng=rng,
            table=table,
            position=0,
            P=P,
            L=np.full(len(P), np.inf),
            step=-1,
            sigma=annealed_sigma(space, table[0].mutations, self.annealing),
            batch=P,
        )

    def step(self, state: MIHOState, oracle: Oracle) -> None:
        """Evaluate one batch, or make the next steps of this rung in one compiled block."""
        climb = None
        if state.step >= 0 and self.proposal == "mutation":
            climb = climb_of(oracle)
        if climb is None:
            self._evaluate(state, oracle)
        else:
            oracle.spend(partial(self._climb, climb, state), 1)

    def _evaluate(self, state: MIHOState, oracle: Oracle) -> None:
        """Keep each configuration that is better than its parent, then prepare the next batch."""
        rows = slice(state.row, None)
        losses = oracle(state.space.decode(state.batch[rows]))
        if state.step < 0:
            state.L = losses.copy()
        else:
            better = losses < state.L[rows]
            if better.any():
                state.P[rows][better] = state.batch[rows][better]
                state.L[rows][better] = losses[better]
        state.row = 0
        self._count(state, 1)

    def _climb(
        self, climb: Climb, state: MIHOState, most: float, best: float, target: float
    ) -> Block:
        """Make at most `most` evaluations in compiled code: whole steps, or one of some rows."""
        evaluations, n = int(most), len(state.P)
        whole_steps = evaluations >= n and state.row == 0
        count = min(evaluations // n, state.rung.mutations - state.step) if whole_steps else 1
        rows = slice(state.row, min(state.row + evaluations, n))
        steps = Steps(
            state.batch[rows], state.P[rows], state.L[rows], NO_NOISE,
            state.sigma[state.step + 1 : state.step + count], limits(state.space, self.clip),
            self.early_stopping,
        )  # fmt: skip
        block = compiled_steps(climb, steps, state.rng, best, target)
        state.row = rows.stop % n
        if state.row == 0:
            self._count(state, round(block.evaluations) // (rows.stop - rows.start))
        return block

    def _count(self, state: MIHOState, steps: int) -> None:
        """Count completed steps and prepare the next batch."""
        state.step += steps
        while state.step == state.rung.mutations:
            if not self._advance(state):
                return
        if state.step >= 0:
            sigma = state.sigma[state.step]
            state.batch = self.proposals(state.P, sigma, state.space, state.rng)

    def done(self, state: MIHOState) -> bool:
        """Whether the last rung of the bracket s = 0 is complete."""
        return state.position == len(state.table)

    def _advance(self, state: MIHOState) -> bool:
        """Move to the next rung with the best of this one (line 8), or to a bracket (line 4)."""
        state.position += 1
        if self.done(state):
            return False
        if state.rung.j == 0:
            state.P = self.fresh(state.space, state.rung.n, state.rng)
            state.batch = state.P
            state.step = -1
        else:
            top = np.argsort(state.L, kind="stable")[: state.rung.n]
            state.P, state.L = state.P[top], state.L[top]
            state.step = 0
        state.sigma = annealed_sigma(state.space, state.rung.mutations, self.annealing)
        return True

    def fresh(self, space: Space, n: int, rng: np.random.Generator) -> Array:
        """Draw configurations (n, d), in search coordinates."""
        return self._clipped(space.sample(n, rng, self.sampling), space)

    def proposals(self, P: Array, sigma: Array, space: Space, rng: np.random.Generator) -> Array:
        """Next competitors of configurations P (n, d), in search coordinates."""
        if self.proposal == "mutation":
            return mutate(P, sigma, space, rng, self.clip)
        return self.fresh(space, len(P), rng)

    def _clipped(self, P: Array, space: Space) -> Array:
        """P (n, d) within the limits of `clip`, in search coordinates."""
        low, high = limits(space, self.clip)
        return np.asarray(np.minimum(np.maximum(P, low), high))
