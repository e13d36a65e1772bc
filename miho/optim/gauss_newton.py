"""Levenberg-Marquardt steps of many configurations side by side, compiled.

A configuration is a row of the arrays of `Candidates` and a small state machine: its `stage` says
which evaluation it needs next, and a step is what follows from that evaluation. So one set of rules
serves a model that is compiled, whose steps are made here without Python in between, and any other,
whose residuals and derivatives come from outside; and whatever is cut off between two evaluations
goes on as if it had not been.

Coordinates x are those of the unit box: x = 0 and 1 are the bounds of a parameter, on a log scale
in between where the space says so.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from miho.optim.oracle import Block, BudgetExhausted, Oracle, UnusableValueError
from miho.optim.space import Space
from miho.optim.triangular import Room, allocating, compiled, fold, solve_in_box, square_sum

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

ENTER, SLOPES, READY, TRIED, RECORD, DONE, KNOWN, UNUSABLE = range(8)
"""What a configuration needs next: the residuals where it is, its derivatives, a step, the
residuals of its trial, those of a solution that is known by algebra so far; or how it ended: at a
minimum, on the way to a known one, without usable values."""
EVENTS = 4096
"""Looks at all rows in one block, each of which may improve."""
FINISHED, PAUSED = range(2)
"""Whether a block of steps was done to its end, or the next evaluation is beyond its allowance."""

CHUNK = 512
"""Rows at a time: their derivatives stay in the first-level cache."""
ACCEPTED, GOOD, POOR = 1e-4, 0.75, 0.25
"""Gain over predicted gain: above the first a trial is taken; above the second the damping falls,
below the third it grows (Marquardt, 1963; Moré, 1978)."""
LESS, MORE = 0.1, 2.0
"""Factors of the damping after a good and after a poor step; after failures Nielsen's (1999), which
double each time."""
SMALLEST_DAMPING, LARGEST_DAMPING = 1e-12, 1e12
FADING = 0.3
"""A scale D_j falls by no more than this factor from one step to the next."""
SECANT = 0.7
"""Where the gain is more than this share of the predicted one the next derivatives are Broyden's,
a few times running: they cost nothing."""
TRIES = 12


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
    return cast(Candidates, views.py_func(numbers, counts, R, rows))


@allocating
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

    @classmethod
    def of(cls, space: Space, linear: tuple[str, ...]) -> Box:
        """The box of a space whose residuals are linear in these parameters."""
        low, high = space.bounds
        names = space.names
        return cls(
            space.low,
            space.high,
            low,
            high - low,
            np.array([p.scale == "log" for p in space.parameters]),
            np.array([names.index(name) for name in linear], dtype=np.int64),
            np.array([k for k, name in enumerate(names) if name not in linear], dtype=np.int64),
        )


class Minima(NamedTuple):
    """The minima found so far: where (k, d), and their losses over the rows of the level (k,)."""

    x: Array
    loss: Array


class Rules(NamedTuple):
    """What a block of steps may do.

    On the rows of `level` (`last`: all) at most `steps` trials for each configuration, none longer
    than `reach` box widths; done where the predicted relative gain is below `tolerance`, or a loss
    is `nothing`. A configuration that gains
    less than the share `progress` over `patience` rows is crawling, and is left once it has had
    `share` rows (`patience` 0: never). `near` is the squared distance, in shares of the sum of squares, within
    which a configuration is on its way to a known minimum, unless it is better by the share
    `better`.
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


class Work(NamedTuple):
    """Room for one configuration: residuals (m,), rows of a chunk, factors, a step."""

    theta: Array
    step: Array
    low: Array
    high: Array
    scale: Array
    sums: Array
    T: Array
    chunk: Array
    slopes: Array
    residuals: Array
    room: Room


