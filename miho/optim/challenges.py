"""Starts of challenges to the best minimum of a search with several minima.

A minimum that has missed a peak or a period usually has the other parameters right.
"""

from __future__ import annotations

import numpy as np

from miho.optim.brackets import alike
from miho.optim.miho_gn_state import MIHOGNState
from miho.optim.oracle import Oracle
from miho.optim.space import Space
from miho.quantities import Array

SHARE, MOST_POINTS, FEWEST_POINTS, MOST_STARTS = 1 / 8, 32, 4, 3
"""Largest share of the evaluations so far that a scan costs, largest and smallest number of points
along a parameter, and largest number of starts."""
GOLDEN = (5**0.5 - 1) / 2


def exchanged(best: Array, space: Space, n: int, rng: np.random.Generator) -> Array:
    """Starts (n, d) at the best minimum (d,), with values exchanged among parameters.

    A minimum may have the parameters of one peak at another one. Values are exchanged among
    parameters that are `alike`, in every second start in the same way for position, height and
    width. The first start has them in reverse order, as has each start that would be the minimum.
    """
    starts, keys = np.tile(best, (n, 1)), rng.random((n, best.size))
    for group in alike(space):
        group_keys = keys[:, group]
        group_keys[::2] = keys[::2, : len(group)]
        starts[:, group] = best[group][np.argsort(group_keys, axis=1)]
        starts[0, group] = best[group[::-1]]
    return np.where((starts == best).all(axis=1, keepdims=True), starts[0], starts)


def scanned(state: MIHOGNState, oracle: Oracle) -> Array | None:
    """Lowest points of the loss along each parameter through the best minimum, (k, d).

    Each is a minimum among evenly spaced values of one parameter, apart from the best minimum, in
    unit coordinates. Parameters in which the model is linear are left out. The values differ
    between scans. None if there is no such point, or if the search is too short for a scan.
    """
    best, scans = state.minima.x[state.best_minimum], state.box.nonlinear
    n = min(MOST_POINTS, int(SHARE * state.spent_before / scans.size))
    if n < FEWEST_POINTS:
        return None
    points = (np.arange(n) + state.bracket * GOLDEN % 1) / n
    x = np.tile(best, (scans.size, n, 1))
    x[np.arange(scans.size), :, scans] = points
    configurations = state.box.origin + state.box.width * x.reshape(-1, best.size)
    losses = oracle(state.space.decode(configurations)).reshape(scans.size, n)
    sides = np.pad(losses, ((0, 0), (1, 1)), constant_values=np.inf)
    low = (losses < sides[:, :-2]) & (losses < sides[:, 2:])
    low &= np.abs(points - best[scans, None]) > 1 / n  # the others lead back
    return x[low][np.argsort(losses[low], kind="stable")[:MOST_STARTS]] if low.any() else None
