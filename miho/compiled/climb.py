"""Mutation and acceptance steps on the machine of `miho.core`, many per call."""

from __future__ import annotations

import numpy as np

from miho.compiled.kernel import INFINITE, NAN, Block, Climb, Steps
from miho.compiled.taped import FIRST_BLOCK
from miho.core import Tape, machine
from miho.quantities import Array


def climb_on(tape: Tape, X: Array, y: Array) -> Climb:
    """Mutation steps on the mean square of a tape's single result minus y (N,) at X (p, N)."""

    def climb(steps: Steps, best: float, target: float) -> Block:
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

    return climb