@allocating
def work(d: int, m: int, levels: int) -> Work:
    """Room for d parameters, m residuals and levels of rows."""
    return Work(
        np.empty(d),
        np.empty(d),
        np.empty(d),
        np.empty(d),
        np.empty(d),
        np.zeros(levels),
        np.zeros((d + 1, d + 1)),
        np.empty((d + 1, CHUNK)),
        np.empty((d, CHUNK)),
        np.empty(m),
        Room(np.empty(d), np.empty(d), np.empty((d + 1, 2 * d)), np.empty((d + 1, d + 1))),
    )


@compiled
def to_units(x: Array, box: Box, theta: Array) -> None:
    """The configuration in units at unit coordinates (d,)."""
    for k in range(x.size):
        value = box.origin[k] + box.width[k] * x[k]
        if box.log[k]:
            value = math.exp(value)
        theta[k] = min(max(value, box.low[k]), box.high[k])


@compiled
def factored(c: Candidates, i: int, box: Box, w: Work) -> None:
    """Take the factor of the derivatives and residuals where a configuration is, from w.T.

    Its columns are the parameters and the residuals, or, where the linear ones are projected out,
    first those of them that are free: what is left of the others is Kaufman's (1975) Jacobian.
    """
    d = c.x.shape[1]
    n, first = d, 0
    if c.projects[i]:
        n = box.nonlinear.size
        for k in box.linear:
            first += is_free(c.x[i, k])
    R, q, D = c.R[i], c.q[i], c.D[i]
    fine, largest = True, 0.0
    for k in range(n):
        square = 0.0
        for j in range(n):
            R[j, k] = w.T[first + j, first + k] if j <= k else 0.0
            square += R[j, k] * R[j, k]
        q[k] = w.T[first + k, first + n]
        D[k] = max(math.sqrt(square), FADING * D[k])
        largest = max(largest, D[k])
        fine = fine and math.isfinite(D[k]) and math.isfinite(q[k])
    for k in range(n):
        D[k] = max(D[k], 1e-10 * largest)
    c.stage[i] = READY if fine and (largest > 0 or n == 0) else UNUSABLE
    if n and largest == 0:
        c.stage[i] = DONE


@compiled
def clear(T: Array) -> None:
    """Make all numbers 0."""
    for j in range(T.shape[0]):
        for k in range(T.shape[1]):
            T[j, k] = 0.0


@compiled
def copy(these: Array, to: Array) -> None:
    """Copy numbers."""
    for k in range(these.size):
        to[k] = these[k]


@compiled
def is_free(x: float) -> bool:
    """Whether a coordinate is off the bounds."""
    return 1e-12 < x < 1 - 1e-12


@compiled
def looked(c: Candidates, i: int, loss: float, box: Box, m: int, rules: Rules, w: Work) -> None:
    """What follows from the loss of a configuration's trial, whose residuals are in w."""
    d = c.x.shape[1]
    if c.stage[i] == ENTER:
        copy(c.trial[i], c.x[i])
        c.loss[i] = loss
        c.stage[i] = SLOPES if math.isfinite(loss) else UNUSABLE
        c.marked[i], c.mark[i] = loss, c.spent[i]
        keep_residuals(c, i, m, w)
        return
    c.steps[i] += 1
    actual = (c.loss[i] - loss) * m
    rho = actual / c.gain[i] if c.gain[i] > 0 and math.isfinite(loss) else -1.0
    if rho > ACCEPTED:
        secant = (
            rho > SECANT
            and c.secants[i] < rules.secants
            and c.rows.shape[2] > 0
            and not c.projects[i]
        )
        if secant:
            broyden(c, i, m, w)
        else:
            keep_residuals(c, i, m, w)
        copy(c.trial[i], c.x[i])
        c.loss[i] = loss
        if rho > GOOD:
            c.damping[i] = max(LESS * c.damping[i], SMALLEST_DAMPING)
        elif rho < POOR:
            c.damping[i] *= MORE
        c.growth[i] = 2.0
        c.stage[i] = SLOPES
        if secant:
            c.secants[i] += 1
            refold(c.rows[i], d, d, m, w)
            factored(c, i, box, w)
            if c.stage[i] == UNUSABLE:
                c.stage[i], c.secants[i] = SLOPES, 0
        if loss <= rules.nothing:
            c.stage[i] = DONE
    elif c.secants[i]:
        c.stage[i], c.secants[i] = SLOPES, 0
    else:
        c.damping[i] = max(c.damping[i] * c.growth[i], 1e-6)
        c.growth[i] *= 2.0
        c.stage[i] = DONE if c.damping[i] > LARGEST_DAMPING else READY


