"""Choosing rows that tell the most about parameters: greedy, then by exchange.

Fedorov (Theory of Optimal Experiments, 1972, Ch. 3) exchanges rows of a design for candidates as
long as the determinant of the information grows; Cook and Nachtsheim (Technometrics 22, 1980, p.
315) go through the rows in turn and take for each the best candidate, which is as good and far
cheaper. Whole groups of rows, such as sweeps, are exchanged in the same way.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

PASSES = 20
"""Times through the whole selection at most; it is usually stable after two or three."""
BETTER = 1e-9
"""An exchange that gains less than this fraction of what a row gains is rounding."""
ENOUGH = 1e-4
"""A pass that lowers the criterion, a logarithm, by less is the last: on a fine grid rows would
move to a neighbour for long."""


class Information:
    """What is known of parameters z (r,), and what blocks of rows would add to it.

    The errors of present estimates are independent and of unit variance, and so are those of the
    rows: `blocks` (G, k, r) are derivatives by z, of k rows at most in each of G groups (rows of
    zeros fill up smaller ones). `target` (r,) is the gradient of the one quantity whose variance
    is to be small; None: the determinant of all of the covariance is.
    """

    def __init__(self, blocks: Array, target: Array | None = None) -> None:
        self._blocks, self._target = blocks, target
        self._rows = blocks.reshape(-1, blocks.shape[2])
        self.renew(np.zeros(len(blocks), dtype=np.intp))

    def renew(self, counts: NDArray[np.intp]) -> None:
        """Begin anew, with each block added as often as `counts` (G,), which leaves no rounding."""
        used = np.flatnonzero(counts)
        rows = np.sqrt(counts[used])[:, None, None] * self._blocks[used]
        _, s, Vt = np.linalg.svd(rows.reshape(-1, self._blocks.shape[2]))
        variances = np.ones(len(Vt))
        variances[: s.size] = 1 / (1 + s**2)
        self._covariance = (Vt.T * variances) @ Vt
        projected = self._blocks @ self._covariance
        self._predicted = projected @ self._blocks.transpose(0, 2, 1)
        if self._target is not None:
            self._by_target = projected @ self._target

    @property
    def criterion(self) -> float:
        """What is to be small: ln of the determinant of the covariance, or of the variance."""
        if self._target is None:
            return float(np.linalg.slogdet(self._covariance)[1])
        return math.log(float(self._target @ self._covariance @ self._target))

    def gains(self) -> Array:
        """How much each block (G,) would add: ln of the determinant, or fall of the variance."""
        k = self._blocks.shape[1]
        measured = self._predicted + np.eye(k)
        if self._target is None:
            logarithms = np.log(measured[:, 0, 0]) if k == 1 else np.linalg.slogdet(measured)[1]
            return np.asarray(logarithms)
        if k == 1:
            return np.asarray(self._by_target[:, 0] ** 2 / measured[:, 0, 0])
        solved = np.linalg.solve(measured, self._by_target[:, :, None])[:, :, 0]
        return np.asarray((self._by_target * solved).sum(axis=1))

    def add(self, group: int, sign: int = 1) -> None:
        """Add a block, or take it away with sign -1 (Sherman, Morrison and Woodbury)."""
        block = self._blocks[group]
        projected = self._covariance @ block.T
        inverse = np.linalg.inv(sign * np.eye(len(block)) + block @ projected)
        self._covariance = self._covariance - projected @ inverse @ projected.T
        # The covariance of each prediction (G, k) with those of the block.
        shared = (self._rows @ projected).reshape(*self._blocks.shape[:2], -1)
        if self._target is not None:
            self._by_target = self._by_target - shared @ (inverse @ self._by_target[group])
        self._predicted = self._predicted - np.einsum("gkm,glm->gkl", shared @ inverse, shared)


def best_groups(
    blocks: Array, size: int, target: Array | None = None, repeats: int = 1
) -> NDArray[np.intp]:
    """How often to take each group (G,): `size` in all, each at most `repeats` times.

    Blocks and target as in `Information`. A local optimum, in which exchanges of one group for
    another hardly gain anything. For a target, whose rows may tell little one by one, it is the
    better of two: from rows that are added for the target, and from those for all parameters.
    """
    nothing = np.zeros(len(blocks), dtype=np.intp)
    for_all = _added(Information(blocks), nothing, size, repeats)
    if target is None:
        return _exchanged(Information(blocks), for_all, repeats)
    information = Information(blocks, target)
    ends = []
    for start in (_added(information, nothing, size, repeats), for_all):
        counts = _exchanged(information, start, repeats)
        information.renew(counts)
        ends.append((information.criterion, counts))
    return min(ends, key=lambda end: end[0])[1]


def _added(
    information: Information, counts: NDArray[np.intp], size: int, repeats: int
) -> NDArray[np.intp]:
    """`size` groups more, one after the other the best."""
    counts = counts.copy()
    information.renew(counts)
    for _ in range(size):
        best = int(np.argmax(np.where(counts < repeats, information.gains(), -np.inf)))
        information.add(best)
        counts[best] += 1
    return counts


def _exchanged(
    information: Information, counts: NDArray[np.intp], repeats: int
) -> NDArray[np.intp]:
    """Each group in turn replaced by the best one, until that gains hardly anything."""
    counts = counts.copy()
    information.renew(counts)
    for _ in range(PASSES):
        before = information.criterion
        for group in np.repeat(np.arange(len(counts)), counts).tolist():
            information.add(group, -1)
            counts[group] -= 1
            gains = np.where(counts < repeats, information.gains(), -np.inf)
            best = int(np.argmax(gains))
            best = best if gains[best] > (1 + BETTER) * gains[group] else group
            information.add(best)
            counts[best] += 1
        information.renew(counts)
        if information.criterion > before - ENOUGH:
            break
    return counts
