"""Records of arrays for Gauss-Newton descents, shared by the machine and Python.

A candidate is a configuration that descends: one row of the arrays of `GNCandidates`, and a small
state machine whose `stage` determines its next evaluation. Coordinates x are in the unit box: 0 and
1 are the bounds of a parameter, with a linear or logarithmic scale in between.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array, Integers

ENTER, SLOPES, READY, TRIED, RECORD, DONE, AT_KNOWN, UNUSABLE = range(8)
"""Stages. The candidate needs: residuals at its position (ENTER), derivatives there, a step,
residuals of its trial, or residuals of a solution whose loss is known by algebra only (RECORD). The
last three are ends: at a minimum (DONE), on the way to a known one, or without usable values."""
PHASE, LEVEL, SIZE, ACTIVE, STORED = range(5)
"""Position of a bracket, in the array `place` (5,): its phase; its level; the number of its
candidates, which come first; the number that make steps; the number of rows with stored derivatives
(0 for none)."""
COPY, COPY_LOSS = 0.5, 0.05
"""A candidate is a copy of a better one within this squared distance, in units of d / rows of the
loss, if their losses differ by less than this share."""
INSIDE = 1e-12
"""A linear parameter closer to a bound than this share of the width is at the bound."""


class GNCandidates(NamedTuple):
    """State of n candidates with d parameters, at a level of m rows.

    All fields but R and derivatives are views of `numbers` and `counts`, a row for each candidate,
    because every array argument makes a call of the machine slower.

    Attributes
    ----------
    x, trial : ndarray of shape (n, d)
        Position and next trial, in unit coordinates.
    loss : ndarray of shape (n,)
        Mean square over the rows of the level.
    R, q : ndarray of shape (n, d, d) and (n, d)
        Triangular factor of the derivatives J = QR, and Q'r of the residuals r.
    D : ndarray of shape (n, d)
        Moré's scales.
    damping, growth : ndarray of shape (n,)
        Nielsen's mu and nu.
    predicted_gain : ndarray of shape (n,)
        Decrease of the sum of squares at the trial that the linear model predicts.
    sums : ndarray of shape (n, levels)
        Sums of squares over the rows of each level, from the last evaluation of all rows.
    stage, stage_after_record : ndarray of shape (n,)
        Stage, and the stage that follows RECORD.
    secants : ndarray of shape (n,)
        Consecutive Broyden updates of the derivatives, or CORRECTED for a corrected trial.
    trials, spent : ndarray of shape (n,)
        Trials in this block, and rows evaluated.
    loss_at_mark, spent_at_mark : ndarray of shape (n,)
        Loss and rows at the last mark, to measure progress.
    fading : ndarray of shape (n,)
        Smallest factor by which a scale decreases per step; 1 for never (Moré, 1978).
    projects : ndarray of shape (n,)
        Whether the linear parameters are solved at every evaluation.
    derivatives : ndarray of shape (n, d + 1, m)
        Derivatives by parameter, and the residuals last, for Broyden updates; else m = 0.
    """

    numbers: Array
    counts: Integers
    R: Array
    derivatives: Array
    x: Array
    trial: Array
    q: Array
    D: Array
    loss: Array
    damping: Array
    growth: Array
    predicted_gain: Array
    loss_at_mark: Array
    fading: Array
    sums: Array
    stage: Integers
    stage_after_record: Integers
    secants: Integers
    trials: Integers
    spent: Integers
    spent_at_mark: Integers
    projects: Integers

    @classmethod
    def at(
        cls, x: Array, levels: int, damping: float, fading: float, projects: bool
    ) -> GNCandidates:
        """New candidates at unit coordinates (n, d)."""
        n, d = x.shape
        numbers, counts = np.zeros((n, 4 * d + 6 + levels)), np.zeros((n, 7), np.int64)
        numbers[:, :d] = numbers[:, d : 2 * d] = x
        numbers[:, 4 * d : 4 * d + 6] = np.inf, damping, 2.0, np.inf, 0.0, fading
        counts[:, 0], counts[:, 6] = ENTER, projects
        return views(numbers, counts, np.zeros((n, d, d)), np.zeros((n, d + 1, 0)))

    def first(self) -> GNCandidates:
        """Copy of the first candidate, without derivatives."""
        nothing = np.zeros((1, self.x.shape[1] + 1, 0))
        return views(self.numbers[:1].copy(), self.counts[:1].copy(), self.R[:1].copy(), nothing)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle as views of four arrays, which separate fields would not remain."""
        return views, self[:4]


def views(numbers: Array, counts: Integers, R: Array, derivatives: Array) -> GNCandidates:
    """Record whose fields are views of `numbers` (n, 4 d + 6 + levels) and `counts` (n, 7)."""
    d = R.shape[1]
    vectors = (numbers[:, k * d : (k + 1) * d] for k in range(4))
    scalars, sums = numbers[:, 4 * d : 4 * d + 6].T, numbers[:, 4 * d + 6 :]
    return GNCandidates._make(
        [numbers, counts, R, derivatives, *vectors, *scalars, sums, *counts.T]
    )


class GNBox(NamedTuple):
    """A space in the form that steps need, with d parameters.

    low, high (d,): bounds in units. origin, width (d,): lower bounds and widths in search
    coordinates. log (d,): whether a scale is logarithmic. linear, nonlinear: positions of the
    parameters in which the residuals are linear, and of all others.
    """

    low: Array
    high: Array
    origin: Array
    width: Array
    log: NDArray[np.bool_]
    linear: Integers
    nonlinear: Integers


class Minima(NamedTuple):
    """Known minima.

    They have x (k, d) in unit coordinates, loss (k,), sums of squares over the rows of each level
    (k, levels), and whether the data determine all parameters there (k,).
    """

    x: Array
    loss: Array
    sums: Array
    determined: NDArray[np.bool_]


class GNSettings(NamedTuple):
    """Settings of the search, of the problem and of one bracket.

    The first fields are settings of `MIHOGN`.

    Attributes
    ----------
    rounding : float
        Largest loss that counts as 0.
    slope_cost : int
        Cost of derivatives, in evaluations.
    compiled : bool
        Whether the machine evaluates the residuals.
    projects, solved : bool
        Whether linear parameters are solved at every evaluation, and whether there are no others.
    rung_budget : float
        Evaluations of a rung, about.
    allowance : int
        Rows for a candidate that continues.
    room : int
        Largest number of stored derivatives.
    """

    eta: int
    steps: int
    lead: int
    reach: float
    secants: int
    tolerance: float
    level_tolerance: float
    digits: float
    patience: float
    progress: float
    rounding: float
    slope_cost: int
    compiled: bool
    projects: bool
    solved: bool
    rung_budget: float
    allowance: int
    room: int