@compiled
def keep_residuals(c: Candidates, i: int, m: int, w: Work) -> None:
    """Keep the residuals where a configuration is, if there is room."""
    if c.rows.shape[2]:
        d = c.x.shape[1]
        for row in range(m):
            c.rows[i, d, row] = w.residuals[row]


@compiled
def broyden(c: Candidates, i: int, m: int, w: Work) -> None:
    """Broyden's update of the derivatives, in the metric of the scales, for the accepted trial."""
    d = c.x.shape[1]
    rows, x, trial, D = c.rows[i], c.x[i], c.trial[i], c.D[i]
    total = 0.0
    for k in range(d):
        w.step[k] = trial[k] - x[k]
        total += (D[k] * w.step[k]) ** 2
    for row in range(m):
        missing = w.residuals[row] - rows[d, row]
        for k in range(d):
            missing -= rows[k, row] * w.step[k]
        missing /= total
        for k in range(d):
            rows[k, row] += missing * D[k] * D[k] * w.step[k]
        rows[d, row] = w.residuals[row]


@compiled
def refold(rows: Array, count: int, last: int, m: int, w: Work) -> None:
    """The factor of the first columns of rows (., m) and of the last one, into w.T."""
    clear(w.T)
    for start in range(0, m, CHUNK):
        size = min(CHUNK, m - start)
        for k in range(count + 1):
            column = rows[k if k < count else last]
            for row in range(size):
                w.chunk[k, row] = column[start + row]
        fold(w.T, w.chunk, size, count + 1)


@compiled
def step(c: Candidates, i: int, box: Box, m: int, rules: Rules, w: Work) -> None:
    """The next trial of a configuration whose derivatives are known; or it is done."""
    d = c.x.shape[1]
    n = box.nonlinear.size if c.projects[i] else d
    x, trial = c.x[i], c.trial[i]
    if n == 0:
        c.stage[i], c.gain[i] = DONE, 0.0
        return
    low, high, scale = w.low, w.high, w.scale
    for k in range(n):
        at = x[box.nonlinear[k]] if c.projects[i] else x[k]
        low[k], high[k] = max(-at, -rules.reach), min(1 - at, rules.reach)
    total = c.loss[i] * m
    before = 0.0
    for k in range(n):
        before += c.q[i, k] * c.q[i, k]
    for _ in range(TRIES):
        root = math.sqrt(c.damping[i])
        for k in range(n):
            scale[k] = root * c.D[i, k]
        solve_in_box(c.R[i], c.q[i], scale, low, high, n, w.step, w.room)
        after = 0.0
        for row in range(n):
            value = c.q[i, row]
            for k in range(row, n):
                value += c.R[i, row, k] * w.step[k]
            after += value * value
        gain = before - after
        c.gain[i] = gain
        predicted = gain / total if total > 0 else 0.0
        if predicted > rules.tolerance:
            break
        if c.damping[i] <= 1e-3 or predicted <= 1e-3 * rules.tolerance:
            c.stage[i] = DONE
            if c.secants[i] and rules.last:
                c.stage[i], c.secants[i] = SLOPES, 0
            return
        c.damping[i] *= 0.1
    for k in range(d):
        trial[k] = x[k]
    moved = False
    for k in range(n):
        at = box.nonlinear[k] if c.projects[i] else k
        trial[at] = min(max(x[at] + w.step[k], 0.0), 1.0)
        moved = moved or trial[at] != x[at]
    c.stage[i] = TRIED if moved else DONE


