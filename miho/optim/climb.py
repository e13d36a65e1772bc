"""Steps of mutation and acceptance, many at a time and compiled around a compiled loss."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

WORTH_THREADS = 1
"""Steps after the first that a block must have to be shared out."""


@dataclass(frozen=True)
class Climbed:
    """What a block of steps did: how many steps, and its improvements of the best loss.

    `at` (k,) counts the evaluations of the block up to each improvement, `losses` (k,) and `thetas`
    (k, d) are what was found there. `nans` and `infinities` count losses that are no numbers.
    """

    steps: int
    at: NDArray[np.int64]
    losses: Array
    thetas: Array
    nans: int
    infinities: int


class Climb(Protocol):
    """Compiled steps on one problem's loss."""

    def __call__(
        self,
        first: Array,
        P: Array,
        L: Array,
        noise: Array,
        sigma: Array,
        bounds: tuple[Array, Array],
        best: float,
        target: float,
        early_stopping: bool,
    ) -> Climbed:
        """Evaluate mutants of all rows of P, keep the better ones, and do it again.

        P (n, d) and L (n,) are changed in place. The mutants of the first step are `first` (n, d),
        those of step k are P + sigma[k - 1] noise[k - 1] within the bounds, with noise (steps - 1,
        n, d) and sigma (steps - 1, d): bit for bit what `mutate` gives. Improvements are of `best`;
        the block ends after the step that reaches `target`. With `early_stopping` a mutant is given
        up as soon as it cannot be better than its parent, which changes no decision.
        """


def compiled_climb(
    loss: Callable[..., float], signature: str, *, allocates: bool = True
) -> Callable[..., tuple[int, int, int, int]]:
    """The compiled loop around `loss(theta, limit, data, scratch)`, which numba can compile.

    `loss` may return any number that is not below `limit` as soon as it knows that the loss is not.
    `signature` tells this loss from all others: numba and its linker know the loop by its name.
    One that `allocates` no arrays goes without the counting of references to them, a quarter of the
    time of a loss of a microsecond.
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
        found = nans = infinities = evaluations = 0
        for k in range(noise.shape[0] + 1):
            for i in range(n):
                for j in range(d):
                    if k == 0:
                        mutant[j] = first[i, j]
                    else:
                        moved = noise[k - 1, i, j] * sigma[k - 1, j] + P[i, j]
                        mutant[j] = min(max(moved, low[j]), high[j])
                value = loss(mutant, L[i] if early_stopping else np.inf, data, scratch)
                evaluations += 1
                if value < L[i]:
                    for j in range(d):
                        P[i, j] = mutant[j]
                    L[i] = value
                    if value < best:
                        best = value
                        at[found] = evaluations
                        losses[found] = value
                        for j in range(d):
                            thetas[found, j] = mutant[j]
                        found += 1
                elif math.isnan(value):
                    nans += 1
                elif value == np.inf:
                    infinities += 1
            if best <= target:
                break
        return k + 1, found, nans, infinities

    climb.__qualname__ += f".{signature}"
    compiled = njit(cache=True, nogil=True, error_model="numpy", _nrt=allocates)(climb)
    return cast(Callable[..., tuple[int, int, int, int]], compiled)


def climb_on(
    compiled: Callable[..., tuple[int, int, int, int]],
    data: Any,
    room: Callable[[], Any],
    threads: int = 1,
) -> Climb:
    """The compiled loop on one problem's data, its rows shared out among threads.

    `room` makes the arrays that a thread works in.

    A row climbs by itself, so that the result is the same however many there are. A run with a
    target has one: where it ends, all rows must.
    """
    pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def climb_rows(
        first: Array,
        P: Array,
        L: Array,
        noise: Array,
        sigma: Array,
        bounds: tuple[Array, Array],
        best: float,
        target: float,
        early_stopping: bool,
    ) -> Climbed:
        most, d = (len(noise) + 1) * len(P), P.shape[1]
        at, losses, thetas = np.empty(most, np.int64), np.empty(most), np.empty((most, d))
        steps, found, nans, infinities = compiled(
            data, room(), np.empty(d), first, P, L, noise, sigma, *bounds, best, target,
            early_stopping, at, losses, thetas,
        )  # fmt: skip
        return Climbed(steps, at[:found], losses[:found], thetas[:found], nans, infinities)

    def climb(
        first: Array,
        P: Array,
        L: Array,
        noise: Array,
        sigma: Array,
        bounds: tuple[Array, Array],
        best: float,
        target: float,
        early_stopping: bool,
    ) -> Climbed:
        rest = sigma, bounds, best, target, early_stopping
        if pool is None or target > -math.inf or len(P) < threads or len(noise) < WORTH_THREADS:
            return climb_rows(first, P, L, noise, *rest)

        def part(rows: slice) -> Climbed:
            mine = np.ascontiguousarray(noise[:, rows])
            return climb_rows(first[rows], P[rows], L[rows], mine, *rest)

        parts = equal_parts(len(P), threads)
        return _together(list(pool.map(part, parts)), parts, best)

    return climb


def equal_parts(n: int, count: int) -> list[slice]:
    """Rows 0 to n in `count` parts, which differ by one row at most."""
    return [slice(i, j) for i, j in pairwise(np.linspace(0, n, count + 1).astype(int).tolist())]


def _together(parts: list[Climbed], rows: list[slice], best: float) -> Climbed:
    """What the rows did, with the improvements in the order of a loop over all of them."""
    n = rows[-1].stop
    numbers = []
    for part, own in zip(parts, rows, strict=True):
        step, row = np.divmod(part.at - 1, own.stop - own.start)
        numbers.append(step * n + own.start + row + 1)
    at = np.concatenate(numbers)
    order = np.argsort(at)
    losses = np.concatenate([part.losses for part in parts])[order]
    lower = losses < np.minimum.accumulate(np.append(best, losses[:-1]))
    kept = order[lower]
    return Climbed(
        parts[0].steps,
        at[kept],
        losses[lower],
        np.concatenate([part.thetas for part in parts])[kept],
        sum(part.nans for part in parts),
        sum(part.infinities for part in parts),
    )
