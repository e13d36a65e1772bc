"""MIHO without batches: each configuration continues as soon as its evaluation is complete."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from miho.compiled import Block, Climb
from miho.optim.miho_settings import MIHOSettings
from miho.optim.mutation import climb_of, compiled_steps, limits
from miho.optim.optimizer import Resumable
from miho.optim.oracle import Oracle
from miho.optim.schedule import Rung
from miho.optim.space import Space
from miho.parallel import Ahead
from miho.quantities import Array


@dataclass
class Chain:
    """A configuration x (d,) and its loss, on its way through the mutations of a rung.

    `step` counts its mutations on this rung, -1 before its first evaluation. `proposal` (d,) is
    evaluated next, `ahead` is its evaluation on a worker, which a stored state does not contain.
    """

    rung: AsynchronousRung
    x: Array
    loss: float
    step: int
    proposal: Array
    ahead: Ahead | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"ahead": None}


@dataclass
class AsynchronousRung:
    """A rung of a bracket that fills one configuration at a time.

    `sigma` (mutations, d) anneals over its mutations. `seen` counts the configurations that ended
    here. `waiting` is a heap of the configurations that were not promoted, by loss and arrival.
    """

    rung: Rung
    sigma: Array
    seen: int = 0
    promoted: int = 0
    waiting: list[tuple[float, int, Array]] = field(default_factory=list, repr=False)

    @property
    def complete(self) -> bool:
        """Whether all configurations of the rung have ended."""
        return self.seen == self.rung.n

    def add(self, loss: float, x: Array) -> None:
        """Add a configuration that ended here."""
        heapq.heappush(self.waiting, (loss, self.seen, x))
        self.seen += 1

    def promotes(self, eta: int, n: int) -> bool:
        """Whether the best waiting configuration continues on the next rung, of n configurations.

        It does if it is among the best floor(seen / eta), that is, if fewer were promoted. A
        complete rung promotes as many as the next rung has.
        """
        return self.promoted < (n if self.complete else min(self.seen // eta, n))

    def promote(self) -> tuple[float, Array]:
        """Remove and return the best waiting configuration."""
        self.promoted += 1
        loss, _, x = heapq.heappop(self.waiting)
        return loss, x


@dataclass
class AsynchronousBracket:
    """Rungs of a bracket, and its fresh configurations (n, d); the first `begun` have started."""

    rungs: Sequence[AsynchronousRung]
    fresh: Array = field(repr=False)
    begun: int = 0


@dataclass
class AsynchronousMIHOState:
    """Active chains, and the brackets that have not ended.

    `coming` has the rungs of brackets that have not begun. `arrived` is the position of the chain
    whose evaluation is complete, None while unknown.
    """

    space: Space
    rng: np.random.Generator
    coming: list[tuple[Rung, ...]]
    brackets: list[AsynchronousBracket] = field(default_factory=list)
    chains: list[Chain] = field(default_factory=list)
    arrived: int | None = None


@dataclass(frozen=True)
class AsynchronousMIHO(MIHOSettings, Resumable[AsynchronousMIHOState]):
    """MIHO for evaluations of unequal length: as many chains of mutations as there are workers.

    Settings, and numbers of configurations on all rungs, are the same as for `MIHO`. A
    configuration continues on the next rung as soon as it is among the best one in eta of its rung
    (ASHA [1]_), the deepest rung first; otherwise a fresh one begins. A bracket begins as soon as
    the previous one has started all it can, so that no worker waits before the last bracket.

    There is one chain until evaluations are known to be expensive enough for one worker each
    (`Oracle.workers`). So the search is deterministic without workers and for cheap evaluations; a
    single chain uses compiled blocks if the problem has them. The decisions with several chains
    depend only on the evaluation after which they began and on the order in which their evaluations
    end: `minimize(..., replay=record.arrivals)` repeats a run to the last bit.

    References
    ----------
    .. [1] L. Li et al., "A system for massively parallel hyperparameter tuning", MLSys (2020).
    """

    def start(self, oracle: Oracle, rng: np.random.Generator) -> AsynchronousMIHOState:
        """State before the first bracket."""
        brackets = [tuple(rungs) for _, rungs in groupby(self.table(), lambda rung: rung.s)]
        return AsynchronousMIHOState(oracle.space, rng, brackets)

    def step(self, state: AsynchronousMIHOState, oracle: Oracle) -> None:
        """Process the evaluation that ended first, or make compiled steps."""
        if state.arrived is None:
            self._fill(state, oracle.workers)
            climb = self._climb_of(state, oracle)
            if climb is not None:
                oracle.spend(partial(self._climb, climb, state), 1)
                return
            state.arrived = self._first_ready(state, oracle)
        chain = state.chains[state.arrived]
        loss = float(oracle(state.space.decode(chain.proposal[None]))[0])
        # Nothing raises from here on. The chain moves to the end of the queue.
        state.chains.append(state.chains.pop(state.arrived))
        state.arrived = chain.ahead = None
        if chain.step < 0 or loss < chain.loss:
            chain.x, chain.loss = chain.proposal, loss
        self._count(state, 1)

    def done(self, state: AsynchronousMIHOState) -> bool:
        """Whether the last bracket has ended."""
        return not (state.chains or state.brackets or state.coming)

    def _first_ready(self, state: AsynchronousMIHOState, oracle: Oracle) -> int:
        """Start evaluations on workers; return the chain whose evaluation ends first.

        Returns its position. A single chain does not start its evaluation ahead.
        """
        if len(state.chains) == 1:
            return 0
        needs = []
        for chain in state.chains:
            if chain.ahead is None:
                chain.ahead = oracle.ahead(state.space.decode(chain.proposal[None]))
            needs.append(chain.ahead)
        return oracle.first_ready(needs)

    def _climb_of(self, state: AsynchronousMIHOState, oracle: Oracle) -> Climb | None:
        """Compiled steps for a single chain that has its first evaluation."""
        alone = len(state.chains) == 1 and state.chains[0].step >= 0
        return climb_of(oracle) if alone and self.proposal == "mutation" else None

    def _climb(
        self, climb: Climb, state: AsynchronousMIHOState, most: float, best: float, target: float
    ) -> Block:
        """Make at most `most` mutations of the only chain in compiled code."""
        (chain,) = state.chains
        count = min(int(most), chain.rung.rung.mutations - chain.step)
        P, L = chain.x[None].copy(), np.array([chain.loss])
        block = compiled_steps(
            climb,
            (chain.proposal[None], P, L),
            chain.rung.sigma[chain.step + 1 : chain.step + count],
            limits(state.space, self.clip),
            state.rng,
            (best, target),
        )
        chain.x, chain.loss = P[0], float(L[0])
        self._count(state, round(block.evaluations))
        return block

    def _count(self, state: AsynchronousMIHOState, evaluations: int) -> None:
        """Count evaluations of the last chain, which continues or ends on this rung."""
        chain = state.chains[-1]
        chain.step += evaluations
        if chain.step < chain.rung.rung.mutations:
            self._propose(state, chain)
            return
        chain.rung.add(chain.loss, chain.x)
        state.chains.pop()
        state.brackets = [b for b in state.brackets if not all(r.complete for r in b.rungs)]

    def _fill(self, state: AsynchronousMIHOState, workers: int) -> None:
        """Begin chains until there is one per worker, or none can begin."""
        while len(state.chains) < workers:
            chains = (self._next_chain(state, bracket) for bracket in state.brackets)
            chain = next((chain for chain in chains if chain is not None), None)
            if chain is not None:
                state.chains.append(chain)
            elif state.coming:
                self._begin_bracket(state)
            else:
                return

    def _begin_bracket(self, state: AsynchronousMIHOState) -> None:
        """Begin the next bracket (Alg. 1, line 4); the first with the common configurations."""
        space, table = state.space, state.coming.pop(0)
        n, first = table[0].n, table[0] == self.table()[0]
        fresh = self.initial(space, n) if first else self.fresh(space, n, state.rng)
        rungs = [AsynchronousRung(rung, self.sigma(space, rung.mutations)) for rung in table]
        state.brackets.append(AsynchronousBracket(rungs, fresh))

    def _next_chain(
        self, state: AsynchronousMIHOState, bracket: AsynchronousBracket
    ) -> Chain | None:
        """The promotion to the deepest rung, else a fresh configuration, else None."""
        rungs = bracket.rungs
        for below, above in zip(rungs[-2::-1], rungs[:0:-1], strict=True):
            if below.promotes(self.eta, above.rung.n):
                loss, x = below.promote()
                chain = Chain(above, x, loss, 0, x)
                self._propose(state, chain)
                return chain
        if bracket.begun == len(bracket.fresh):
            return None
        x = bracket.fresh[bracket.begun]
        bracket.begun += 1
        return Chain(rungs[0], x, math.inf, -1, x)

    def _propose(self, state: AsynchronousMIHOState, chain: Chain) -> None:
        sigma = chain.rung.sigma[chain.step]
        chain.proposal = self.proposals(chain.x[None], sigma, state.space, state.rng)[0]
