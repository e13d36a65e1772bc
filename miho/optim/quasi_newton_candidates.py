"""Candidates: configurations that descend together by quasi-Newton steps, from losses alone.

Each is a small state machine: its `stage` determines the losses that it needs next
(`quasi_newton_steps`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from miho.optim.space import Space
from miho.quantities import Array

Indices = NDArray[np.intp]

LOOK, SLOPE, CURVATURE, HESSIAN, TRIAL = range(5)
"""Stages of a candidate that needs: its loss, differences of losses for slopes, for curvatures or
for a Hessian, or the loss of a step."""
WAIT, DONE, STUCK, UNUSABLE = range(5, 9)
"""Stages of a candidate that needs nothing: it has made the steps of its phase, has converged,
finds no step that helps, or has no finite loss."""


@dataclass(frozen=True)
class QNBox:
    """Bounds of the space in search coordinates; steps are shares of the widths."""

    low: Array
    high: Array

    @property
    def width(self) -> Array:
        """Widths, (d,)."""
        return self.high - self.low

    @classmethod
    def of(cls, space: Space) -> QNBox:
        """Box of a space."""
        return cls(*space.bounds)

    def shares(self, z: Array) -> Array:
        """Search coordinates as shares of the widths, (..., d)."""
        return (z - self.low) / self.width

    def at(self, shares: Array) -> Array:
        """Shares of the widths as search coordinates, (..., d)."""
        return self.moved(self.low, shares)

    def moved(self, z: Array, offsets: Array) -> Array:
        """Search coordinates z moved by offsets in shares of the widths, clipped to the bounds."""
        return np.minimum(np.maximum(z + offsets * self.width, self.low), self.high)


@dataclass
class QNCandidates:
    """Candidates of a rung, each with a quadratic model of the loss on the rung's rows.

    Attributes
    ----------
    z : ndarray of shape (n, d)
        Search coordinates.
    loss, g, B : ndarray of shape (n,), (n, d) and (n, d, d)
        Loss, slopes and curvatures, in shares of the widths.
    has_curvature : ndarray of shape (n,)
        Whether B is valid.
    radius : ndarray of shape (n,)
        Longest step along each coordinate.
    stage : ndarray of shape (n,)
        Stage of the state machine.
    step, predicted_gain : ndarray of shape (n, d) and (n,)
        Step on trial, and the decrease of the loss that the model predicts.
    measured_at, measured_g : ndarray of shape (n, d)
        Place and values of the last measured slopes.
    guesses : ndarray of shape (n,)
        Accepted steps since this measurement.
    hessian_age : ndarray of shape (n,)
        Evaluations since the Hessian was measured, inf if it never was.
    steps_left, failures : ndarray of shape (n,)
        Steps left in this phase, and rejected steps since the last accepted one.
    spent_since_mark, loss_at_mark : ndarray of shape (n,)
        Cost of evaluations, without Hessians, and loss at the last mark, to measure progress.
    """

    z: Array
    loss: Array
    g: Array
    B: Array
    has_curvature: NDArray[np.bool_]
    radius: Array
    stage: Indices
    step: Array
    predicted_gain: Array
    measured_at: Array
    measured_g: Array
    guesses: Indices
    hessian_age: Array
    steps_left: Indices
    failures: Indices
    spent_since_mark: Array
    loss_at_mark: Array

    @classmethod
    def at(cls, z: Array, radius: float) -> QNCandidates:
        """New candidates at search coordinates (n, d)."""
        n, d = z.shape
        return cls(
            z=z, loss=np.full(n, np.inf), g=np.zeros((n, d)), B=np.zeros((n, d, d)),
            has_curvature=np.zeros(n, bool), radius=np.full(n, radius), stage=np.full(n, LOOK),
            step=np.zeros((n, d)), predicted_gain=np.full(n, np.inf), measured_at=z.copy(),
            measured_g=np.zeros((n, d)), guesses=np.zeros(n, int), hessian_age=np.full(n, np.inf),
            steps_left=np.zeros(n, int), failures=np.zeros(n, int), spent_since_mark=np.zeros(n),
            loss_at_mark=np.full(n, np.inf),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.z)

    def take(self, index: Indices) -> QNCandidates:
        """Copies of the candidates at these positions, in their order."""
        return QNCandidates(
            **{field.name: getattr(self, field.name)[index] for field in fields(self)}
        )

    def first(self, n: int) -> QNCandidates:
        """Copies of the first n candidates, or of all."""
        return self.take(np.arange(min(n, len(self))))

    @property
    def usable(self) -> QNCandidates:
        """Copies of the candidates with a finite loss, sorted by loss."""
        order = np.argsort(self.loss, kind="stable")
        return self.take(order[self.stage[order] != UNUSABLE])

    def go_on(self, steps: int, index: Indices | slice = slice(None)) -> None:
        """Give waiting candidates at `index` a number of steps; progress is measured from here."""
        self.steps_left[index], self.spent_since_mark[index] = steps, 0.0
        self.loss_at_mark[index] = self.loss[index]
        stage = np.where(self.has_curvature[index], SLOPE, CURVATURE)
        self.stage[index] = np.where(self.stage[index] == WAIT, stage, self.stage[index])

    def rise(self, index: Indices | slice, offsets: Array) -> Array:
        """Predicted increase of the loss at offsets (n, k, d) from a minimum, (n, k).

        Uses the curvatures of the candidates at `index` (n,).
        """
        return np.asarray(0.5 * np.einsum("nki,nij,nkj->nk", offsets, self.B[index], offsets))


@dataclass
class LossRequest:
    """Losses that candidates at `index` (n,) need at a stage, at offsets (n, k, d) from them."""

    stage: int
    index: Indices
    offsets: Array
