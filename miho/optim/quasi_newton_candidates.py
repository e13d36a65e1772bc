"""Candidates: configurations that descend side by side by quasi-Newton steps, from losses alone.

Each is a small state machine: its `stage` says which losses it needs next (`quasi_newton_steps`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from miho.optim.space import Space
from miho.quantities import Array

Indices = NDArray[np.intp]

LOOK, SLOPE, CURVATURE, HESSIAN, TRIAL = range(5)
"""Stages. A candidate needs next: the loss where it is, differences of losses for slopes, for
curvatures or for a Hessian, or the loss of a step."""
WAIT, DONE, STUCK, UNUSABLE = range(5, 9)
"""Or nothing: it has had the steps of its phase, has converged, finds no step that helps, or has no
finite loss."""


@dataclass(frozen=True)
class QNBox:
    """The space's box in search coordinates; steps are shares of its widths."""

    low: Array
    high: Array

    @property
    def width(self) -> Array:
        """The widths, (d,)."""
        return self.high - self.low

    @classmethod
    def of(cls, space: Space) -> QNBox:
        """The box of a space."""
        return cls(*space.bounds)

    def shares(self, z: Array) -> Array:
        """Search coordinates as shares of the widths, (..., d)."""
        return (z - self.low) / self.width

    def at(self, shares: Array) -> Array:
        """Shares of the widths as search coordinates, (..., d)."""
        return self.moved(self.low, shares)

    def moved(self, z: Array, offsets: Array) -> Array:
        """Where offsets in shares of the widths lead from z, kept in the box."""
        return np.minimum(np.maximum(z + offsets * self.width, self.low), self.high)


@dataclass
class QNCandidates:
    """The candidates of a rung, each with its quadratic model of the loss on the rung's rows.

    z (n, d) in search coordinates, loss (n,); slopes g (n, d) and curvatures B (n, d, d) in shares
    of the widths, B valid only with `has_curvature` (n,). step (n, d): on trial; predicted_gain
    (n,): by how much the model says that it lowers the loss; radius (n,): the longest step along
    each coordinate. measured_at, measured_g (n, d): where slopes were measured last, and what they
    were. guesses (n,): steps accepted since. hessian_age (n,): evaluations since the Hessian was
    measured, inf if it never was. steps_left (n,): in this phase. failures (n,): steps refused
    since one was accepted. spent_since_mark (n,): cost of all evaluations but those of Hessians
    since the loss was `loss_at_mark` (n,), from which progress is measured.
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
        """Copies of those at these positions, in their order."""
        return QNCandidates(
            **{field.name: getattr(self, field.name)[index] for field in fields(self)}
        )

    def first(self, n: int) -> QNCandidates:
        """Copies of the first n, at most all."""
        return self.take(np.arange(min(n, len(self))))

    @property
    def usable(self) -> QNCandidates:
        """Copies of those with a finite loss, in the order of their losses."""
        order = np.argsort(self.loss, kind="stable")
        return self.take(order[self.stage[order] != UNUSABLE])

    def go_on(self, steps: int, index: Indices | slice = slice(None)) -> None:
        """Let those at `index` that wait make so many steps; progress is measured from here."""
        self.steps_left[index], self.spent_since_mark[index] = steps, 0.0
        self.loss_at_mark[index] = self.loss[index]
        stage = np.where(self.has_curvature[index], SLOPE, CURVATURE)
        self.stage[index] = np.where(self.stage[index] == WAIT, stage, self.stage[index])

    def rise(self, index: Indices | slice, offsets: Array) -> Array:
        """By how much the loss rises at offsets (n, k, d) from a minimum, (n, k).

        By the curvatures of the candidates at `index` (n,).
        """
        return np.asarray(0.5 * np.einsum("nki,nij,nkj->nk", offsets, self.B[index], offsets))


@dataclass
class LossRequest:
    """Losses that candidates at `index` (n,) need at a stage: at offsets (n, k, d) from them."""

    stage: int
    index: Indices
    offsets: Array