@compiled
def known(c: Candidates, i: int, box: Box, m: int, minima: Minima, rules: Rules) -> bool:
    """Whether a configuration is on its way to a minimum that is known, in the metric of R'R."""
    n = box.nonlinear.size if c.projects[i] else c.x.shape[1]
    for a in range(minima.x.shape[0]):
        if c.loss[i] < minima.loss[a] * (1 - rules.better):
            continue
        distance = 0.0
        for row in range(n):
            value = 0.0
            for k in range(row, n):
                at = box.nonlinear[k] if c.projects[i] else k
                value += c.R[i, row, k] * (c.x[i, at] - minima.x[a, at])
            distance += value * value
        if distance <= rules.near * c.loss[i] * m:
            return True
    return False


@compiled
def prepare(c: Candidates, i: int, box: Box, m: int, minima: Minima, rules: Rules, w: Work) -> bool:
    """Bring a configuration to its next evaluation; false where it needs none in this block."""
    while c.stage[i] == SLOPES or c.stage[i] == READY:
        if c.stage[i] == READY and known(c, i, box, m, minima, rules):
            c.stage[i] = KNOWN
        elif c.steps[i] >= rules.steps or crawls(c, i, rules):
            return False
        elif c.stage[i] == SLOPES:
            return True
        else:
            step(c, i, box, m, rules, w)
    return bool(c.stage[i] < DONE)


@compiled
def crawls(c: Candidates, i: int, rules: Rules) -> bool:
    """Whether a configuration gains little for what it costs, and has had its share."""
    if rules.patience == 0 or c.spent[i] - c.mark[i] < rules.patience:
        return False
    if c.loss[i] > (1 - rules.progress) * c.marked[i]:
        return bool(c.spent[i] >= rules.share)
    c.mark[i], c.marked[i] = c.spent[i], c.loss[i]
    return False


@compiled
def solve_linear(c: Candidates, i: int, box: Box, m: int, w: Work) -> float:
    """Move a trial to its best linear parameters; the loss there, by algebra.

    w.T is the factor of their columns, in box widths, and of the residuals at w.theta.
    """
    p = box.linear.size
    for j in range(p + 1):
        for k in range(j, p + 1):
            if not math.isfinite(w.T[j, k]):
                return math.inf
    q = w.T[:, p]
    for j in range(p):
        k = box.linear[j]
        width = box.high[k] - box.low[k]
        w.scale[j] = 0.0
        w.low[j] = (box.low[k] - w.theta[k]) / width
        w.high[j] = (box.high[k] - w.theta[k]) / width
    rest = w.T[p, p] * w.T[p, p]
    solve_in_box(w.T, q, w.scale, w.low, w.high, p, w.step, w.room)
    for row in range(p):
        value = q[row]
        for k in range(row, p):
            value += w.T[row, k] * w.step[k]
        rest += value * value
    for j in range(p):
        k = box.linear[j]
        value = w.theta[k] + (box.high[k] - box.low[k]) * w.step[j]
        value = min(max(value, box.low[k]), box.high[k])
        if box.log[k]:
            value = math.log(value)
        c.trial[i, k] = min(max((value - box.origin[k]) / box.width[k], 0.0), 1.0)
    return rest / m


@compiled
def evaluated(
    c: Candidates, i: int, loss: float, box: Box, m: int, rules: Rules, best: float, w: Work
) -> None:
    """What follows from the residuals of a trial, with the loss that they or algebra gave.

    A solution for the linear parameters on all rows is known by algebra only: an improvement is
    looked at once more, and so recorded.
    """
    if c.stage[i] == RECORD:
        c.stage[i] = c.after[i]
        copy(w.sums, c.sums[i])
        return
    before = c.loss[i]
    looked(c, i, loss, box, m, rules, w)
    if c.projects[i]:
        if rules.last and c.loss[i] < before and c.loss[i] < best * (1 - 1e-9):
            c.after[i] = c.stage[i]
            c.stage[i] = RECORD
    elif c.loss[i] < before:
        copy(w.sums, c.sums[i])


