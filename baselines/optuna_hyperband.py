"""Optuna's Hyperband pruner: asynchronous, and it only stops trials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import optuna

from miho.compiled import Block, Climb, Steps
from miho.optim import Optimizer, Oracle, Space
from miho.optim.miho import annealed_sigma, climb_of, compiled_steps, mutate
from miho.quantities import Array
from miho.validate import whole

optuna.logging.set_verbosity(optuna.logging.WARNING)


DRAWN_AT_ONCE = 1000
"""Initial configurations per draw."""


@dataclass(frozen=True)
class OptunaHyperband(Optimizer):
    """Optuna's Hyperband, with mutations as the resource.

    A trial is one initial configuration and up to R evaluations, all but one of mutants. It reports
    its best loss at the rungs 1, eta, eta^2, ... R, counted in its evaluations, and stops when
    `optuna.pruners.HyperbandPruner` says so. Between two rungs sigma anneals as on a rung of MIHO,
    and a better mutant replaces its parent: the two methods differ in how they distribute
    evaluations. Configurations are the common initial ones, then draws from the same distribution,
    so Optuna's sampler suggests nothing. The run continues until the budget ends, in memory. Every
    decision of the pruner searches all trials, so trials become slower.

    Parameters
    ----------
    R : int
        Most evaluations of a trial.
    eta : int
        Factor between rungs.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    R: int = 10_000
    eta: int = 5

    def __post_init__(self) -> None:
        whole("R", self.R, 1)
        whole("eta", self.eta, 2)

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Run trials one after the other until the budget ends."""
        # The pruner assigns brackets by a hash of the study's name and the trial's number.
        study = optuna.create_study(
            study_name=f"hyperband-{rng.integers(2**63)}",
            sampler=optuna.samplers.RandomSampler(seed=0),
            pruner=optuna.pruners.HyperbandPruner(
                min_resource=1, max_resource=self.R, reduction_factor=self.eta, bootstrap_count=0
            ),
        )
        for p in _configurations(oracle.space, rng):
            trial = study.ask()
            best, pruned = self._evaluate(p, trial, oracle, rng)
            if pruned:
                study.tell(trial, state=optuna.trial.TrialState.PRUNED)
            else:
                study.tell(trial, best)

    def _evaluate(
        self, p: Array, trial: optuna.Trial, oracle: Oracle, rng: np.random.Generator
    ) -> tuple[float, bool]:
        """Best loss of one trial, and whether it was pruned; p is (d,) in search coordinates."""
        space = oracle.space
        P = p[None]
        L = float(oracle(space.decode(P))[0])
        used = rung = 1
        while True:
            # A trial without a finite value ranks behind all others.
            trial.report(min(L, np.finfo(float).max), step=used)
            if rung == self.R:
                return min(L, np.finfo(float).max), False
            if trial.should_prune():
                return L, True
            rung = min(rung * self.eta, self.R)
            P, L = _climbed(P, L, annealed_sigma(space, rung - used), oracle, rng)
            used = rung


def _climbed(
    P: Array, L: float, sigma: Array, oracle: Oracle, rng: np.random.Generator
) -> tuple[Array, float]:
    """P (1, d) and its loss after one mutation for each row of sigma (k, d)."""
    space, climb = oracle.space, climb_of(oracle)
    if climb is not None:
        return _climbed_at_once(climb, P, L, sigma, oracle, rng)
    for step_sigma in sigma:
        mutant = mutate(P, step_sigma, space, rng, "box")
        loss = float(oracle(space.decode(mutant))[0])
        if loss < L:
            P, L = mutant, loss
    return P, L


def _climbed_at_once(
    climb: Climb, P: Array, L: float, sigma: Array, oracle: Oracle, rng: np.random.Generator
) -> tuple[Array, float]:
    """`_climbed` in compiled blocks."""
    space, k = oracle.space, 0
    P, losses = P.copy(), np.array([L])

    def block(most: float, best: float, target: float) -> Block:
        """As many of the next steps as `most` evaluations allow."""
        nonlocal k
        count = min(len(sigma) - k, int(most))
        mutant = mutate(P, sigma[k], space, rng, "box")
        steps = Steps(mutant, P, losses, np.empty(0), sigma[k + 1 : k + count], space.bounds)
        k += count
        block = compiled_steps(climb, steps, rng, best, target)
        return block._replace(finished=k == len(sigma))

    if len(sigma):
        oracle.spend(block, 1)
    return P, float(losses[0])


def _configurations(space: Space, rng: np.random.Generator) -> Iterator[Array]:
    yield from space.initial(DRAWN_AT_ONCE)
    while True:
        yield from space.sample(DRAWN_AT_ONCE, rng)
