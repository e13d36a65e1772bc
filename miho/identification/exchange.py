"""Choosing the most informative rows: a greedy choice, improved by exchanges.

Fedorov (Theory of Optimal Experiments, 1972, Ch. 3) exchanges rows of a design for candidates as
long as the determinant of the information grows. Cook and Nachtsheim (Technometrics 22, 1980, p.
315) replace each row in turn by the best candidate, which is as good and much faster. Groups of
rows, for example sweeps, are exchanged as a whole.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

PASSES = 20
"""Largest number of passes through the selection, which is usually stable after two or three."""
BETTER = 1e-9
"""An exchange that gains less than this fraction of the gain of a row is rounding."""
ALONE = 0.999
"""A block with this leverage determines a direction alone."""
ENOUGH = 1e-4
"""A pass is the last one if it lowers the criterion, a logarithm, by less: on a fine grid, rows
would continue to move to neighbours for long."""


class Information:
    """The information on parameters z (r,), and the gain from each block of rows.

    Errors of present estimates and of rows are independent and have unit variance. `blocks`
    (G, k, r) are derivatives with respect to z, with up to k rows in each of G groups; rows of
    zeros pad smaller groups. `target` (r,) is the gradient of the quantity whose variance is
    minimised; None minimises the determinant of the covariance.
    """

    def __init__(self, blocks: Array, target: Array | None = None) -> None:
        self._blocks, self._target = blocks, target
        self._rows = blocks.reshape(-1, blocks.shape[2])
        self.renew(np.zeros(len(blocks), dtype=np.intp))

    def renew(self, counts: NDArray[np.intp]) -> None:
        """Restart with each block added `counts` (G,) times, which removes accumulated rounding."""
        used = np.flatnonzero(counts)
        rows = np.sqrt(counts[used])[:, None, None] * self._blocks[used]
        rows = rows.reshape(-1, self._blocks.shape[2])
        _, s, Vt = np.linalg.svd(rows, full_matrices=len(rows) < rows.shape[1])
        variances = np.ones(len(Vt))
        variances[: s.size] = 1 / (1 + s**2)
        self._covariance = (Vt.T * variances) @ Vt
        projected = self._blocks @ self._covariance
        self._predicted = projected @ self._blocks.transpose(0, 2, 1)
        if self._target is not None:
            self._by_target = projected @ self._target

    @property
    def criterion(self) -> float:
        """The minimised quantity: ln of the determinant of the covariance, or of the variance."""
        if self._target is None:
            return float(np.linalg.slogdet(self._covariance)[1])
        return math.log(float(self._target @ self._covariance @ self._target))

    def gains(self) -> Array:
        """The gain from each block (G,): in ln of the determinant, or the fall of the variance."""
        k = self._blocks.shape[1]
        measured = self._predicted + np.eye(k)
        if self._target is None:
            logarithms = np.log(measured[:, 0, 0]) if k == 1 else np.linalg.slogdet(measured)[1]
            return np.asarray(logarithms)
        if k == 1:
            return np.asarray(self._by_target[:, 0] ** 2 / measured[:, 0, 0])
        solved = np.linalg.solve(measured, self._by_target[:, :, None])[:, :, 0]
        return np.asarray((self._by_target * solved).sum(axis=1))

    def needs(self, group: int) -> bool:
        """Whether a block alone determines a direction, so `add` would not remove it exactly."""
        return bool(np.linalg.norm(self._predicted[group], 2) > ALONE)

    def add(self, group: int, sign: int = 1) -> None:
        """Add a block, or remove it with sign -1 (Sherman, Morrison and Woodbury)."""
        block = self._blocks[group]
        projected = self._covariance @ block.T
        inverse = np.linalg.inv(sign * np.eye(len(block)) + block @ projected)
        self._covariance = self._covariance - projected @ inverse @ projected.T
        # Covariances of all predictions (G, k) with the predictions of the block.
        shared = (self._rows @ projected).reshape(*self._blocks.shape[:2], -1)
        if self._target is not None:
            self._by_target = self._by_target - shared @ (inverse @ self._by_target[group])
        self._predicted = self._predicted - np.einsum("gkm,glm->gkl", shared @ inverse, shared)


def best_groups(
    blocks: Array, size: int, target: Array | None = None, repeats: int = 1
) -> NDArray[np.intp]:
    """Number of times (G,) to choose each group: `size` in total, each at most `repeats` times.

    `Information` documents `blocks` and `target`. The result is a local optimum: no exchange of one
    group for another gains much. Single rows may say little about a target, so the result is then
    the better of two: from rows added for the target, and from rows added for all parameters.
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
    """Add `size` groups, each time the best one."""
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
    """Replace each group in turn by the best one, until that gains hardly anything."""
    counts = counts.copy()
    information.renew(counts)
    for _ in range(PASSES):
        before = information.criterion
        for group in np.repeat(np.arange(len(counts)), counts).tolist():
            counts[group] -= 1
            if information.needs(group):
                information.renew(counts)
            else:
                information.add(group, -1)
            gains = np.where(counts < repeats, information.gains(), -np.inf)
            best = int(np.argmax(gains))
            best = best if gains[best] > (1 + BETTER) * gains[group] else group
            information.add(best)
            counts[best] += 1
        information.renew(counts)
        if information.criterion > before - ENOUGH:
            break
    return counts