@compiled
def look(residuals: Any, X: Array, y: Array, ends: Whole, m: int, keep: bool, w: Work) -> float:
    """The sum of squares at w.theta over m rows, and in w.sums over those of each level."""
    total, start = 0.0, 0
    for level in range(ends.size):
        end = min(ends[level], m)
        while start < end:
            count = min(CHUNK, end - start)
            r = w.residuals[start : start + count] if keep else w.residuals[:count]
            residuals(w.theta, X, y, start, start + count, r)
            total += square_sum(r, count)
            start += count
        w.sums[level] = total
    return total


@compiled
def fill(
    residuals: Any,
    slopes: Any,
    X: Array,
    y: Array,
    c: Candidates,
    i: int,
    box: Box,
    m: int,
    only_linear: bool,
    w: Work,
) -> None:
    """The factor of derivatives and residuals at w.theta, into w.T, one chunk after the other.

    Of the linear parameters alone, in box widths; or of all in unit coordinates, as `factored`
    takes them.
    """
    d = w.theta.size
    keep = c.rows.shape[2] > 0 and not c.projects[i]
    J, chunk = w.slopes, w.chunk
    clear(w.T)
    for start in range(0, m, CHUNK):
        count = min(CHUNK, m - start)
        slopes(w.theta, X, start, start + count, J)
        n = 0
        if only_linear or c.projects[i]:
            for k in box.linear:
                if only_linear or is_free(c.x[i, k]):
                    column(J[k], box.high[k] - box.low[k], count, chunk[n])
                    n += 1
        if not only_linear:
            for k in range(d):
                if c.projects[i] and is_linear(k, box):
                    continue
                width = box.width[k] * (w.theta[k] if box.log[k] else 1.0)
                column(J[k], width, count, chunk[n])
                if keep:
                    for row in range(count):
                        c.rows[i, k, start + row] = chunk[n, row]
                n += 1
        if keep:
            for row in range(count):
                chunk[n, row] = c.rows[i, d, start + row]
        else:
            residuals(w.theta, X, y, start, start + count, chunk[n, :count])
        fold(w.T, chunk, count, n + 1)


@compiled
def column(slopes: Array, width: float, count: int, into: Array) -> None:
    """Derivatives in coordinates of this width."""
    for row in range(count):
        into[row] = slopes[row] * width


@compiled
def is_linear(k: int, box: Box) -> bool:
    """Whether a parameter is one of the linear ones."""
    for j in box.linear:  # noqa: SIM110 -- as numba compiles it
        if j == k:
            return True
    return False


@allocating
def advance(
    residuals: Any,
    slopes: Any,
    X: Array,
    y: Array,
    numbers: Array,
    counts: Whole,
    R: Array,
    rows: Array,
    box: Box,
    ends: Whole,
    minima: Minima,
    rules: Rules,
    slope_cost: int,
    most: int,
    best: float,
    target: float,
    at: Whole,
    losses: Array,
    thetas: Array,
) -> tuple[int, int, int, int, int, int]:
    """Give each configuration its steps: (state, rows spent, improvements, NaN, inf, unusable).

    `residuals(theta, X, y, i, j, r)` and `slopes(theta, X, i, j, J)` are compiled and give those of
    rows i to j. No more than `most` rows are spent; improvements of `best` are listed with the rows
    up to and with them, and end the block where they reach `target`.
    """
    c = views(numbers, counts, R, rows)
    w = work(R.shape[1], ends[rules.level] if rows.shape[2] else CHUNK, ends.size)
    return _advance(
        residuals, slopes, X, y, c, box, ends, minima, rules, slope_cost, most, best, target, w,
        at, losses, thetas,
    )  # fmt: skip


