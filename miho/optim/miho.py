"""MIHO: Hyperband whose evaluations mutate what they evaluate (Alg. 1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from miho.compiled import Block, Climb
from miho.optim.miho_settings import MIHOSettings
from miho.optim.mutation import climb_of, compiled_steps, limits
from miho.optim.optimizer import Resumable
from miho.optim.oracle import Oracle
from miho.optim.schedule import Rung
from miho.optim.space import Space
from miho.quantities import Array


@dataclass
class MIHOState:
    """Where Alg. 1 stands: P (n, d) in search coordinates with losses L (n,) on rung `position`.

    `step` counts the mutations made on this rung, -1 while fresh configurations are evaluated;
    `sigma` (mutations, d) anneals over them. `batch` (n, d) is being evaluated, its first `row`
    rows are already.
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
        """The rung in progress."""
        return self.table[self.position]


@dataclass(frozen=True)
class MIHO(MIHOSettings, Resumable[MIHOState]):
    """Alg. 1 with the settings it leaves open; the defaults are the paper as printed.

    A fresh configuration costs one evaluation before its mutations; a survivor's loss is known and
    not paid for again. All configurations of a rung are mutated side by side, so a batch is one
    mutation of each. Ends by itself after the last bracket.

    `early_stopping` gives a mutant up as soon as its loss cannot be below its parent's, where the
    problem has a compiled loss; it changes no decision, but what the rest of its loss would have
    been, NaN included, is then not seen.
    """

    early_stopping: bool = True

    def start(self, oracle: Oracle, rng: np.random.Generator) -> MIHOState:
        """The first bracket's configurations are the common initial ones."""
        space, table = oracle.space, self.table()
        P = self.initial(space, table[0].n)
        return MIHOState(
            space=space,
            rng=rng,
            table=table,
            position=0,
            P=P,
            L=np.full(len(P), np.inf),
            step=-1,
            sigma=self.sigma(space, table[0].mutations),
            batch=P,
        )

    def step(self, state: MIHOState, oracle: Oracle) -> None:
        """A batch; or the next steps of this rung, or rows of one, in one compiled block."""
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
        """At most `most` evaluations in compiled code: whole steps of all rows, or one of some."""
        evaluations, n = int(most), len(state.P)
        whole = evaluations >= n and state.row == 0
        count = min(evaluations // n, state.rung.mutations - state.step) if whole else 1
        rows = slice(state.row, min(state.row + evaluations, n))
        block = compiled_steps(
            climb,
            (state.batch[rows], state.P[rows], state.L[rows]),
            state.sigma[state.step + 1 : state.step + count],
            limits(state.space, self.clip),
            state.rng,
            (best, target),
            early_stopping=self.early_stopping,
        )
        state.row = rows.stop % n
        if state.row == 0:
            self._count(state, round(block.evaluations) // (rows.stop - rows.start))
        return block

    def _count(self, state: MIHOState, steps: int) -> None:
        """Count steps as done and prepare the next batch."""
        state.step += steps
        while state.step == state.rung.mutations:
            if not self._advance(state):
                return
        if state.step >= 0:
            sigma = state.sigma[state.step]
            state.batch = self.proposals(state.P, sigma, state.space, state.rng)

    def done(self, state: MIHOState) -> bool:
        """After the last rung of the bracket s = 0."""
        return state.position == len(state.table)

    def _advance(self, state: MIHOState) -> bool:
        """Go to the next rung, with the best of this one (line 8) or a fresh bracket (line 4)."""
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
        state.sigma = self.sigma(state.space, state.rung.mutations)
        return True
