"""The records of arrays behind Gauss-Newton descents, for the machine and for Python alike.

A candidate is a configuration that descends: one row of the arrays of `GNCandidates`, and a small
state machine whose `stage` says which evaluation it needs next. Coordinates x are those of the unit
box: 0 and 1 are the bounds of a parameter, and in between it is linear or logarithmic as its scale
is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array, Integers

ENTER, SLOPES, READY, TRIED, RECORD, DONE, AT_KNOWN, UNUSABLE = range(8)
"""Stages. A candidate needs next: the residuals where it is (ENTER), the derivatives there, a step,
the residuals of its trial, or the residuals of a solution whose loss only algebra gave (RECORD). Or
its descent has ended: at a minimum (DONE), on the way to a known one, or without usable values."""
PHASE, LEVEL, SIZE, ACTIVE, STORED = range(5)
"""Where a bracket stands, in the array `place` (5,): its phase; its level; how many candidates it
has, the first ones; how many of them make steps; of how many rows derivatives are stored (0: they
are not)."""
COPY, COPY_LOSS = 0.5, 0.05
"""A candidate is a copy of a better one within this squared distance, in units of d / rows of the
loss, if their losses differ by less than this share."""


class GNCandidates(NamedTuple):
    """The state of n candidates with d parameters, at a level of m rows.

    x, trial (n, d): where each is, and where it looks next. loss (n,): mean square over the level's
    rows. R (n, d, d), q (n, d): the triangular factor of the derivatives J = QR, and Q'r for the
    residuals r. D (n, d): Moré's scales. damping, growth (n,): Nielsen's mu and nu. predicted_gain
    (n,): by how much the linear model says that the trial lowers the sum of squares. sums (n,
    levels): sums of squares over the rows of each level, of the last look at all rows. stage (n,):
    see above; stage_after_record (n,): the stage that follows RECORD. secants (n,): how many times
    running the derivatives were updated (Broyden) instead of evaluated; or CORRECTED, if the trial
    is a corrected one. trials (n,): in this block. spent (n,): rows evaluated. loss_at_mark,
    spent_at_mark (n,): loss and rows at the last mark, from which progress is measured. fading
    (n,): a scale falls by no more than this factor from one step to the next; at 1 it never falls
    (Moré, 1978). projects (n,): whether the linear parameters are solved for at every look.
    derivatives (n, d + 1, m): where Broyden's update needs them, the derivatives by parameter and
    last the residuals; else m = 0.

    All but R and derivatives are views of `numbers` and `counts`, a row for each candidate, because
    a call of the machine takes longer the more arrays it is given.
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
        """A copy of the first, without derivatives."""
        nothing = np.zeros((1, self.x.shape[1] + 1, 0))
        return views(self.numbers[:1].copy(), self.counts[:1].copy(), self.R[:1].copy(), nothing)

    def with_derivatives(self, stored: Array, size: int, m: int) -> GNCandidates:
        """The same with derivatives of m rows of the first `size`, in the numbers `stored`."""
        n = self.x.shape[1] + 1
        derivatives = stored[: size * n * m].reshape((size, n, m))
        return views(*self[:3], derivatives)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copied and pickled as views of four arrays, which a tuple of fields would not stay."""
        return views, self[:4]


def views(numbers: Array, counts: Integers, R: Array, derivatives: Array) -> GNCandidates:
    """The record whose fields are views of `numbers` (n, 4 d + 6 + levels) and `counts` (n, 7)."""
    d = R.shape[1]
    return GNCandidates(
        numbers,
        counts,
        R,
        derivatives,
        numbers[:, :d],
        numbers[:, d : 2 * d],
        numbers[:, 2 * d : 3 * d],
        numbers[:, 3 * d : 4 * d],
        numbers[:, 4 * d],
        numbers[:, 4 * d + 1],
        numbers[:, 4 * d + 2],
        numbers[:, 4 * d + 3],
        numbers[:, 4 * d + 4],
        numbers[:, 4 * d + 5],
        numbers[:, 4 * d + 6 :],
        counts[:, 0],
        counts[:, 1],
        counts[:, 2],
        counts[:, 3],
        counts[:, 4],
        counts[:, 5],
        counts[:, 6],
    )


class GNBox(NamedTuple):
    """A space as the steps need it, d parameters.

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
    """Known minima: x (k, d) in unit coordinates, loss (k,), sums of squares over the rows of each
    level (k, levels), and whether the data determine all parameters there (k,)."""

    x: Array
    loss: Array
    sums: Array
    determined: NDArray[np.bool_]


class GNSettings(NamedTuple):
    """The settings of the search, of the problem and of one bracket, by which its phases go on.

    The first are those of `MIHOGN`. A loss up to `rounding` is 0, derivatives cost `slope_cost`
    evaluations, and residuals are the machine's if `compiled`. Candidates of the bracket have their
    linear parameters solved for if it `projects`, and are `solved` thereby if there are no others.
    A rung costs about `rung_budget` evaluations, a candidate that goes on `allowance` rows, and
    derivatives are stored in `room` numbers at most.
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


class GNRules(NamedTuple):
    """What a block of steps may do.

    The rows are those of `level` (`last`: all). A candidate has at most `steps` trials, none longer
    than `reach` box widths. It is done where the predicted gain is below the share `tolerance` of
    the sum of squares, or its loss is at most `rounding`. Up to `secants` steps running take
    Broyden's derivatives. A candidate that gains less than the share `progress` of its loss over
    `patience` rows crawls: it stops as soon as it has spent `allowance` rows (`patience` 0: never).
    It is on its way to a known minimum within the squared distance `near`, in shares of its sum of
    squares, unless its loss is lower than there by the share `better`; only such minima that the
    data determine are `ending` a descent: elsewhere it may come past and go on.
    """

    level: int
    last: bool
    steps: int
    reach: float
    secants: int
    tolerance: float
    patience: int
    allowance: int
    progress: float
    near: float
    better: float
    ending: bool
    rounding: float