@compiled
def _advance(
    residuals: Any,
    slopes: Any,
    X: Array,
    y: Array,
    c: Candidates,
    box: Box,
    ends: Whole,
    minima: Minima,
    rules: Rules,
    slope_cost: int,
    most: int,
    best: float,
    target: float,
    w: Work,
    at: Whole,
    losses: Array,
    thetas: Array,
) -> tuple[int, int, int, int, int, int]:
    """As `advance`, with the arrays that it needs."""
    m = ends[rules.level]
    spent = found = nans = infinities = unusable = 0
    for i in range(c.x.shape[0]):
        while prepare(c, i, box, m, minima, rules, w):
            stage = c.stage[i]
            project = c.projects[i] and stage != RECORD
            cost = m * (box.linear.size + 1 if project else 1)
            if stage == SLOPES:
                cost = m * slope_cost
            if spent + cost > most:
                return PAUSED, spent, found, nans, infinities, unusable
            spent += cost
            c.spent[i] += cost
            if stage == SLOPES:
                to_units(c.x[i], box, w.theta)
                fill(residuals, slopes, X, y, c, i, box, m, False, w)
                factored(c, i, box, w)
                unusable += c.stage[i] == UNUSABLE
                continue
            to_units(c.x[i] if stage == RECORD else c.trial[i], box, w.theta)
            loss = look(residuals, X, y, ends, m, c.rows.shape[2] > 0 and not project, w) / m
            nans += math.isnan(loss)
            infinities += math.isinf(loss)
            if m == y.size and loss < best:
                best = loss
                at[found], losses[found] = spent - cost + m, loss
                for k in range(w.theta.size):
                    thetas[found, k] = w.theta[k]
                found += 1
            if project and math.isfinite(loss):
                fill(residuals, slopes, X, y, c, i, box, m, True, w)
                loss = solve_linear(c, i, box, m, w)
            evaluated(c, i, loss, box, m, rules, best, w)
            if best <= target:
                return FINISHED, spent, found, nans, infinities, unusable
    return FINISHED, spent, found, nans, infinities, unusable


def give_steps(
    oracle: Oracle,
    c: Candidates,
    box: Box,
    ends: Whole,
    minima: Minima,
    rules: Rules,
) -> None:
    """Give each configuration its steps, compiled where the problem is.

    Goes on where it was cut off. Raises as the oracle does at the end of the budget.
    """
    rows = oracle.compiled_rows
    m = int(ends[rules.level])
    if rows is None:
        w = work.py_func(c.x.shape[1], m, ends.size)
        _from_outside(oracle, c, box, ends, minima, rules, w)
        return
    N, d, slope_cost = rows.y.size, c.x.shape[1], oracle.jacobian_cost
    least = float(max(box.linear.size + 1, slope_cost))
    room = EVENTS if rules.last else 0
    at, losses, thetas = np.empty(room, np.int64), np.empty(room), np.empty((room, d))

    def block(most: float, best: float, target: float) -> Block:
        limit = int(min(most * N + 1e-6, EVENTS * N, 2**62))
        state, spent, found, nans, infinities, unusable = advance(
            rows.residuals, rows.slopes, rows.X, rows.y, *c[:4], box, ends, minima, rules, slope_cost, limit, best, target, at, losses, thetas,
        )  # fmt: skip
        rejected = {}
        for reason, count in (
            ("loss is nan", nans),
            ("loss is inf", infinities),
            ("derivative is not finite", unusable),
        ):
            if count:
                rejected[reason] = count
        return Block(
            spent / N, at[:found] / N, losses[:found], thetas[:found], rejected, state == FINISHED
        )

    oracle.spend(block, least)


