"""Steps of mutation and acceptance, many at a time and compiled around a compiled loss."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from miho.compiled.kernel import INFINITE, NAN, Block, Climb, Steps
from miho.compiled.taped import equal_parts
from miho.compiled.threads import threads_of
from miho.quantities import Array

WORTH_THREADS = 1
"""A block with at least so many steps after the first is shared out among threads."""


def compiled_climb(
    loss: Callable[..., float], signature: str, *, allocates: bool = True
) -> Callable[..., tuple[int, int, int, int]]:
    """The compiled loop of mutation steps around `loss(theta, limit, data, scratch)`.

    `loss` is a function that numba can compile; it may return any number that is not below `limit`
    once it knows that the loss is not. `signature` tells this loss from all others: numba and its
    linker know the loop by its name. One that allocates no arrays (`allocates` false) goes without
    reference counting, which takes a quarter of the time of a loss of a microsecond. The loop gives
    (steps made, improvements, losses that are NaN, and infinite), and fills `at`, `losses` and
    `thetas` with the improvements, as in `Block`.
    """

    def climb(
        data: Any,
        scratch: Any,
        mutant: Array,
        first: Array,
        P: Array,
        L: Array,
        noise: Array,
        sigma: Array,
        low: Array,
        high: Array,
        best: float,
        target: float,
        early_stopping: bool,
        at: NDArray[np.int64],
        losses: Array,
        thetas: Array,
    ) -> tuple[int, int, int, int]:
        n, d = P.shape
        improvements = nans = infinities = evaluations = 0
        for k in range(noise.shape[0] + 1):
            for i in range(n):
                # Mutate row i of P (Eq. 2); the mutants of the first step are given.
                for j in range(d):
                    if k == 0:
                        mutant[j] = first[i, j]
                    else:
                        mutated = noise[k - 1, i, j] * sigma[k - 1, j] + P[i, j]
                        mutant[j] = min(max(mutated, low[j]), high[j])
                # A mutant that is better than its parent replaces it.
                value = loss(mutant, L[i] if early_stopping else np.inf, data, scratch)
                evaluations += 1
                if value < L[i]:
                    for j in range(d):
                        P[i, j] = mutant[j]
                    L[i] = value
                    # List it if it is better than all before.
                    if value < best:
                        best = value
                        at[improvements] = evaluations
                        losses[improvements] = value
                        for j in range(d):
                            thetas[improvements, j] = mutant[j]
                        improvements += 1
                elif math.isnan(value):
                    nans += 1
                elif value == np.inf:
                    infinities += 1
            if best <= target:
                break
        return k + 1, improvements, nans, infinities

    climb.__qualname__ += f".{signature}"
    compiled = njit(cache=True, nogil=True, error_model="numpy", _nrt=allocates)(climb)
    return cast(Callable[..., tuple[int, int, int, int]], compiled)


def climb_on(
    compiled: Callable[..., tuple[int, int, int, int]],
    data: Any,
    room: Callable[[], Any],
    threads: int = 1,
    kept: object = None,
) -> Climb:
    """The compiled loop on one problem's data, with the rows of P shared out among threads.

    `room` makes the arrays that a thread works in. `kept` holds what addresses in the data point
    to, and lives as long as what this gives. Rows do not depend on each other, so that the result
    is the same however many threads there are. A run with a target has only one, since all rows end
    with the step that reaches it.
    """

    def climb_rows(steps: Steps, best: float, target: float) -> Block:
        n, d = steps.P.shape
        most = (len(steps.noise) + 1) * n
        at, losses, thetas = np.empty(most, np.int64), np.empty(most), np.empty((most, d))
        *arrays, bounds, early_stopping = steps
        count, improvements, nans, infinities = compiled(
            data, room(), np.empty(d), *arrays, *bounds, best, target, early_stopping,
            at, losses, thetas,
        )  # fmt: skip
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

    climb.__dict__["kept"] = kept
    return climb


def _merged(blocks: list[Block], parts: list[slice], best: float) -> Block:
    """The parts' blocks as one, with improvements in the order of a loop over all rows."""
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
