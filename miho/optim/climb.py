"""Steps of mutation and acceptance, many at a time and compiled around a compiled loss."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
    loss: Callable[..., float], signature: str
) -> Callable[..., tuple[int, int, int, int]]:
    """The compiled loop around `loss(theta, limit, data)`, which numba can compile.

    `loss` may return any number that is not below `limit` as soon as it knows that the loss is not.
    `signature` tells this loss from all others: numba and its linker know the loop by its name.
    """

    def climb(
        data: Any,
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
        mutant = np.empty(d)
        for k in range(noise.shape[0] + 1):
            for i in range(n):
                if k == 0:
                    mutant[:] = first[i]
                else:
                    for j in range(d):
                        moved = noise[k - 1, i, j] * sigma[k - 1, j] + P[i, j]
                        mutant[j] = min(max(moved, low[j]), high[j])
                value = loss(mutant, L[i] if early_stopping else np.inf, data)
                evaluations += 1
                if value < L[i]:
                    P[i] = mutant
                    L[i] = value
                    if value < best:
                        best = value
                        at[found] = evaluations
                        losses[found] = value
                        thetas[found] = mutant
                        found += 1
                elif math.isnan(value):
                    nans += 1
                elif value == np.inf:
                    infinities += 1
            if best <= target:
                break
        return k + 1, found, nans, infinities

    climb.__qualname__ += f".{signature}"
    compiled = njit(cache=True, nogil=True, error_model="numpy")(climb)
    return cast(Callable[..., tuple[int, int, int, int]], compiled)


def climb_on(compiled: Callable[..., tuple[int, int, int, int]], data: Any) -> Climb:
    """The compiled loop on one problem's data."""

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
        most, d = (len(noise) + 1) * len(P), P.shape[1]
        at, losses, thetas = np.empty(most, np.int64), np.empty(most), np.empty((most, d))
        steps, found, nans, infinities = compiled(
            data, first, P, L, noise, sigma, *bounds, best, target, early_stopping,
            at, losses, thetas,
        )  # fmt: skip
        return Climbed(steps, at[:found], losses[:found], thetas[:found], nans, infinities)

    return climb
