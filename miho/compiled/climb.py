"""Mutation and acceptance steps on the machine of `miho.core`, many per call."""

from __future__ import annotations

import math

import numpy as np

from miho.compiled.kernel import INFINITE, NAN, Block, Climb, Steps
from miho.compiled.taped import FIRST_BLOCK, equal_parts
from miho.compiled.threads import threads_of
from miho.core import Tape, machine
from miho.quantities import Array

WORTH_THREADS = 1
"""A block with at least this number of steps after the first is divided among threads."""


def climb_on(tape: Tape, X: Array, y: Array, threads: int = 1) -> Climb:
    """Mutation steps on the mean square of a tape's single result minus y (N,) at X (p, N).

    Rows of P are independent and are divided among threads; the result does not depend on their
    number. A run with a target has only one thread, because all rows end with the step that reaches
    it.
    """

    def climb_rows(steps: Steps, best: float, target: float) -> Block:
        n, d = steps.P.shape
        most = (len(steps.noise) + 1) * n
        at, losses, thetas = np.empty(most, np.int64), np.empty(most), np.empty((most, d))
        count, improvements, nans, infinities = machine().climb(
            tape.in_machine, X, y, FIRST_BLOCK, steps, best, target, at, losses, thetas
        )
        return Block(
            count * n,
            at[:improvements].astype(float),
            losses[:improvements],
            thetas[:improvements],
            {NAN: nans, INFINITE: infinities},
        )

    def climb(steps: Steps, best: float, target: float) -> Block:
        n = len(steps.P)
        few = n < threads or len(steps.noise) < WORTH_THREADS
        if threads <= 1 or target > -math.inf or few:
            return climb_rows(steps, best, target)

        def part(rows: slice) -> Block:
            noise = np.ascontiguousarray(steps.noise[:, rows])
            first, P, L = steps.first[rows], steps.P[rows], steps.L[rows]
            return climb_rows(steps._replace(first=first, P=P, L=L, noise=noise), best, target)

        parts = equal_parts(n, threads)
        return _merged(list(threads_of(threads).map(part, parts)), parts, best)

    return climb


def _merged(blocks: list[Block], parts: list[slice], best: float) -> Block:
    """Combine the blocks of the parts, with improvements in the order of a loop over all rows."""
    n = parts[-1].stop
    numbers = []
    for block, rows in zip(blocks, parts, strict=True):
        step, row = np.divmod(block.at - 1, rows.stop - rows.start)
        numbers.append(step * n + rows.start + row + 1)
    at = np.concatenate(numbers)
    order = np.argsort(at)
    losses = np.concatenate([block.losses for block in blocks])[order]
    lower = losses < np.minimum.accumulate(np.append(best, losses[:-1]))
    improving = order[lower]
    return Block(
        sum(block.evaluations for block in blocks),
        at[improving],
        losses[lower],
        np.concatenate([block.thetas for block in blocks])[improving],
        {reason: sum(block.rejected[reason] for block in blocks) for reason in (NAN, INFINITE)},
    )
