"""Where Gauss-Newton descents stand: records of arrays, for compiled code and for Python alike.

A configuration is a row of the arrays of `Candidates` and a small state machine: its `stage` says
which evaluation it needs next. Coordinates x are those of the unit box: x = 0 and 1 are the bounds
of a parameter, on a log scale in between where the space says so.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from miho.quantities import Array

Whole = NDArray[np.int64]

ENTER, SLOPES, READY, TRIED, RECORD, DONE, KNOWN, UNUSABLE = range(8)
"""What a configuration needs next: the residuals where it is, its derivatives, a step, the
residuals of its trial, those of a solution that is known by algebra so far; or how it ended: at a
minimum, on the way to a known one, without usable values."""
COPY, COPY_LOSS = 0.5, 0.05
"""A near copy of a better one: squared distance in units of d / rows of the loss, and by how much
the losses differ."""


class Candidates(NamedTuple):
    """The state of n configurations at one level of rows, d parameters and m rows.

    x, trial (n, d): where it is, and where it looks next. loss (n,): mean square over the level's
    rows. R (n, d, d), q (n, d): of the QR factors of the derivatives, and Q'r. D (n, d): scales.
    damping, growth (n,): Nielsen's mu and nu. gain (n,): the predicted fall of the sum of squares.
    marked (n,): the loss at the last mark. sums (n, levels): sums of squares over the rows of each
    level, where all rows were looked at. stage, after (n,): what it needs, and what behind RECORD.
    secants, steps (n,): Broyden's derivatives running, and trials of this block. spent, mark (n,):
    rows evaluated, and how many at the last mark. projects (n,): whether the linear parameters are
    solved for at every look. rows (n, d + 1, m): derivatives and residuals where Broyden's update
    needs them, else of m = 0.

    All but R and rows are views of `numbers` and `counts`, a row for each configuration, because
    compiled code is called the faster the fewer arrays it is given.
    """

    numbers: Array
    counts: Whole
    R: Array
    rows: Array
    x: Array
    trial: Array
    q: Array
    D: Array
    loss: Array
    damping: Array
    growth: Array
    gain: Array
    marked: Array
    sums: Array
    stage: Whole
    after: Whole
    secants: Whole
    steps: Whole
    spent: Whole
    mark: Whole
    projects: Whole

    @classmethod
    def at(cls, x: Array, levels: int, damping: float, projects: bool) -> Candidates:
        """New configurations at unit coordinates (n, d)."""
        n, d = x.shape
        numbers, counts = np.zeros((n, 4 * d + 5 + levels)), np.zeros((n, 7), np.int64)
        c = _of(numbers, counts, np.zeros((n, d, d)), np.zeros((n, d + 1, 0)))
        c.x[:] = c.trial[:] = x
        c.loss[:] = c.gain[:] = np.inf
        c.damping[:], c.growth[:] = damping, 2.0
        c.stage[:], c.projects[:] = ENTER, projects
        return c

    def take(self, which: Any) -> Candidates:
        """Some of them, in this order."""
        return _of(*(array[which] for array in self[:4]))

    def beside(self, others: Candidates) -> Candidates:
        """These and others."""
        pairs = zip(self[:4], others[:4], strict=True)
        return _of(*(np.concatenate(pair) for pair in pairs))

    def with_rows(self, m: int) -> Candidates:
        """The same with room for m rows."""
        n, d = self.x.shape
        return self._replace(rows=np.zeros((n, d + 1, m)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Copied and pickled as what it is: views of a few arrays."""
        return _of, self[:4]


def _of(numbers: Array, counts: Whole, R: Array, rows: Array) -> Candidates:
    """By a name that pickle finds."""
    return views(numbers, counts, R, rows)


def views(numbers: Array, counts: Whole, R: Array, rows: Array) -> Candidates:
    """Configurations whose numbers stand beside each other."""
    d = R.shape[1]
    return Candidates(
        numbers,
        counts,
        R,
        rows,
        numbers[:, :d],
        numbers[:, d : 2 * d],
        numbers[:, 2 * d : 3 * d],
        numbers[:, 3 * d : 4 * d],
        numbers[:, 4 * d],
        numbers[:, 4 * d + 1],
        numbers[:, 4 * d + 2],
        numbers[:, 4 * d + 3],
        numbers[:, 4 * d + 4],
        numbers[:, 4 * d + 5 :],
        counts[:, 0],
        counts[:, 1],
        counts[:, 2],
        counts[:, 3],
        counts[:, 4],
        counts[:, 5],
        counts[:, 6],
    )


class Box(NamedTuple):
    """A space as compiled code needs it: bounds in units, in search coordinates, and log scales."""

    low: Array
    high: Array
    origin: Array
    width: Array
    log: NDArray[np.bool_]
    linear: Whole
    nonlinear: Whole


class Minima(NamedTuple):
    """The minima found so far: where (k, d), and their losses over the rows of the level (k,)."""

    x: Array
    loss: Array


class Rules(NamedTuple):
    """What a block of steps may do.

    On the rows of `level` (`last`: all) at most `steps` trials for each configuration, none longer
    than `reach` box widths; done where the predicted relative gain is below `tolerance`, or a loss
    is `nothing`. Up to `secants` steps running take Broyden's derivatives. A configuration that
    gains less than the share `progress` over `patience` rows is crawling, and is left once it has
    had `share` rows (`patience` 0: never). `near` is the squared distance, in shares of the sum of
    squares, within which a configuration is on its way to a known minimum, unless it is better by
    the share `better`.
    """

    level: int
    last: bool
    steps: int
    reach: float
    secants: int
    tolerance: float
    patience: int
    share: int
    progress: float
    near: float
    better: float
    nothing: float
