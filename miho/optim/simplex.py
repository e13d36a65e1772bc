"""Nelder and Mead's simplex method, one batch at a time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from miho.quantities import Array

FLAT, SMALL = 1e-9, 1e-8
"""The simplex has converged if its losses differ by less than FLAT, relative, or its corners by
less than SMALL, as shares of the box."""
PATIENCE = 10
"""It also ends if its best corner is unchanged after this number times (d + 1) evaluations."""


@dataclass
class Simplex:
    """A simplex in the unit box: corners (d + 1, d), losses (d + 1,), and the next points.

    `batch` has the points whose losses are needed: all corners, the corners of a shrunken simplex,
    or one `trial` point. `reflected` (d,) is the reflection of the worst corner, with its loss.
    `improved` is the evaluation that found the best corner. The coefficients depend on d [1]_;
    standard coefficients fail to descend with more than a few parameters.

    References
    ----------
    .. [1] F. Gao, L. Han, "Implementing the Nelder-Mead simplex algorithm with adaptive
       parameters", Computational Optimization and Applications 51 (2012) 259-277.
    """

    corners: Array
    losses: Array
    batch: Array
    trial: str = "corners"
    reflected: Array = field(default_factory=lambda: np.empty(0))
    reflected_loss: float = np.inf
    evaluations: int = 0
    improved: int = 0

    @classmethod
    def around(cls, point: Array, loss: float, edge: float) -> Simplex:
        """Simplex with a corner at `point` (d,) and edges along the coordinates, into the box."""
        d = point.size
        steps = np.where(point + edge <= 1.0, edge, -edge)
        corners = np.vstack([point, point + np.diag(steps)])
        return cls(corners, np.append(loss, np.full(d, np.inf)), corners[1:])

    @property
    def best(self) -> tuple[Array, float]:
        """The best corner and its loss."""
        k = int(np.argmin(self.losses))
        return self.corners[k], float(self.losses[k])

    @property
    def done(self) -> bool:
        """Whether the simplex is flat, small, or no longer improves."""
        least, spread = self.losses.min(), np.ptp(self.losses)
        stalls = self.evaluations - self.improved >= PATIENCE * len(self.corners)
        small = np.ptp(self.corners, axis=0).max() < SMALL
        return bool(stalls or small or spread <= FLAT * abs(least))

    def tell(self, losses: Array) -> None:
        """Advance with the losses of the batch."""
        self.evaluations += losses.size
        if losses.min() < self.losses.min():
            self.improved = self.evaluations
        if self.trial in ("corners", "shrink"):
            self.losses[1:] = losses
            self._reflect()
            return
        loss, point = float(losses[0]), self.batch[0]
        if self.trial == "reflect":
            self._judge(point, loss)
        elif self.trial == "expand":
            better = loss < self.reflected_loss
            self._replace(point if better else self.reflected, min(loss, self.reflected_loss))
        elif loss < min(self.reflected_loss, self.losses[-1]):
            self._replace(point, loss)
        else:
            first = self.corners[0]
            shrink = 0.5 if first.size == 1 else 1 - 1 / first.size
            self.corners[1:] = first + shrink * (self.corners[1:] - first)
            self.trial, self.batch = "shrink", self.corners[1:].copy()

    def _judge(self, point: Array, loss: float) -> None:
        """Expand, accept or contract the reflection of the worst corner, depending on its loss."""
        self.reflected, self.reflected_loss, d = point, loss, point.size
        if loss < self.losses[0]:
            self._ask("expand", self._middle + (1 + 2 / d) * (self._middle - self.corners[-1]))
        elif loss < self.losses[-2]:
            self._replace(point, loss)
        else:
            outer = point if loss < self.losses[-1] else self.corners[-1]
            contract = 0.5 if d == 1 else 0.75 - 1 / (2 * d)
            self._ask("contract", self._middle + contract * (outer - self._middle))

    def _reflect(self) -> None:
        """Sort the corners, and request the reflection of the worst corner."""
        order = np.argsort(self.losses, kind="stable")
        self.corners, self.losses = self.corners[order], self.losses[order]
        self._ask("reflect", 2 * self._middle - self.corners[-1])

    def _replace(self, point: Array, loss: float) -> None:
        self.corners[-1], self.losses[-1] = point, loss
        self._reflect()

    def _ask(self, trial: str, point: Array) -> None:
        self.trial, self.batch = trial, np.minimum(np.maximum(point, 0.0), 1.0)[None]

    @property
    def _middle(self) -> Array:
        return np.asarray(self.corners[:-1].mean(axis=0))