def _from_outside(
    oracle: Oracle, c: Candidates, box: Box, ends: Whole, minima: Minima, rules: Rules, w: Work
) -> None:
    """The same steps on residuals and derivatives that a problem gives one at a time."""
    d, p = c.x.shape[1], box.linear.size
    m = int(ends[rules.level])
    fidelity = 1.0 if rules.last else m / int(ends[-1])
    share = 1.0 if rules.last else oracle.cost(fidelity)
    for i in range(c.x.shape[0]):
        while prepare(c, i, box, m, minima, rules, w):
            stage = c.stage[i]
            project = bool(c.projects[i]) and stage != RECORD
            to_units(c.trial[i] if stage in (ENTER, TRIED) else c.x[i], box, w.theta)
            try:
                if stage == SLOPES:
                    cost = oracle.jacobian_cost
                    columns = oracle.jacobian(w.theta.copy(), fidelity).T
                    columns = columns * (box.width * np.where(box.log, w.theta, 1.0))[:, None]
                    order = np.arange(d)
                    if project:
                        free = [k for k in box.linear if is_free(c.x[i, k])]
                        order = np.array([*free, *box.nonlinear])
                    c.rows[i, : order.size] = columns[order]
                    refold(c.rows[i], order.size, d, m, w)
                    factored(c, i, box, w)
                else:
                    cost = p + 1 if project else 1
                    if cost * share > oracle.remaining:
                        raise BudgetExhausted
                    loss = _look_outside(oracle, fidelity, c, i, box, ends, project, w)
                    evaluated(c, i, loss, box, m, rules, oracle.best, w)
            except UnusableValueError:
                if stage == SLOPES:
                    c.stage[i] = UNUSABLE
                else:
                    evaluated(c, i, math.inf, box, m, rules, oracle.best, w)
            c.spent[i] += m * cost


def _look_outside(
    oracle: Oracle,
    fidelity: float,
    c: Candidates,
    i: int,
    box: Box,
    ends: Whole,
    project: bool,
    w: Work,
) -> float:
    """The loss at w.theta, or at the best linear parameters there; infinite if unusable.

    The residuals there are left in w.residuals.
    """
    theta = w.theta.copy()
    r = w.residuals
    r[:] = oracle.residuals(theta, fidelity)
    w.sums[:] = [r[:end] @ r[:end] for end in ends]
    loss = float(r @ r) / r.size
    if not (project and math.isfinite(loss)):
        return loss
    rows, p = np.empty((box.linear.size + 1, r.size)), box.linear.size
    for column, k in enumerate(box.linear):
        # as far away as the box allows: the wider a difference, the more exact
        moved, up = theta.copy(), box.high[k] - theta[k] >= theta[k] - box.low[k]
        moved[k] = box.high[k] if up else box.low[k]
        scale = (box.high[k] - box.low[k]) / (moved[k] - theta[k])
        rows[column] = (oracle.residuals(moved, fidelity) - r) * scale
    rows[p] = r
    refold(rows, p, p, r.size, w)
    loss = solve_linear(c, i, box, r.size, w)
    r += w.step[:p] @ rows[:p]
    return loss


@compiled
def same(c: Candidates, i: int, j: int, box: Box) -> bool:
    """Whether two configurations are one, as far as the rows can tell; j is the worse one."""
    if (c.stage[i] != READY and c.stage[i] != DONE) or abs(c.loss[i] - c.loss[j]) > 0.05 * c.loss[
        i
    ]:
        return False
    n = box.nonlinear.size if c.projects[i] else c.x.shape[1]
    distance = 0.0
    for row in range(n):
        value = 0.0
        for k in range(row, n):
            at = box.nonlinear[k] if c.projects[i] else k
            value += c.R[i, row, k] * (c.x[i, at] - c.x[j, at])
        distance += value * value
    return bool(distance <= 0.5 * c.x.shape[1] * c.loss[i])


@allocating
def distinct(c: Candidates, box: Box) -> NDArray[np.intp]:
    """Those of configurations in ascending order of their loss that are no copies of better ones."""
    kept = np.empty(c.loss.size, np.intp)
    count = 0
    for j in range(c.loss.size):
        new = True
        for i in kept[:count]:
            if same(c, i, j, box):
                new = False
                break
        if new:
            kept[count] = j
            count += 1
    return kept[:count]
